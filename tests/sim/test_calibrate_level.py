"""The level from a log: a rig that stands askew, and the foot to raise."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.rig import FEET, advice, level
from twin.identify.judged import ParameterVerdict
from twin.identify.parameters import BALL
from twin.identify.twin_model import identify
from twin.run.finished import run, save
from twin.scenario import load

TILT = (0.12, -0.07)


def excite(path, *settings):
    """A run folder of the excitation."""
    done = run(load("excite", settings))
    save(done, path, {"run": done.motion})
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("level") / "excite"
    return excite(path, "duration=24", f"plant.level_deg={list(TILT)}")


@pytest.fixture
def once(monkeypatch, identified):
    """The command identifies a log once; it is asked twice for what it found there."""

    def remembered(recorded, *arguments):
        if recorded.source not in identified:
            identified[recorded.source] = identify(recorded, *arguments)
        return identified[recorded.source]

    monkeypatch.setattr("twin.identify.twin_model.identify", remembered)


@pytest.fixture(scope="module")
def identified():
    return {}


@pytest.mark.long
@pytest.mark.usefixtures("once")
def test_the_tilt_of_the_base_is_found_to_a_hundredth_of_a_degree(log):
    result = CliRunner().invoke(level, [str(log), "--json"], standalone_mode=False)
    assert result.exception is None
    found = json.loads(result.stdout)
    assert [each["value"] for each in found] == pytest.approx(TILT, abs=0.01)


@pytest.mark.long
@pytest.mark.usefixtures("once")
def test_the_low_side_is_the_one_to_raise(log):
    # positive phi lowers +x, negative theta lowers +y
    result = CliRunner().invoke(level, [str(log)], standalone_mode=False)
    assert "raise the +x side by 2." in result.stdout
    assert "raise the +y side by 1." in result.stdout
    assert 1000 * np.tan(np.radians(0.12)) == pytest.approx(2.1, abs=0.05)


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
    ("value", "low", "high", "word", "says"),
    [
        (0.001, -0.001, 0.003, "identified", "level within 0.003 deg: nothing to do"),
        (-0.001, -0.004, 0.002, "identified", "level within 0.004 deg: nothing to do"),
        (0.01, -0.2, 0.22, "not identifiable", "too uncertain to level by; roll more"),
        (0.3, 0.2, 0.4, "not identifiable", "raise the +x side by 5.24 mm per metre along x"),
        (-0.3, -0.31, -0.29, "identified", "raise the -x side by 5.24 mm per metre along x"),
        (None, None, None, "not identifiable", "roll more"),
    ],
)
def test_advice_needs_an_interval_without_zero(value, low, high, word, says):
    found = ParameterVerdict(
        about=BALL["level_phi"],
        name="level_phi",
        value=value,
        low=low,
        high=high,
        word=word,
        why="" if word == "identified" else "roll more",
    )
    assert advice(found, FEET[0]).endswith(says)
    assert ("raise" in advice(found, FEET[0])) == (value is not None and low * high > 0)
