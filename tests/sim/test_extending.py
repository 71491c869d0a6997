"""`twin.sim`: How to add an effect and a plant, done once: what docs/extending.md describes."""

from dataclasses import dataclass

import numpy as np
import pytest

import ballplate as bp
from controllers.arrays import Number, column
from twin.base.errors import ModelError, ScenarioError
from twin.base.followers import GIVEN, Followers
from twin.base.settings import Unit, from_scenarios, setting
from twin.hal.cams import FixedRatio
from twin.run.assemble import assemble
from twin.run.finished import run
from twin.run.loop import Episodes, simulate
from twin.run.plants import PLANTS, PlantKind, register
from twin.scenario import load
from twin.scenario.load import validate
from twin.scenario.rig_tables import PLANT_KINDS as NAMED
from twin.scenario.rig_tables import tables

EXACT = ("plant.kind=lagrange", "duration=1", "metrics.start=0", "sensors.touch.variance=[0,0]")


OUTDOORS = Followers(
    mechanism="stands indoors",
    equations=GIVEN,
    source="stands indoors",
    identify="fits a ball in still air",
    symbols="have a ball in still air",
    explain="has no effect of it",
)


@dataclass(frozen=True, kw_only=True)
class Wind:
    """An effect: a dataclass whose field says which key of a scenario sets it."""

    acceleration: Number = setting(
        "wind.acceleration_mm", 0.0, Unit.MM, followed_by=OUTDOORS, ge=-1000, le=1000
    )

    def push(self, rates):
        """Ball accelerations (N, 2) with wind along x."""
        return rates + column(self.acceleration) * np.array([1.0, 0.0])


class Outdoors:
    """A scenario that has such a table."""

    Table = tables(Wind, bases={}, module=__name__)["wind"]

    def __init__(self, **keys):
        self.wind = validate(self.Table, keys, "a scenario", "wind.")


def test_a_field_is_all_an_effect_needs_to_be_read_checked_and_stacked():
    assert from_scenarios(Wind, [Outdoors()]).acceleration == 0.0
    assert from_scenarios(Wind, [Outdoors(acceleration_mm=5.0)] * 3).acceleration == 0.005
    each = from_scenarios(Wind, [Outdoors(acceleration_mm=float(mm)) for mm in (0, 5, -5)])
    assert each.push(np.zeros((3, 2))).tolist() == [[0, 0], [0.005, 0], [-0.005, 0]]
    with pytest.raises(ScenarioError, match=r"wind\.acceleration_mm: must be less than or equal"):
        Outdoors(acceleration_mm=2000.0)
    with pytest.raises(ScenarioError, match="did you mean 'acceleration_mm'"):
        Outdoors(acceleration=5.0)


class Frictionless:
    """A plant: the ball's flat equations x'' = k1 (phi, -theta), and nothing else."""

    ratio = 1.0
    channels: tuple[str, ...] = ()

    def __init__(self, rigs, step):
        self.rigs, self.step, self.x = rigs, step, np.zeros((rigs, 8))
        self.start(np.zeros((rigs, 4)))

    def start(self, ball, spin=0.0):
        self.begin(np.arange(self.rigs), ball)

    def begin(self, rigs, ball, spin=0.0):
        self.x[rigs] = 0.0
        self.x[rigs[:, None], (0, 1, 4, 5)] = ball

    def advance(self, motor_rate, steps):
        for _ in range(steps):
            pull = 5.886 * self.x[:, 2::4] * np.array([1.0, -1.0])
            self.x[:, 3::4] = motor_rate
            self.x[:, 0::4] += self.step * self.x[:, 1::4]
            self.x[:, 1::4] += self.step * pull
            self.x[:, 2::4] += self.step * motor_rate

    @property
    def state(self):
        return self.x.copy()

    @property
    def motor(self):
        return self.x[:, 2::4]

    @property
    def on_plate(self):
        return np.ones(self.rigs, bool)

    @property
    def diverged(self):
        return ~np.isfinite(self.x).all(axis=1)

    def telemetry(self):
        return self.x[:, :0]


@pytest.fixture
def own():
    """A kind of plant that no scenario could name before."""

    def build(scenarios, threads):
        return Frictionless(len(scenarios), scenarios[0].plant.step), FixedRatio()

    register("frictionless", PlantKind(build, "without friction"))
    yield "plant.kind=frictionless"
    del PLANTS["frictionless"]
    NAMED.remove("frictionless")


def test_a_plant_that_nobody_registered_is_refused_in_a_line(monkeypatch):
    # what others may have registered in this process is not there
    monkeypatch.setattr("twin.scenario.rig_tables.PLANT_KINDS", ["mujoco", "lagrange"])
    with pytest.raises(ScenarioError, match=r"plant\.kind: must be 'mujoco' or 'lagrange', got"):
        load("circle", ["plant.kind=frictionless"])


def test_a_plant_that_nobody_knows_how_to_change_is_refused_in_a_line(own):
    change = 'change=[{at=0.5, set={"plant.friction.rolling_mm"=0.1}}]'
    with pytest.raises(ModelError, match=r"plant\.kind: Frictionless cannot be changed"):
        run(load("circle", [*EXACT, own, change]))
    episodes = Episodes([load("circle", [*EXACT, own])] * 2)
    episodes.begin(np.array([1]), [load("circle", [*EXACT, own, "plant.start.x=0.1"])])
    assert episodes.state[:, 0].tolist() == [0.0, 0.1]
    with pytest.raises(ModelError, match=r"plant\.kind: Frictionless cannot be changed"):
        episodes.begin(np.array([1]), [load("circle", [*EXACT, own, "plant.ball.mass=0.1"])])


def test_a_plant_is_named_by_its_kind_in_every_way_to_run_one(own):
    settings = ["duration=0.1", "metrics.start=0", own]
    result = bp.run("circle", settings, baseline=False)
    assert result.label == "without friction"
    assert len(simulate([load("circle", settings)] * 2)) == 2
    with bp.rig("circle", settings) as rig:
        rig.step(np.zeros((1, 2)))


def test_a_plant_is_one_class_and_one_entry(own):
    clean = load("circle", [*EXACT, "plant.friction.rolling_mm=0", "disturbance.variance=[0,0]"])
    exact = run(clean)
    flat = run(load("circle", [*EXACT, own, "disturbance.variance=[0,0]"]))
    # nearly the same motion as on the exact equations, whose small terms it lacks
    apart = np.abs(flat.record["state"][..., 0::4] - exact.record["state"][..., 0::4]).max()
    assert 1e-6 < apart < 2e-3
    both = [load("circle", [*EXACT, own, f"plant.start.y={y}"]) for y in (0.0, 0.1)]
    many, _ = assemble(both)
    assert many.devices.state[:, 4].tolist() == [0.0, 0.1]
