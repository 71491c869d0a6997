"""`twin.scenario.derived`: The clean model knows nothing of what a scenario says of its rig."""

import pytest
from every_setting import OTHER

from twin.run.finished import run
from twin.run.tables import flat
from twin.scenario import load
from twin.scenario.derived import clean
from twin.scenario.rig_tables import LEFT_OUT
from twin.scenario.schema import Scenario

BALL = {
    "plant.ball.kind": "steel",
    "plant.ball.mass": "0.03",
    "plant.ball.radius": "0.021",
    "plant.ball.inertia": "5e-6",
    "plant.plate.height": "0.1",
}
"""Keys of ball and plate, for which a controller is designed unless it is told of another."""
KEPT = {"plant.kind", "plant.step", "plant.size", "plant.axes", "plant.shape", "sensors.ideal"} | {
    f"plant.start.{name}" for name in ("x", "y", "x_rate", "y_rate")
}
OF_THE_RIG = {
    key: value
    for key, value in OTHER.items()
    if key.startswith(("plant.", "sensors.", "disturbance.", "rig.cam"))
    if key not in KEPT | BALL.keys() | {"plant.ball_spin"}
}
"""Every other key that makes the rig another one, and a value it does not have by default."""

LINKAGE = {
    "plant.linkage.crank_mm": "[40, 30]",
    "plant.linkage.rod_mm": "[90, 100]",
    "plant.linkage.arm_mm": "[100, 70]",
    "plant.linkage.distance_mm": "[50, 45]",
}
TABLE = {
    "plant.linkage.phi_deg": "[[-40,-12],[40,12]]",
    "plant.linkage.theta_deg": "[[-40,-12],[0,0],[40,13]]",
}
"""Keys that only together make another rig."""
SPIN = {"plant.kind": "lagrange", "plant.ball_spin": OTHER["plant.ball_spin"]}
"""And one that only the exact equations have."""


def test_every_key_of_plant_sensors_and_disturbance_is_either_dropped_or_kept():
    found = flat(load("circle").model_dump(include={"plant", "sensors", "disturbance"})).keys()
    dropped = {key for key in OF_THE_RIG if not key.startswith("rig.")}
    assert found == KEPT | dropped | BALL.keys() | LINKAGE.keys() | TABLE.keys() | SPIN.keys()
    assert LEFT_OUT["lagrange"].keys() <= OF_THE_RIG.keys()


@pytest.mark.parametrize(("key", "value"), OF_THE_RIG.items(), ids=OF_THE_RIG)
def test_another_rig_has_the_same_clean_model(key, value):
    other = load("circle", (f"{key}={value}",))
    assert other != load("circle")
    assert clean(other) == clean(load("circle"))


@pytest.mark.parametrize("linkage", [LINKAGE | {"rig.cams": "ratio"}, TABLE, SPIN])
def test_the_clean_model_has_no_linkage_and_the_equations_that_laws_are_designed_on(linkage):
    keys = [f"{key}={value}" for key, value in linkage.items()]
    found = clean(load("circle", ["plant.kind=lagrange", *keys]))
    assert found == clean(load("circle"))
    assert found.plant.ball_spin == "thesis"


@pytest.mark.parametrize(("key", "value"), BALL.items(), ids=BALL)
def test_the_clean_model_has_the_ball_that_the_controller_is_designed_on(key, value):
    other = load("circle", (f"{key}={value}",))
    assert clean(other).designed_on == other.designed_on == clean(other).plant.model
    hidden = (f"{key}={value}", "controller.model=nominal")
    assert clean(load("circle", hidden)).plant == clean(load("circle")).plant


def test_a_clean_model_is_a_scenario_that_can_be_written_and_read():
    found = clean(load("circle", ("plant.start.spin=3.0", "plant.start.x=0.1")))
    assert Scenario.model_validate_json(found.model_dump_json()) == found
    assert found.plant.start == load("circle").plant.start.model_copy(update={"x": 0.1})


@pytest.mark.long
def test_on_the_clean_model_nothing_but_discretisation_keeps_the_ball_from_the_circle():
    changes = ("duration=12", "metrics.start=8.0", "plant.level_deg=[1.0, 1.0]")
    assert run(clean(load("circle", changes))).metrics["tracking_error_percent"] < 0.3
