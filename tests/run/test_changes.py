"""`twin.run`.

[[change]]: what a scenario changes of its rig while it runs, on both plants."""

import numpy as np
import pytest
from every_setting import OTHER, QUIET

from controllers.ballplate import BallPlate
from twin.base.errors import ScenarioError
from twin.run.assemble import assemble
from twin.run.finished import run
from twin.run.loop import drive
from twin.run.plants import PLANTS as KINDS
from twin.run.plants import build_plant
from twin.run.record import Recorder
from twin.scenario.changing import at_time
from twin.scenario.load import load
from twin.scenario.rig_tables import LEFT_OUT
from twin.scenario.schema import JUMP_KEYS, RAMP_KEYS

PLANTS = ("lagrange", "mujoco")


def scenario(plant, change, *more, duration=1.5):
    return load(
        "circle", [f"plant.kind={plant}", f"duration={duration}", f"change={change}", *more]
    )


def one(key, value, at=1.0, over=0.0):
    return f'[{{at={at}, over={over}, set={{"{key}"={value}}}}}]'


def columns(found, name):
    return found.record[name][:, 0]


@pytest.mark.short("lagrange-plant.friction*", "mujoco-rig*", "lagrange-sensors.touch.lost*")
@pytest.mark.parametrize(
    ("plant", "key", "value"),
    [
        ("lagrange", "plant.friction.rolling_mm", 0.36),
        ("mujoco", "plant.friction.rolling_mm", 0.36),
        ("lagrange", "plant.servo.bandwidth_hz", 5.0),
        ("lagrange", "sensors.encoders.variance", [1e-6, 1e-6]),
        ("lagrange", "sensors.touch.lost", 0.5),
        ("lagrange", "sensors.touch.frame_rate", 20.0),
        ("mujoco", "sensors.touch.rotation_deg", 2.0),
        ("mujoco", "rig.cam_error_percent", [9.0, 5.0]),
    ],
)
def test_until_a_change_begins_the_run_is_the_one_without_it_and_then_another(plant, key, value):
    moving = "plant.start.x_rate=0.1", "sensors.touch.frame_rate=80"
    change = one(key, value, at=0.2)
    without = run(scenario(plant, "[]", *moving, duration=0.4))
    changed = run(scenario(plant, change, *moving, duration=0.4))
    before = without.record.time <= 0.2
    for name in ("state", "measured", "estimate", "applied"):
        assert np.array_equal(columns(without, name)[before], columns(changed, name)[before])
    assert not np.array_equal(columns(without, "state"), columns(changed, "state"))


def speed_after(plant, speed, change):
    """Speeds at both ends of 0.1 s of a ball that rolls along x on a held plate after a change.

    The mechanism's contact takes some 25 ms to pass on what has changed.
    """
    base = load("circle", [f"plant.kind={plant}", "duration=10", *QUIET])
    simulated, _ = build_plant([base])
    simulated.start(np.array([[0.0, speed, 0.0, 0.0]]))
    simulated.advance(np.zeros((1, 2)), 100)
    KINDS[plant].change(simulated, [at_time(scenario(plant, change, *QUIET), 1.0)])
    simulated.advance(np.zeros((1, 2)), 200)
    first = simulated.state[0, 1]
    simulated.advance(np.zeros((1, 2)), 100)
    return first, simulated.state[0, 1]


SOLID = 0.4 * 0.05 * 0.02**2
HEAVY = (
    '[{at=1.0, set={"plant.level_deg"=[1.0, 0.0], "plant.ball.mass"=0.05, '
    f'"plant.ball.inertia"={SOLID}}}}}]'
)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize(
    ("change", "ball", "arm", "slope"),
    [
        (one("plant.friction.rolling_mm", 0.36), BallPlate(), 0.36e-3, 0.0),
        (one("plant.level_deg", [1.0, 0.0]), BallPlate(), 0.18e-3, 1.0),
        (HEAVY, BallPlate(mass=0.05, inertia=SOLID), 0.18e-3, 1.0),
    ],
    ids=["friction", "slope", "another ball"],
)
def test_a_ball_rolls_on_as_what_was_changed_accelerates_it(plant, change, ball, arm, slope):
    first, last = speed_after(plant, 0.3, change)
    friction = ball.c1 * arm / ball.radius * ball.gravity
    down = ball.c1 * ball.gravity * np.sin(np.radians(slope))
    assert (last - first) / 0.1 == pytest.approx(down - friction, rel=0.01)


@pytest.mark.parametrize("longer", [0.052, 0.030])
def test_samples_come_late_by_the_dead_time_that_is_in_force(longer):
    late, moving = "sensors.touch.dead_time=0.042", "plant.start.x_rate=0.1"
    change, free = one("sensors.touch.dead_time", longer), "plant.friction.rolling_mm=0.0"
    found = run(scenario("lagrange", change, *QUIET, late, moving, free))
    seen, true = columns(found, "measured")[:, 0], columns(found, "state")[:, 0]
    assert len(set(true[400:700])) == 300
    before, after = round(0.042 / 0.002), round(longer / 0.002)
    assert np.array_equal(seen[100:500], true[100 - before : 500 - before])
    assert np.array_equal(seen[540:700], true[540 - after : 700 - after])
    # the oldest that is kept, two periods older than what is shown, stays until the next arrives
    least = min(before, after)
    assert all(seen[tick] in true[498 - before : tick - least + 1] for tick in range(500, 540))


def test_a_ramp_goes_straight_from_the_old_value_to_the_new_one():
    two = (
        '[{at=1.0, over=0.4, set={"plant.friction.rolling_mm"=0.38}}, '
        '{at=1.5, set={"plant.level_deg"=[0.1, 0.0]}}]'
    )
    base = scenario("mujoco", two, duration=3)
    rolling = [at_time(base, t).plant.friction.rolling_mm for t in (0.9, 1.0, 1.1, 1.4, 2.0)]
    assert rolling == pytest.approx([0.18, 0.18, 0.23, 0.38, 0.38])
    assert at_time(base, 1.49).plant.level_deg == (0.0, 0.0)
    assert at_time(base, 1.5).plant.level_deg == (0.1, 0.0)


CHANGES = (
    "[]",
    one("plant.friction.rolling_mm", 0.36, at=0.1, over=0.1),
    '[{at=0.1, set={"plant.level_deg"=[0.2, 0.1], "plant.servo.backlash_deg"=0.1}}]',
    '[{at=0.2, set={"sensors.touch.dead_time"=0.085, "rig.cam_error_percent"=[4.0, 2.0]}}]',
    '[{at=0.2, set={"sensors.touch.variance"=[1e-6, 1e-6], "plant.servo.bandwidth_hz"=8.0}}]',
    '[{at=0.1, set={"plant.servo.slew_deg"=3.0, "plant.servo.resolution_deg"=0.03, '
    '"plant.servo.acceleration_deg"=20.0, '
    '"plant.servo.resonance_hz"=12.0}}]',
    '[{at=0.24, set={"plant.servo.deadband_deg"=0.05, "plant.servo.resolution_deg"=0.04, '
    '"plant.servo.resonance_hz"=12.0}}]',
    one("sensors.touch.lost", 0.5, at=0.1),
)


@pytest.mark.long
@pytest.mark.parametrize("plant", PLANTS)
def test_rigs_side_by_side_change_as_each_of_them_does_alone(plant):
    # with dead times of their own: what one screen remembers is not what another does
    waits = [f"sensors.touch.dead_time={0.02 + 0.015 * i}" for i in range(len(CHANGES))]
    # and a camera that begins to lose frames beside one that has lost some all along
    frames = "sensors.touch.frame_rate=80", "sensors.touch.jitter=0.003"
    more = {0: (*frames, "sensors.touch.lost=0.3"), len(CHANGES) - 1: frames}
    moving = "plant.start.x_rate=0.1"
    each = [
        scenario(plant, change, f"seed={i}", wait, moving, *more.get(i, ()), duration=0.4)
        for i, (change, wait) in enumerate(zip(CHANGES, waits, strict=True))
    ]
    rig, controller = assemble(each)
    record = Recorder(200, len(each), 0.002)
    drive(rig, controller, 0.4, record)
    for number, alone in enumerate(each):
        found = run(alone)
        for name in ("state", "measured"):
            assert np.abs(record[name][:, number] - columns(found, name)).max() < 1e-9, name


def commanded(scenarios, ticks):
    """States of rigs side by side under one sequence of commands, shape (ticks, N, 8)."""
    rig, _ = assemble(scenarios, threads=1, unseen=True)
    found = []
    with rig:
        rig.read()
        rig.start()
        for tick in range(ticks):
            rate = 0.25 * np.array([np.sin(0.018 * tick), np.cos(0.014 * tick + 0.4)])
            rig.write(np.tile(rate, (len(scenarios), 1)))
            rig.wait()
            rig.read()
            found.append(rig.devices.state)
    return np.array(found)


EVERY = {
    (plant, key)
    for plant in PLANTS
    for key in RAMP_KEYS + JUMP_KEYS
    if key in OTHER and key not in LEFT_OUT[plant]
}
QUICK = {("mujoco", "plant.level_deg")}


@pytest.mark.short("*camber0")
@pytest.mark.parametrize("camber", [(), ("plant.camber=[0.3,-0.2]",)])
@pytest.mark.parametrize(
    ("plant", "key"),
    [
        pytest.param(*each, marks=() if each in QUICK else pytest.mark.long)
        for each in sorted(EVERY)
    ],
)
def test_rigs_side_by_side_change_to_the_bit_as_each_of_them_does_alone(plant, key, camber):
    """Also those that do not all stand equally level to begin with."""
    rng, each, ticks = np.random.default_rng(1), [], 75
    for number in range(9):
        own = [f"{name}={rng.uniform(-0.1, 0.1)}" for name in ("plant.start.x", "plant.start.y")]
        own += [f"plant.friction.rolling_mm={rng.uniform(0.1, 0.3)}", f"seed={number}", *camber]
        own.append(f"plant.level_deg={rng.uniform(-0.5, 0.5, 2).tolist()}")
        to = rng.uniform(-1, 1, 2).tolist() if key == "plant.level_deg" else OTHER[key]
        each.append(scenario(plant, one(key, to, at=0.1), *own, "sensors.touch.frame_rate=90"))
    together = commanded(each, ticks)
    for number, alone in enumerate(each):
        assert np.array_equal(commanded([alone], ticks)[:, 0], together[:, number]), number


WRONG = {
    '[{at=1, set={"plant.ball.radius"=0.03}}]': "cannot change during a run (allowed: plant",
    '[{at=1, set={"plant.ball.kind"="steel"}}]': "plant.ball.kind: cannot change during",
    '[{at=1, set={"controller.kind"="lqr"}}]': "controller.kind: cannot change during",
    '[{at=1, over=1, set={"plant.ball.mass"=0.03}}]': "plant.ball.mass: changes at once; leave out",
    '[{at=1, set={"plant.friction.rolling_mm"=-1}}]': "rolling_mm: must be greater than or equal",
    '[{at=1, set={"plant.friction.rolling_mm"="much"}}]': "rolling_mm: must be a number",
    '[{at=1, set={"plant.servo.torque_limit"=2.0}}]': "the exact equations have ideal motors",
    '[{at=9, set={"plant.friction.rolling_mm"=0.2}}]': "change.0.at: 9 s is not before the end",
    '[{at=-1, set={"plant.friction.rolling_mm"=0.2}}]': "change.0.at: must be greater",
    '[{at=1, over=0.5, set={"plant.servo.bandwidth_hz"=5.0}}]': "0 stands for none",
    '[{at=1, over=0.5, set={"plant.servo.slew_deg"=5.0}}]': "0 stands for none",
    "[{at=1, set={}}]": "change.0.set: name at least one",
    (
        '[{at=1, over=1, set={"plant.friction.rolling_mm"=0.2}}, '
        '{at=1.5, set={"plant.friction.rolling_mm"=0.3}}]'
    ): "changes again at 1.5 s, before what began at 1 s is over",
}


@pytest.mark.parametrize(("change", "says"), WRONG.items())
def test_what_no_plant_can_change_while_it_runs_is_one_line(change, says):
    with pytest.raises(ScenarioError, match=r"^circle\.toml: ") as refused:
        scenario("lagrange", change, duration=5)
    assert says in str(refused.value)


def test_the_engine_has_no_friction_between_none_and_its_least():
    with pytest.raises(ScenarioError, match=r"on the way: plant\.friction\.rolling_mm: must be 0"):
        scenario("mujoco", one("plant.friction.rolling_mm", 0.0, over=0.2))


@pytest.mark.parametrize("plant", PLANTS)
def test_a_ball_is_placed_on_a_plate_that_tilts_and_turns(plant):
    simulated, _ = build_plant([load("circle", [f"plant.kind={plant}", "duration=10"])])
    rate = np.array([[0.2, -0.3]]) * simulated.ratio
    simulated.advance(rate, 200)
    before = simulated.state[0].copy()
    ball = 0.11, 0.2, -0.07, -0.1
    simulated.place(np.array([ball]))
    placed = simulated.state[0]
    assert placed[[0, 1, 4, 5]] == pytest.approx(ball, abs=1e-6)
    assert placed[[2, 3, 6, 7]] == pytest.approx(before[[2, 3, 6, 7]], abs=1e-12)
    # it rolls: nothing jerks it in the first steps
    simulated.advance(rate, 5)
    assert simulated.state[0, [1, 5]] == pytest.approx((0.2, -0.1), abs=0.02)
