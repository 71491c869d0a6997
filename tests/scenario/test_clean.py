"""The clean model knows nothing of what a scenario says of its rig."""

import pytest

from twin.run.execute import run
from twin.scenario import load
from twin.scenario.clean import clean
from twin.scenario.plant import MECHANISM_ONLY, PlantTable
from twin.scenario.schema import Scenario

OF_THE_RIG = {
    "plant.level_deg": "[0.5, -0.5]",
    "plant.ball.kind": "steel",
    "plant.ball.mass": "0.03",
    "plant.ball.radius": "0.021",
    "plant.ball.inertia": "5e-6",
    "plant.ball.offset_mm": "[0.1, 0, 0]",
    "plant.ball.oval_mm": "0.1",
    "plant.friction.rolling_mm": "0.3",
    "plant.friction.breakaway_ratio": "2.0",
    "plant.friction.stribeck_speed": "0.01",
    "plant.friction.dwell_time": "1.0",
    "plant.friction.viscous_mm": "0.5",
    "plant.friction.presliding_um": "50.0",
    "plant.friction.sliding": "0.3",
    "plant.friction.spinning_mm": "0.1",
    "plant.surface.spread_percent": "20.0",
    "plant.surface.slope_deg": "0.1",
    "plant.surface.patch_mm": "30.0",
    "plant.surface.seed": "3",
    "plant.surface.relative": "[[1.0, 1.2], [0.9, 1.0]]",
    "plant.surface.height_um": "[[0.0, 9.0], [5.0, 0.0]]",
    "plant.servo.bandwidth_hz": "10.0",
    "plant.servo.backlash_deg": "0.1",
    "plant.servo.hysteresis_deg": "0.1",
    "plant.servo.resonance_hz": "15.0",
    "plant.servo.resonance_damping": "0.3",
    "plant.servo.vibration": "0.5",
    "plant.servo.vibration_hz": "20.0",
    "plant.servo.vibration_wander": "1.0",
    "plant.servo.speed_limit": "100.0",
    "plant.servo.torque_limit": "4.0",
    "plant.wheels.stiffness": "60000.0",
    "plant.wheels.damping_ratio": "1.0",
    "plant.spring.preload": "60.0",
    "plant.plate.offset_mm": "[1.0, 1.0]",
    "plant.plate.joint_friction": "1.0",
    "plant.start.spin": "20.0",
    "rig.cams": "ratio",
    "rig.cam_error_percent": "[3.0, 3.0]",
    "rig.cam_coupling_percent": "2.0",
    "sensors.noise_hold": "0.01",
    "sensors.touch.dead_time": "0.08",
    "sensors.touch.dead_time_spread": "0.002",
    "sensors.touch.rotation_deg": "2.0",
    "sensors.touch.frame_rate": "100.0",
    "sensors.touch.grid": "256",
    "sensors.touch.variance": "[1e-6, 1e-6]",
    "sensors.encoders.counts": "1000",
    "sensors.encoders.variance": "[1e-8, 1e-8]",
    "disturbance.variance": "[1e-3, 1e-3]",
}
"""Every key that makes the rig another one, and a value it does not have by default."""
KEPT = {"plant.kind", "plant.step", "sensors.ideal"} | {
    f"plant.start.{name}" for name in ("x", "y", "x_rate", "y_rate")
}


def keys(table, prefix):
    for name, value in table.items():
        if isinstance(value, dict):
            yield from keys(value, f"{prefix}{name}.")
        else:
            yield prefix + name


def test_every_key_of_plant_sensors_and_disturbance_is_either_dropped_or_kept():
    dumped = load("circle").model_dump()
    found = {
        key
        for table in ("plant", "sensors", "disturbance")
        for key in keys(dumped[table], f"{table}.")
    }
    assert found == KEPT | {key for key in OF_THE_RIG if not key.startswith("rig.")}
    assert {f"plant.{key}" for key in MECHANISM_ONLY} <= OF_THE_RIG.keys()


@pytest.mark.parametrize(("key", "value"), OF_THE_RIG.items(), ids=OF_THE_RIG)
def test_another_rig_has_the_same_clean_model(key, value):
    other = load("circle", (f"{key}={value}",))
    assert other != load("circle")
    assert clean(other) == clean(load("circle"))


def test_a_clean_model_is_a_scenario_that_can_be_written_and_read():
    found = clean(load("circle", ("plant.start.spin=3.0", "plant.start.x=0.1")))
    assert Scenario.model_validate_json(found.model_dump_json()) == found
    assert found.plant.start == PlantTable().start.model_copy(update={"x": 0.1})


@pytest.mark.long
def test_on_the_clean_model_nothing_but_discretisation_keeps_the_ball_from_the_circle():
    changes = ("duration=12", "metrics.start=8.0", "plant.level_deg=[1.0, 1.0]")
    assert run(clean(load("circle", changes))).metrics["tracking_error_percent"] < 0.3
