"""`twin.sim`: The level from a log: a rig that stands askew, and the foot to raise."""

import json
import re

import pytest
from click.testing import CliRunner

from twin.cli.calibrate import TILT_DIRECTIONS, advice, level
from twin.identify.parameters import BALL_PARAMETERS
from twin.identify.verdicts import ParameterVerdict
from twin.run.finished import record_run, run
from twin.scenario import load

TILT = (0.12, -0.07)


def excite(path, *settings):
    """A run folder of the excitation."""
    record_run(run(load("excite", settings)), path)
    return path


@pytest.mark.long
def test_the_tilt_of_the_base_is_found_to_a_hundredth_of_a_degree(tmp_path):
    log = excite(tmp_path / "excite", "duration=24", f"plant.level_deg={list(TILT)}")
    result = CliRunner().invoke(level, [str(log), "--json"], standalone_mode=False)
    assert result.exception is None
    found = json.loads(result.stdout)
    assert [each["value"] for each in found] == pytest.approx(TILT, abs=0.01)


@pytest.mark.long
def test_on_a_level_rig_there_is_nothing_to_do(tmp_path):
    log = excite(tmp_path / "excite", "duration=24")
    result = CliRunner().invoke(level, [str(log)], standalone_mode=False)
    assert result.return_value == 0
    for line, name in zip(result.stdout.splitlines(), ("phi", "theta"), strict=True):
        said = re.fullmatch(rf"level_{name}: level within (0\.00\d+) deg: nothing to do", line)
        assert said
        assert float(said[1]) < 0.01


@pytest.mark.parametrize(
    ("axis", "value", "low", "high", "word", "says"),
    [
        (0, 0.001, -0.001, 0.003, "identified", "level within 0.003 deg: nothing to do"),
        (0, -0.001, -0.004, 0.002, "identified", "level within 0.004 deg: nothing to do"),
        (0, 0.01, -0.2, 0.22, "not identifiable", "too uncertain to level by; roll more"),
        # positive phi lowers +x, negative theta lowers +y
        (0, 0.3, 0.2, 0.4, "not identifiable", "raise the +x side by 5.24 mm per metre along x"),
        (0, -0.3, -0.31, -0.29, "identified", "raise the -x side by 5.24 mm per metre along x"),
        (1, -0.3, -0.31, -0.29, "identified", "raise the +y side by 5.24 mm per metre along y"),
        (0, None, None, None, "not identifiable", "roll more"),
    ],
)
def test_advice_needs_an_interval_without_zero(axis, value, low, high, word, says):
    name = ("level_phi", "level_theta")[axis]
    found = ParameterVerdict(
        about=BALL_PARAMETERS[name],
        name=name,
        value=value,
        low=low,
        high=high,
        word=word,
        why="" if word == "identified" else "roll more",
    )
    assert advice(found, TILT_DIRECTIONS[axis]).endswith(says)
    assert ("raise" in advice(found, TILT_DIRECTIONS[axis])) == (
        value is not None and low * high > 0
    )
