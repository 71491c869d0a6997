"""The level from a log: a rig that stands askew, and the foot to raise."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.calibrate import level
from twin.run.execute import run, save
from twin.scenario import load

TILT = (0.12, -0.07)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("level") / "excite"
    done = run(load("excite", ("duration=24", f"plant.level_deg={list(TILT)}")))
    save(done, path, {"run": done.motion})
    return path


def test_the_tilt_of_the_base_is_found_to_a_hundredth_of_a_degree(log):
    result = CliRunner().invoke(level, [str(log), "--json"], standalone_mode=False)
    assert result.exception is None
    found = json.loads(result.stdout)
    assert [each["value"] for each in found] == pytest.approx(TILT, abs=0.01)


def test_the_low_side_is_the_one_to_raise(log):
    # positive phi lowers +x, negative theta lowers +y
    result = CliRunner().invoke(level, [str(log)], standalone_mode=False)
    assert "raise the +x side by 2." in result.stdout
    assert "raise the +y side by 1." in result.stdout
    assert 1000 * np.tan(np.radians(0.12)) == pytest.approx(2.1, abs=0.05)
