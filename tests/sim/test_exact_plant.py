"""Tests of `twin.sim.plant.exact`."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controllers.ballplate import BallPlate
from twin.hal.linkage import Linkage, TiltTable
from twin.run.finished import run
from twin.run.plants import build_friction, build_plant, start_plant
from twin.scenario import load
from twin.sim.plant.exact import ExactPlant, RollingModel, rolling
from twin.sim.plant.friction import Friction, SurfaceMap
from twin.sim.plant.interface import tilted_gravity

MODEL = BallPlate()


LINKAGE = Linkage(crank=(0.04, 0.03), rod=(0.09, 0.1), arm=(0.1, 0.07), distance=(0.05, 0.045))


@pytest.mark.long
def test_cranks_that_ramp_take_the_plate_where_the_linkage_does_without_drift():
    plant = ExactPlant(step=0.001, linkage=LINKAGE)
    rate = before = crank = np.zeros(2)
    for tick in range(3000):
        rate = np.array([0.5, -0.4]) * np.sin(0.004 * tick * np.array([1.0, 1.3]))
        plant.advance(rate[None], 2)
        crank = crank + 0.002 * (before + rate) / 2
        before = rate
        assert plant.state[0, 2::4] == pytest.approx(LINKAGE.plate(crank), abs=1e-11)
    assert plant.motor[0] == pytest.approx(crank, abs=1e-11)
    nudged = [LINKAGE.plate(crank + side * rate) for side in (1e-6, -1e-6)]
    assert plant.state[0, 3::4] == pytest.approx((nudged[0] - nudged[1]) / 2e-6, abs=1e-7)


@pytest.mark.long
@pytest.mark.parametrize(("rows", "most"), [(9, 0.02), (33, 4e-4)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_table_made_of_a_linkage_takes_the_plate_where_that_does(axis, rows, most):
    """One axis at a time: a table does not know that theta moves phi a little."""
    servo = np.stack((np.linspace(-0.8, 0.8, rows),) * 2)
    both = np.stack([LINKAGE.plate(np.eye(2)[k] * servo[k][:, None])[:, k] for k in (0, 1)])
    phi, theta = (tuple(zip(*each, strict=True)) for each in zip(servo, both, strict=True))
    plants = [
        ExactPlant(step=0.001, linkage=each, friction=Friction(rolling=1e-4))
        for each in (LINKAGE, TiltTable(phi=phi, theta=theta))
    ]
    off = []
    for tick in range(1500):
        rate = np.eye(2)[axis] * 2.0 * np.cos(0.006 * tick)  # cranks to 0.67 rad and back
        for plant in plants:
            plant.advance(rate[None], 2)
        tilt = [plant.state[0, 2::4] for plant in plants]
        off.append(np.abs(tilt[0] - tilt[1]).max())
    assert np.abs(plants[0].motor).max() < 0.7
    assert np.degrees(max(off)) < most
    assert plants[0].state[0, 3::4] == pytest.approx(plants[1].state[0, 3::4], abs=0.05)


@pytest.mark.long
def test_a_table_of_a_straight_line_is_a_gain():
    keys = ["plant.kind=lagrange", "duration=0.5", "metrics.start=0"]
    line = [f"plant.linkage.{axis}_deg=[[-40,-{t}],[20,{t / 2}],[40,{t}]]" for axis, t in
            (("phi", 12), ("theta", 16))]  # fmt: skip
    wrong = "rig.cam_error_percent=[5.0,-3.0]"  # the gain that nobody told
    for more in ([], ["plant.servo.backlash_deg=0.1", "plant.servo.bandwidth_hz=5.0", wrong]):
        plain = run(load("circle", [*keys, *more])).record["state"]
        for cams in ("table", "ratio"):
            found = run(load("circle", [*keys, *more, *line, f"rig.cams={cams}"]))
            np.testing.assert_allclose(found.record["state"], plain, rtol=0, atol=1e-8)


def test_on_rods_the_ball_moves_as_on_a_plate_that_is_told_the_same_motion_in_small_steps():
    plant, told = ExactPlant(step=0.001, linkage=LINKAGE), ExactPlant(step=0.0001)
    for each in (plant, told):
        each.start(np.array([[0.05, 0.05, -0.03, 0.1]]))
    crank = before = np.zeros(2)
    for tick in range(120):
        rate = np.radians(200) * np.sin(tick * np.array([0.03, 0.04]))
        plant.advance(rate[None], 2)
        for part in (np.arange(20) + 1) / 20:
            there = crank + 0.002 * part * (before + part / 2 * (rate - before))
            now = before + part * (rate - before)
            told.advance(LINKAGE.plate_rate(LINKAGE.plate(there), there, now)[None], 1)
        crank, before = there, rate
    assert np.abs(plant.state[0, 2::4]).min() > 0.03
    assert plant.state == pytest.approx(told.state, abs=1e-6)


def test_a_ball_that_left_the_screen_has_fallen_for_good():
    plant = ExactPlant()
    plant.start(np.array([[0.349, 1.0, 0.0, 0.0]]))
    plant.advance(np.zeros((1, 2)), 2)
    assert not plant.on_plate[0]
    plant._x[:, 0] = 0.0
    plant.advance(np.zeros((1, 2)), 2)
    assert not plant.on_plate[0]


def plain_rk4(x, u, step, arm):
    """One step of one rig, straight from the model's own derivative and Coulomb's law."""

    def limit(x):
        return MODEL.c1 * arm / MODEL.radius * MODEL.gravity * np.cos(x[2]) * np.cos(x[6])

    def rate(x):
        out = MODEL.derivative(x, u)
        velocity, free = x[1::4], out[1::4].copy()
        speed, push = np.hypot(*velocity), np.hypot(*free)
        if speed > 0:
            out[1::4] = free - limit(x) * velocity / speed
        else:
            out[1::4] = free * max(0.0, 1 - limit(x) / push) if push > 0 else 0.0
        return out

    k1 = rate(x)
    k2 = rate(x + step / 2 * k1)
    k3 = rate(x + step / 2 * k2)
    k4 = rate(x + step * k3)
    after = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    resting = x.copy()
    resting[1::4] = 0.0
    pushed = np.hypot(*MODEL.derivative(resting, u)[1::4]) > limit(x)
    if arm and np.hypot(*x[1::4]) <= limit(x) * step and not pushed:
        after[1::4] = 0.0
    return after


def random_states(count):
    """Ball and plate anywhere; of the balls one third rests and one third is about to."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-1, 1, (count, 8)) * (0.2, 0.3, 0.15, 0.6, 0.15, 0.3, 0.15, 0.6)
    x[::3, 1::4] = 0.0
    x[1::3, 1::4] *= 1e-4
    x[::2, 2:4] *= 0.02
    x[::2, 6:8] *= 0.02
    return x


def periods(states, commands, **plant):
    """The states after these commands of two steps each, all rigs in one plant."""
    plant = ExactPlant(rigs=len(states), **plant)
    plant.resume(states)
    for command in commands:
        plant.advance(np.tile(command, (len(states), 1)), 2)
    return plant.state


@pytest.mark.parametrize("arm", [0.0, 2e-4])
@pytest.mark.parametrize("together", [False, True])
def test_random_states_move_as_the_models_derivative_under_coulomb_friction_says(arm, together):
    friction = Friction(rolling=arm) if arm else None
    states, commands = random_states(60), np.random.default_rng(6).uniform(-0.1, 0.1, (5, 2))
    groups = [states] if together else [state[None] for state in states]
    about = {"friction": friction, "ball_spin": "thesis"}
    found = np.concatenate([periods(group, commands, **about) for group in groups])
    for state, end in zip(states, found, strict=True):
        for command in commands:
            u = (command - state[3::4]) / 0.002
            for _ in range(2):
                state = plain_rk4(state, u, 0.001, arm)  # noqa: PLW2901
        # the plate's motion is in closed form here and by RK4 there
        assert end == pytest.approx(state, rel=1e-8, abs=1e-8)


ROLLING, TILTED = {"friction": Friction(rolling=2e-4)}, {"level": (0.01, -0.02)}


@pytest.mark.short("about[0-3]", "about[56]")
@pytest.mark.parametrize(
    "about",
    [
        *({}, ROLLING, TILTED, ROLLING | TILTED, ROLLING | {"linkage": LINKAGE}),
        *({"ball_spin": "locked"}, ROLLING | {"ball_spin": "thesis"}),
    ],
)
def test_one_rig_alone_moves_to_the_bit_as_among_others(about):
    states, commands = random_states(30), np.random.default_rng(7).uniform(-0.1, 0.1, (50, 2))
    together = periods(states, commands, **about)
    for state, expected in zip(states, together, strict=True):
        alone = periods(state[None], commands, **about)
        assert alone[0].tolist() == expected.tolist()


def test_one_rig_of_constant_friction_moves_to_the_bit_as_among_others_that_stick_and_slope():
    states, commands = random_states(9), np.random.default_rng(8).uniform(-0.1, 0.1, (50, 2))
    ratios = np.where(np.arange(9) == 4, 1.0, 1.5)
    slope = np.zeros((9, 2, 2))
    slope[5:, 1] = 0.01
    mixed = Friction(rolling=2e-4, breakaway_ratio=ratios, map=SurfaceMap(height=slope))
    together = periods(states, commands, friction=mixed)
    alone = periods(states[4:5], commands, friction=Friction(rolling=2e-4))
    assert alone[0].tolist() == together[4].tolist()


@pytest.mark.parametrize("rounded", [[True], [True, False, True]])
def test_from_a_round_plate_the_ball_falls_where_the_circle_ends(rounded):
    rigs = len(rounded)
    plant = ExactPlant(rigs=rigs, size=(0.3, 0.3), rounded=rounded)
    there = np.array([0.1, 0.1, 0.1, 0.1])  # 141 mm from the middle, outwards at 141 mm/s
    plant.start(np.tile(there, (rigs, 1)))
    for tick in range(100):
        plant.advance(np.zeros((rigs, 2)), 2)
        past = np.hypot(0.1, 0.1) * (1 + 0.002 * (tick + 1)) > 0.15
        assert plant.on_plate.tolist() == [not (past and disc) for disc in rounded]
    assert past


CAMBER = ("plant.camber=[0.35,-0.5]", "plant.start.x=0.05", "plant.start.y=-0.1")
SMOOTH = ("plant.friction.rolling_mm=0", "plant.step=0.002")


@pytest.mark.short("mujoco-*", "lagrange-steel")
@pytest.mark.parametrize("ball", ["hollow", "steel"])
@pytest.mark.parametrize("kind", ["lagrange", "mujoco"])
def test_on_a_level_plate_with_camber_the_ball_moves_as_a_hyperbolic_cosine(kind, ball):
    chosen = (f"plant.kind={kind}", f"plant.ball.kind={ball}", *CAMBER, *SMOOTH)
    others = [(*chosen, f"plant.camber={camber}") for camber in ("[-2,0]", "[0,0]")]
    scenarios = [load("hold", each) for each in (chosen, *others)]
    plant, _ = build_plant(scenarios)
    start_plant(plant, scenarios)
    plant.advance(np.zeros((3, 2)), 500)
    x, y, given = plant.state[:, 0] - 0.05, plant.state[:, 4] + 0.1, plant.state[2, 0::4]
    cosines = [np.cosh(np.sqrt(0.35)), np.cos(np.sqrt(2.0)), np.cos(np.sqrt(0.5))]
    far = np.multiply((0.05, 0.05, -0.1), np.subtract(cosines, 1))
    # the mechanism's plate gives way under the ball, which moves it without camber, too
    gives = np.abs(given - (0.05, -0.1)) + 1e-10
    within = 1e-8 if kind == "lagrange" else 5e-3
    assert x[:2] - x[2] == pytest.approx(far[:2], abs=gives[0], rel=within)
    assert y[:2] - y[2] == pytest.approx([far[2], 0.0], abs=gives[1], rel=within)


def test_camber_comes_on_top_of_what_a_surface_has_and_a_rig_beside_has_none():
    uneven = ("plant.kind=lagrange", "plant.surface.spread_percent=20", "plant.surface.slope_deg=1")
    places = np.random.default_rng(0).uniform(-0.19, 0.19, (50, 2))
    flat, bowed = (
        build_friction([load("hold", (*uneven, f"plant.camber={camber}"))]).map
        for camber in ("[0,0]", "[0.35,0]")
    )
    push = MODEL.c1 * MODEL.gravity
    (before, slope), (after, bowing) = flat(places), bowed(places)
    assert after.tolist() == before.tolist()
    assert (slope - bowing)[:, 0] == pytest.approx(0.35 / push * places[:, 0])
    assert (slope - bowing)[:, 1] == pytest.approx(np.zeros(50), abs=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("friction", [None, Friction(rolling=2e-4)])
@pytest.mark.parametrize("rigs", [1, 2])
@pytest.mark.parametrize(
    ("place", "value"), [(0, np.inf), (1, 1.7e308), (3, 1e200), (2, np.inf), (4, np.nan)]
)
def test_numbers_that_run_away_end_as_diverged(friction, rigs, place, value):
    plant = ExactPlant(rigs=rigs, friction=friction)
    plant._x[0] = 0.1
    plant._x[0, place] = value
    with np.errstate(all="ignore"):
        for _ in range(5):
            plant.advance(np.full((rigs, 2), 1e200 if place == 3 else 10.0), 200)
    assert plant.diverged.tolist() == [True, *[place == 3] * (rigs - 1)]


def test_one_ball_that_runs_away_does_so_without_a_warning():
    plant = ExactPlant(friction=Friction(rolling=2e-4))
    plant.start(np.array([[1e200, 1e200, -1e200, 1e160]]))
    plant.advance(np.array([[1e3, -1e3]]), 20)
    plant.advance(np.array([[1e100, -1e100]]), 200)
    assert plant.diverged.tolist() == [True]


@pytest.mark.parametrize("level", [(0.0, 0.0), (0.02, -0.01)])
def test_the_equations_of_the_thesis_on_a_given_plate_are_the_models_own(level):
    rng = np.random.default_rng(9)
    x, u = rng.normal(0, 0.3, (200, 8)), rng.normal(0, 5, (200, 2))
    angle, gravity = x.T[2::4], tilted_gravity(level, MODEL.gravity)
    model = RollingModel.of(MODEL, "thesis")
    at = rolling(model, np.sin(angle), np.cos(angle), x.T[3::4], u.T, gravity)
    found = np.stack(
        (
            at.xx * x[:, 0] + at.xy * x[:, 4] + at.turn * x[:, 5] + at.px,
            at.yx * x[:, 0] + at.yy * x[:, 4] - at.turn * x[:, 1] + at.py,
        ),
        axis=-1,
    )
    plate = Rotation.from_euler("XY", angle[::-1].T)
    pull = plate.inv().apply(gravity)
    level_pull = plate.inv().apply((0.0, 0.0, -MODEL.gravity))
    change = MODEL.c1 * (pull - level_pull)[:, :2]
    assert found == pytest.approx(MODEL.derivative(x, u)[:, 1::4] + change, abs=1e-12)
    assert at.normal == pytest.approx(-pull[:, 2], abs=1e-12)


def test_a_plate_ends_where_its_size_says_of_every_rig():
    plant = ExactPlant(rigs=2, size=np.array([[0.3, 0.3], [0.7, 0.2]]))
    plant.start(np.tile([0.0, 0.5, 0.0, 0.4], (2, 1)))
    left = np.full(2, np.nan)
    for tick in range(1, 600):  # level and without friction: straight on
        plant.advance(np.zeros((2, 2)), 1)
        left[~plant.on_plate & np.isnan(left)] = 1e-3 * tick
    np.testing.assert_allclose(left, [0.15 / 0.5, 0.1 / 0.4], atol=1.5e-3)
