"""`twin.run.assemble`: One builder: N scenarios make N rigs, and each is what it is alone."""

from functools import cache

import numpy as np
import pytest
from every_setting import OTHER, QUIET

from controllers.per_rig import PerRigReference
from controllers.references import Circle, Hold
from twin.base.errors import ModelError, ScenarioError
from twin.base.settings import settings_of
from twin.hal.interface import Limits
from twin.run.assemble import SHARED_EXACT, SHARED_KEYS, assemble
from twin.run.finished import run
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction, SurfaceModel
from twin.sim.plant.interface import BallStart, Parts
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import TransmissionError

SHORT = ("duration=0.12", "metrics.start=0", "plant.start.x_rate=0.1")
BESIDE = {
    "plant.size": ["plant.kind=lagrange"],
    "plant.friction.stribeck_speed": ["plant.friction.breakaway_ratio=2.0"],
    "plant.friction.dwell_time": ["plant.friction.breakaway_ratio=2.0"],
    "plant.servo.vibration_hz": ["plant.servo.vibration=0.5"],
    "plant.servo.vibration_wander": ["plant.servo.vibration=0.5"],
    "plant.servo.resonance_damping": ["plant.servo.resonance_hz=15.0"],
    "plant.surface.patch_mm": ["plant.surface.spread_percent=20.0"],
    "plant.surface.seed": ["plant.surface.spread_percent=20.0"],
    "sensors.touch.jitter": ["sensors.touch.frame_rate=100.0"],
    "sensors.touch.lost": ["sensors.touch.frame_rate=100.0"],
    "plant.friction.spinning_mm": ["plant.start.spin=20.0"],
    "controller.rho": ["controller.kind=lqr", "controller.kappa=0.3"],
    "plant.ball.offset_mm": ["plant.ball.offset_mm=[0.5, 0, 0]"],
    "plant.rim.restitution": ["plant.rim.size=[0.06, 0.06]"],
}
"""What another setting needs to show at all."""
HIDDEN = {"plant.friction.spinning_mm", "plant.servo.torque_limit", "plant.surface.patch_mm"} | {
    f"rig.limits.{name}" for name in ("area", "margin", "ball_speed", "angle_deg")
}
"""Settings that 0.12 s of this motion do not show in the state."""


def recorded(scenarios):
    rig, controller = assemble(scenarios, threads=1)
    record = Recorder(60, len(scenarios), 0.002)
    outcomes = drive(rig, controller, scenarios[0].duration, record)
    return record, outcomes


@cache
def usual(settings):
    """Scenario, record and outcome of the rig that others are compared with, once for each."""
    scenario = load("circle", list(settings))
    record, (outcome,) = recorded([scenario])
    return scenario, record, outcome


def test_every_setting_of_the_simulated_rig_is_tried():
    models = (
        *(Friction, Parts, BallStart, SurfaceModel, DriveModel, TouchModel, EncoderModel),
        *(TransmissionError, Limits),
    )
    keys = {about.key for model in models for about in settings_of(model).values()}
    assert keys <= OTHER.keys()


AGREED = ("plant.ball_spin", "plant.axes")
"""Settings in which all rigs of a batch agree, and of which the mechanism takes one value only."""
MAY_DIFFER = {key: value for key, value in OTHER.items() if key not in AGREED}
"""Settings in which rigs of the mechanism need not agree."""


@pytest.mark.long
@pytest.mark.parametrize(("key", "value"), MAY_DIFFER.items(), ids=MAY_DIFFER)
def test_a_rig_that_differs_in_one_setting_is_what_it_is_alone(key, value):
    common = (*SHORT, *BESIDE.get(key, []))
    base, *first = usual(common)
    other = load("circle", [*common, f"{key}={value}"])
    assert base != other
    together, outcomes = recorded([base, other, base])
    differing, (ending,) = recorded([other])
    for rig, (alone, outcome) in enumerate((first, (differing, ending), first)):
        assert outcomes[rig].ending == outcome.ending
        for name in ("state", "measured", "estimate", "applied"):
            # products of matrices round differently for one rig and for several
            assert together[name][: alone.length, rig] == pytest.approx(
                alone[name][:, 0], rel=1e-6, abs=1e-9
            ), name
    if key not in HIDDEN:
        assert not np.allclose(together["state"][:, 0], together["state"][:, 1], atol=1e-12)


EXACT = "plant.kind=lagrange"
TABLE = [f"plant.linkage.{axis}_deg=[[-40, -15], [40, 15]]" for axis in ("phi", "theta")]


@pytest.mark.parametrize(
    ("common", "changes", "key"),
    [
        ([], [EXACT], "plant.kind"),
        ([], ["plant.step=0.002"], "plant.step"),
        ([], ["rig.period=0.004"], "rig.period"),
        ([], ["duration=20"], "duration"),
        ([], ["sensors.ideal=true"], "sensors.ideal"),
        (["parameters=course"], ["plant.linkage.rod_mm=[95, 90]"], "plant.linkage.rod_mm"),
        (["parameters=hobby"], TABLE, "plant.linkage.phi_deg"),
        *(([EXACT], [f"{key}={OTHER[key]}"], key) for key in SHARED_EXACT),
    ],
)
def test_what_a_batch_has_only_once_is_refused_by_name(common, changes, key):
    assert key in SHARED_KEYS + SHARED_EXACT
    with pytest.raises(ScenarioError, match=f"{key}: rigs that run side by side must agree"):
        assemble([load("circle", common), load("circle", [*common, *changes])])


def test_a_ball_out_of_balance_beside_one_in_balance_is_refused_by_name():
    with pytest.raises(ModelError, match=r"plant\.ball\.offset_mm"):
        assemble([load("circle"), load("circle", ["plant.ball.offset_mm=[1, 0, 0]"])])


def test_the_references_of_a_batch_can_be_asked_ahead():
    members = (
        Circle(amplitude=0.15, omega=1.0),
        Hold(x=0.1, y=0.0),
        Circle(amplitude=0.1, omega=2.0),
    )
    batch = PerRigReference(members, 0.002)
    for t in (0.4, np.array([0.0, 0.4, 7.1]), np.array([[0.1], [0.2]])):
        for rig, member in enumerate(members):
            assert batch(t)[..., rig, :] == pytest.approx(member(t), abs=1e-12)


def test_the_estimate_of_a_row_is_that_of_its_own_time():
    smooth = ("plant.kind=lagrange", "plant.friction.rolling_mm=0", "duration=3", "metrics.start=1")
    scenario = load("circle", (*smooth, *QUIET)).model_copy(update={"predictor": None})
    record = run(scenario).record
    late = record.time > 1.5
    ball = record["estimate"][late, 0, 0::4] - record["state"][late, 0, 0::4]
    assert np.sqrt((ball**2).mean()) < 1e-6
    assert np.abs(record["state"][late, 0, 1::4]).max() * 0.002 > 1e-4  # a tick shows
