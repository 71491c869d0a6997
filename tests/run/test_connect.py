"""`twin.run.connect`.

What a real rig knows of its cams comes from its file or the package, never from a simulation."""

from contextlib import nullcontext

import numpy as np
import pytest

from ballplate.reporter import Reporter
from ballplate.rig_access import open_rig
from twin.base.errors import ScenarioError
from twin.devices.realtime import Scheduling
from twin.hal.cams import CamTable
from twin.run.connect import connect
from twin.scenario import load
from twin.scenario.rig import check_rig, read_rig

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


@pytest.mark.parametrize("axes", [1, 2])
def test_of_one_axis_theta_is_not_commanded_and_y_reads_as_0(axes, tmp_path):
    (tmp_path / "board.py").write_text("from own_board import VirtualBoard\n", "utf-8")
    file = tmp_path / "rig.toml"
    file.write_text('backend = "board.py:VirtualBoard"\n', "utf-8")
    rig = connect(load("hold", ["plant.kind=lagrange", f"plant.axes={axes}"]), read_rig(file))
    rig._scheduling = lambda: nullcontext(Scheduling(False, False, ("virtual time",)))
    board = rig.servos._hardware.board
    board.ball = [0.01, 0.02]
    with rig:
        rig.start()
        for _ in range(50):
            applied = rig.write(np.full((1, 2), 0.1))
            rig.wait()
            y = rig.read().y[0]
        assert applied[0] == pytest.approx([0.1, 0.0 if axes == 1 else 0.1])
        assert board.angle[0] > 0.002
        if axes == 1:
            assert (board.angle[1], *y[2:]) == (0.0, 0.0, 0.0)
        else:
            assert board.angle[1] > 0.002
            assert y[2] > 0.01
