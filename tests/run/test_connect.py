"""`twin.run.connect`.

What a real rig knows of its cams comes from its file or the package, never from a simulation."""

import numpy as np
import pytest

from ballplate.reporter import Reporter
from ballplate.running import open_rig
from twin.base.errors import ScenarioError
from twin.hal.cams import CamTable
from twin.run.connect import connect
from twin.scenario import load
from twin.scenario.rig import check_rig

TABLES = {"touch": {"port": "/dev/null", "protocol": "elo"}}
TILT = np.array([[0.05, -0.02]])


@pytest.mark.parametrize(
    "overrides",
    [[], ["plant.kind=lagrange"], ["rig.cam_error_percent=[5,5]"], ["rig.cams=ratio"]],
    ids=str,
)
def test_the_motors_are_turned_by_the_packaged_table_whatever_is_simulated(overrides):
    rig = connect(load("circle", overrides), check_rig(TABLES, "rig.toml"))
    motor = rig._transmission.motor(TILT)
    assert np.array_equal(motor, CamTable.packaged().motor(TILT))
    assert abs(motor[0, 0]) > 4 * 0.05


def test_the_motors_are_turned_by_the_table_that_the_rig_file_names(tmp_path):
    table = CamTable.packaged()
    other = CamTable(table.grid, 1.1 * table.angles, {"made": "for this test"})
    other.save(tmp_path / "cams.json")
    tables = {**TABLES, "cams": str(tmp_path / "cams.json")}
    rig = connect(load("circle"), check_rig(tables, "rig.toml"))
    assert rig._transmission.motor(TILT) == pytest.approx(1.1 * table.motor(TILT), abs=1e-8)


@pytest.mark.parametrize(
    "key",
    [
        "plant.kind",
        "rig.cam_error_percent",
        "rig.cams",
        "plant.friction.rolling_mm",
        "sensors.touch.dead_time",
        "disturbance.variance",
    ],
)
def test_settings_of_a_simulation_are_refused_on_a_real_rig(key):
    refused = pytest.raises(ScenarioError, match=f"{key} describes a simulated rig")
    with refused, open_rig("rig.toml", load("circle"), [key], Reporter(), reset=False):
        pass
