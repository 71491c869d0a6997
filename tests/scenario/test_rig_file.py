"""`twin.scenario.rig`: Rig files with anything in them: a rig, or one line."""

import datetime
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from twin.base.errors import TwinError
from twin.base.validation import keys_of
from twin.scenario.merging import put
from twin.scenario.rig import RigFile, check_rig, read_rig

KEYS = sorted(keys_of(RigFile))
NUMBERS = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.sampled_from([0, -1, 1, 2, 127, 2**31, 2**32, 1e-300, 1e300, -0.0]),
    st.floats(),
)
CONTROL_COMMANDS = st.sampled_from(
    ["auto", "elo", "serial", "hidraw", "evdev", "slcan", "/dev/null", "", "a\0b", "x" * 300]
)
PLAIN = st.one_of(NUMBERS, CONTROL_COMMANDS, st.booleans(), st.just(datetime.date(2026, 1, 1)))
PAIR = st.lists(NUMBERS, min_size=2, max_size=2)
VALUES = st.one_of(
    PLAIN,
    PAIR,
    st.lists(PLAIN | PAIR, max_size=3),
    st.dictionaries(st.sampled_from(["node", "port", "x", "gate"]), PLAIN, max_size=2),
)
CHANGES = st.lists(st.tuples(st.sampled_from(KEYS), VALUES), max_size=6)
WHOLE = {
    "touch": {
        "port": "/dev/null",
        "calibration": {"matrix": [[1.0, 0.0], [0.0, 1.0]], "origin": [0.0, 0.0]},
    },
    "phi": {"node": 1},
    "theta": {"node": 2},
}


def usable(rig):
    """Whether what a rig file says can be worked with."""
    for axis in rig.servos(0.002).axes:
        for scale in (axis.position, axis.plate, axis.velocity):
            assert scale != 0
    calibration = rig.screen().calibration
    if calibration is not None:
        calibration.screen(0.1, 0.1)
    return True


@settings(max_examples=60)
@given(changes=CHANGES)
def test_whatever_a_rig_file_sets_it_is_a_rig_or_is_refused_in_one_line(changes):
    words = ""
    try:
        assert usable(check_rig(put(WHOLE, changes), "rig.toml"))
    except TwinError as error:
        words = str(error)
    assert len(words) < 1000


def test_a_file_that_a_rig_file_names_lies_beside_it_or_in_the_working_folder(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    Path("there").mkdir()
    Path("there/rig.toml").write_text(
        'cams = "cams.json"\n[touch]\nport = "x"\ncalibration_file = "touch.json"\n'
    )
    Path("cams.json").touch()
    Path("there/touch.json").touch()
    found = read_rig(Path("there/rig.toml"))
    assert (found.cams, found.touch.calibration_file) == ("cams.json", "there/touch.json")


def test_the_rig_file_that_the_others_change_is_a_rig():
    assert usable(check_rig(WHOLE, "rig.toml"))
