"""Rig files with anything in them: a rig, or one line."""

import copy
import datetime
import typing

from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from twin.errors import TwinError
from twin.scenario.rig import RigFile, check_rig


def keys(model, path=()):
    """The dotted keys of a model of tables, those of its tables too."""
    for name, field in model.model_fields.items():
        kinds = [field.annotation, *typing.get_args(field.annotation)]
        tables = [each for each in kinds if isinstance(each, type) and issubclass(each, BaseModel)]
        yield (*path, name)
        for table in tables:
            yield from keys(table, (*path, name))


KEYS = sorted(keys(RigFile))
NUMBERS = st.one_of(
    st.integers(-(2**63), 2**63 - 1),
    st.sampled_from([0, -1, 1, 2, 127, 2**31, 2**32, 1e-300, 1e300, -0.0]),
    st.floats(),
)
WORDS = st.sampled_from(
    ["auto", "elo", "serial", "hidraw", "evdev", "slcan", "/dev/null", "", "a\0b", "x" * 300]
)
PLAIN = st.one_of(
    NUMBERS, WORDS, st.booleans(), st.text(max_size=8), st.just(datetime.date(2026, 1, 1))
)
VALUES = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["node", "port", "x", "gate"]), inner, max_size=3)
    ),
    max_leaves=6,
)
PAIR = st.lists(NUMBERS, min_size=2, max_size=2)
MATRIX = st.lists(PAIR, min_size=2, max_size=2)
CHANGES = st.lists(st.tuples(st.sampled_from(KEYS), VALUES | PAIR | MATRIX), max_size=6)
WHOLE = (
    (("touch", "port"), "/dev/null"),
    (("touch", "calibration"), {"matrix": [[1.0, 0.0], [0.0, 1.0]], "origin": [0.0, 0.0]}),
    (("phi", "node"), 1),
    (("theta", "node"), 2),
)


def put(changes):
    """The tables in which keys have values; a key that leads through a value is left out."""
    tables = {}
    for path, value in (*copy.deepcopy(WHOLE), *changes):
        table = tables
        for name in path[:-1]:
            table = table.setdefault(name, {}) if isinstance(table, dict) else None
        if isinstance(table, dict):
            table[path[-1]] = copy.deepcopy(value)
    return tables


def usable(rig):
    """Whether what a rig file says can be worked with."""
    for axis in rig.servos(0.002).axes:
        for scale in (axis.position, axis.plate, axis.velocity):
            assert scale.unit != 0
    calibration = rig.screen().calibration
    if calibration is not None:
        calibration.screen(0.1, 0.1)
    return True


@given(changes=CHANGES)
def test_whatever_a_rig_file_sets_it_is_a_rig_or_is_refused_in_one_line(changes):
    try:
        rig = check_rig(put(changes), "rig.toml")
    except TwinError as error:
        words = str(error)
    else:
        words = ""
        assert usable(rig)
    assert len(words) < 1000


def test_the_rig_file_that_the_others_change_is_a_rig():
    assert usable(check_rig(put([]), "rig.toml"))
