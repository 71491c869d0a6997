"""`twin.run.loop`.

Rigs that begin again while others go on: nobody's bits depend on who begins when beside him."""

import numpy as np
import pytest

from twin.base.errors import ModelError, ScenarioError
from twin.run.loop import Episodes
from twin.sim.sensors import Noise
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder

BUILD = Builder("circle")
EVERYTHING = (
    "plant.servo.acceleration_deg=3000.0",
    "plant.servo.hysteresis_deg=0.1", "plant.servo.resonance_hz=15.0", "plant.servo.vibration=1.0",
    "plant.servo.vibration_wander=0.5", "disturbance.variance=[1e-4, 1e-4]",
    "sensors.touch.dead_time_spread=0.002", "sensors.touch.rotation_deg=1.0",
    "sensors.touch.jitter=0.003", "sensors.touch.lost=0.2", "sensors.touch.frame_rate=70",
)  # fmt: skip
"""What the shipped family leaves out of what has a past."""
BEGUN = np.array([0, 2])
"""The rigs that begin again."""


@pytest.fixture(autouse=True)
def drawn_often(monkeypatch):
    """Let random streams be drawn from every few periods, so that their state counts."""
    monkeypatch.setattr(Noise, "BLOCK", 16)


def family(count, draw, *fixed):
    """Rigs of the shipped family, which differ in nearly everything."""
    rigs = draw_rigs(read_family("uncertain"), draw, count)
    return [BUILD([f"seed={rig.seed}", *fixed], rig.point) for rig in rigs]


def nominal(count, draw, *fixed):
    """Rigs that differ in their noise alone."""
    return [BUILD([f"seed={1000 * draw + rig}", *fixed], {}) for rig in range(count)]


def mixed(count, draw, *fixed):
    """The same, but for the third, which has another spring and a tilted base."""
    other = ("plant.spring.preload=100.0", "plant.level_deg=[0.3, -0.2]")
    return [
        BUILD([f"seed={1000 * draw + rig}", *fixed, *(other if rig == BEGUN[1] else ())], {})
        for rig in range(count)
    ]


def rates(step, count):
    """Plate rates in rad/s that are the same in every batch."""
    return 0.05 * np.random.default_rng(step).standard_normal((count, 2))


@pytest.mark.short("mixed-*")
@pytest.mark.parametrize(
    ("make", "others", "count", "fixed"),
    [
        (mixed, nominal, 3, ("plant.friction.breakaway_ratio=1.5", "plant.start.x_rate=0.05")),
        (nominal, nominal, 3, ("plant.kind=lagrange", *EVERYTHING)),
        pytest.param(family, family, 3, EVERYTHING, marks=pytest.mark.long),
        pytest.param(nominal, family, 16, (), marks=pytest.mark.long),
    ],
)
def test_a_rig_that_begins_among_others_runs_as_one_that_began_with_them(
    make, others, count, fixed
):
    first, later = make(count, 1, *fixed), others(len(BEGUN), 2, *fixed)
    joined, undisturbed = Episodes(first), Episodes(first)
    for step in range(4):  # 80 ms, a multiple of all that rigs look at together
        joined.advance(rates(step, count), 10)
        undisturbed.advance(rates(step, count), 10)
    joined.begin(BEGUN, later)
    together = list(first)
    for rig, scenario in zip(BEGUN, later, strict=True):
        together[rig] = scenario
    alone = Episodes(together)
    going = np.setdiff1d(np.arange(count), BEGUN)
    assert joined.ticks[BEGUN].tolist() == [0, 0]
    for step in range(100, 110):
        for who, same in ((BEGUN, alone), (going, undisturbed)):
            for seen, wanted in zip(joined.measurement[1:4], same.measurement[1:4], strict=True):
                np.testing.assert_array_equal(seen[who], wanted[who])
            np.testing.assert_array_equal(joined.applied[who], same.applied[who])
        ball = joined.advance(rates(step, count), 10)
        np.testing.assert_array_equal(
            ball[:, BEGUN], alone.advance(rates(step, count), 10)[:, BEGUN]
        )
        same = undisturbed.advance(rates(step, count), 10)
        np.testing.assert_array_equal(ball[:, going], same[:, going])
    assert not joined.over.any()


SMOOTH = ("duration=5", "metrics.start=0", "plant.friction.rolling_mm=0.01")
RODS = ("parameters=course", *SMOOTH)
CAMS = ("rig.limits.area=[0.1,0.1]", "reference.amplitude=0.05", "plant.size=[0.35,0.35]", *SMOOTH)
EXACT = ("parameters=hobby", *SMOOTH, "plant.surface.spread_percent=20")


@pytest.mark.long
@pytest.mark.parametrize(
    ("count", "fixed", "plate"),
    [
        (3, EXACT, ("plant.size=[0.42,0.4]",)),
        (3, EXACT, ("plant.size=[0.4,0.4]", "plant.shape=round")),
        (3, (*RODS, "plant.kind=mujoco"), ("plant.size=[0.4,0.3]",)),
        (16, (*RODS, "plant.kind=mujoco"), ("plant.size=[0.4,0.3]",)),
        (3, (*RODS, "plant.kind=mujoco"), ("plant.size=[0.4,0.4]", "plant.shape=round")),
        (16, CAMS, ("plant.size=[0.4,0.4]", "plant.shape=round")),
    ],
)
def test_an_episode_on_another_plate_ends_at_its_edge(count, fixed, plate):
    """Out to x = 0.2 m or so: off the plates of 0.3 m that they began with, on or off the new."""
    first = nominal(count, 1, *fixed)
    rolls = (*fixed, *plate, "plant.start.x_rate=0.08")
    starts = [("plant.start.x=0.15",), ("plant.start.x=0.19",)]
    later = [BUILD([*rolls, *more, f"seed={rig}"], {}) for rig, more in enumerate(starts)]
    joined = Episodes(first, threads=1)
    joined.advance(np.zeros((count, 2)), 20)
    joined.begin(BEGUN, later)
    together = list(first)
    for rig, scenario in zip(BEGUN, later, strict=True):
        together[rig] = scenario
    alone = Episodes(together, threads=1)
    for _ in range(8):
        balls = [each.advance(np.zeros((count, 2)), 20) for each in (joined, alone)]
        np.testing.assert_array_equal(*(ball[:, BEGUN] for ball in balls))
        fallen = [each._rig.fallen for each in (joined, alone)]
        np.testing.assert_array_equal(*(each[BEGUN] for each in fallen))
        assert not fallen[0][1]
    # the one is beyond the edge of the plate before, the other beyond that of its own
    assert balls[0][-1, 0, 0] == pytest.approx(0.175, abs=0.003)
    assert fallen[0][BEGUN].tolist() == [False, True]


def test_what_all_episodes_share_is_not_changed_by_one_of_them():
    rigs = Episodes(nominal(2, 1, "plant.kind=lagrange"))
    for key, value in (("rig.limits.rate_deg", 20), ("plant.step", 0.002)):
        other = BUILD(["plant.kind=lagrange", f"{key}={value}"], {})
        with pytest.raises(ScenarioError, match=rf"{key.removesuffix('.rate_deg')}.* must agree"):
            rigs.begin(np.array([1]), [other])


def test_an_episode_that_cannot_begin_leaves_scenarios_and_plant_together(monkeypatch):
    episodes = Episodes(nominal(3, 1), threads=1)
    before = list(episodes.scenarios)

    def refuse(*_):
        raise ModelError("no such spring")

    monkeypatch.setattr("twin.run.assemble.build_rig", refuse)
    with pytest.raises(ModelError):
        episodes.begin(BEGUN, nominal(2, 2))
    assert episodes.scenarios == before
