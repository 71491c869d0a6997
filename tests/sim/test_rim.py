"""Tests of `twin.sim.plant.rim`, in the exact equations and in the mechanism."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ballplate as bp
from controllers.ballplate import BallPlate
from twin.base.errors import ModelError, ScenarioError
from twin.scenario import load
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.rim import Rim, Walls

MODEL = BallPlate()
TILT = np.radians(2.0)
PUSH = MODEL.c1 * MODEL.gravity * np.sin(TILT)
"""Acceleration along x of a ball on a base that is tilted so far, m/s^2."""
REACH = 0.1 - MODEL.radius
"""How far the ball's middle can go between walls 0.2 m apart, m."""


def rolled(plant, ball, steps, at_once=1):
    """Balls (x, x', y, y') on a plate that nobody turns, by the step, shape (K, N, 4)."""
    plant.start(np.tile(ball, (plant.rigs, 1)))
    still = np.zeros((plant.rigs, 2))
    found = []
    for _ in range(steps // at_once):
        plant.advance(still, at_once)
        found.append(plant.state[:, (0, 1, 4, 5)])
    return np.array(found)


def bouncing(time, start, restitution):
    """Place of a ball that bounces off the wall down a tilted plane, in closed form, m."""
    length = np.sqrt(2 * (REACH - start) / PUSH)
    if time < length:
        return start + PUSH * time**2 / 2
    time, speed = time - length, PUSH * length * restitution
    while speed > 1e-12 and time >= 2 * speed / PUSH:
        time, speed = time - 2 * speed / PUSH, speed * restitution
    return REACH if speed <= 1e-12 else REACH - speed * time + PUSH * time**2 / 2


@pytest.mark.parametrize(
    ("rigs", "restitution"),
    [(1, 0.0), (1, 0.3), (1, 0.6), (1, 0.9), pytest.param(3, 0.6, marks=pytest.mark.long)],
)
def test_a_ball_on_a_tilted_plane_bounces_as_the_closed_form_does(rigs, restitution):
    rim = Rim(size=(0.2, 0.0), restitution=restitution)
    plant = ExactPlant(rigs=rigs, level=(TILT, 0.0), rim=rim)
    x = rolled(plant, [-0.02, 0.0, 0.03, 0.0], 1500)
    known = [bouncing(0.001 * (k + 1), -0.02, restitution) for k in range(1500)]
    assert x[:, 0, 0] == pytest.approx(np.array(known), abs=1e-13)
    assert np.ptp(x[:, :, 2]) == 0
    assert (x == x[:, :1]).all()
    # on the other side it is the same, mirrored
    other = ExactPlant(rigs=rigs, level=(-TILT, 0.0), rim=rim)
    assert (rolled(other, [0.02, 0.0, 0.03, 0.0], 1500)[..., 0] == -x[..., 0]).all()


@pytest.mark.short("0.5-*")
@pytest.mark.parametrize("rounded", [False, True])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_the_energy_of_a_ball_never_grows(restitution, rounded):
    plant = ExactPlant(
        level=(TILT, 0.01),
        rim=Rim(size=(0.2, 0.2), restitution=restitution),
        size=(0.2, 0.2),
        rounded=rounded,
    )
    ball = rolled(plant, [0.0, 0.05, 0.01, -0.2], 2000)[:, 0]
    push = plant._balls.model.c1 * plant._gravity[0], plant._balls.model.c1 * plant._gravity[1]
    energy = (ball[:, 1] ** 2 + ball[:, 3] ** 2) / 2 - ball[:, 0] * push[0] - ball[:, 2] * push[1]
    assert np.diff(energy).max() < 1e-14
    assert plant.on_plate.all()
    far = np.hypot(ball[:, 0], ball[:, 2]) if rounded else np.abs(ball[:, ::2]).max(axis=1)
    assert far.max() < REACH * (1 + 1e-12)
    if restitution == 1 and not rounded:
        assert np.ptp(energy) < 1e-13
    if restitution == 0:
        assert energy[-1] < energy[0] - 0.01


def tilting(time):
    """Angle, rate and acceleration of a plate that swings to and fro."""
    rate = 0.5 * np.sin(5 * time)
    return 0.12 - np.cos(5 * time) / 10, rate, 2.5 * np.cos(5 * time)


def integrated(end, restitution):
    """Places of a ball on that plate every 0.1 s by an integrator with events; its bounces."""

    def motion(time, state):
        angle, rate, acceleration = tilting(time)
        x, v = state
        return v, MODEL.c1 * (MODEL.gravity * np.sin(angle) + rate**2 * x) - MODEL.c2 * acceleration

    def wall(_, state):
        return abs(state[0]) - REACH

    wall.terminal, wall.direction = True, 1
    time, state, found, bounces = 0.0, [0.02, 0.0], [], 0
    while time < end:
        many = np.append(np.arange(round(time / 0.1 + 0.5), round(end / 0.1)) * 0.1, end)
        solved = solve_ivp(
            motion,
            (time, end),
            state,
            "DOP853",
            many[many > time],
            events=wall,
            rtol=1e-11,
            atol=1e-12,
        )
        found += solved.y[0].tolist()
        if not solved.t_events[0].size:
            return np.array(found), bounces
        time, (x, v) = solved.t_events[0][0], solved.y_events[0][0]
        state, bounces = [np.copysign(REACH, x), -restitution * v], bounces + 1
    return np.array(found), bounces


def test_on_a_swinging_plate_it_moves_as_an_integrator_with_events_finds():
    found, bounces = integrated(2.0, 0.7)
    assert bounces >= 3
    off = []
    for step in (0.001, 0.0005):
        plant = ExactPlant(step=step, rim=Rim(size=(0.2, 0.2), restitution=0.7))
        plant.resume(np.array([[0.02, 0, tilting(0)[0], 0, 0, 0, 0, 0]]))
        x = []
        for tick in range(round(2.0 / step)):
            plant.advance(np.array([[tilting((tick + 1) * step)[1], 0.0]]), 1)
            if (tick + 1) % round(0.1 / step) == 0:
                x.append(plant.state[0, 0])
        off.append(np.abs(x - found).max())
    assert off[0] < 2e-5
    assert off[1] < 0.4 * off[0]


FRICTIONS = {
    "rolling": Friction(rolling=2e-4),
    "ageing": Friction(rolling=2e-4, breakaway_ratio=2.0, dwell_time=0.1),
}


@pytest.mark.parametrize(
    ("rigs", "rounded", "friction"),
    [
        (1, False, FRICTIONS["rolling"]),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in itertools.product([1, 2], [False, True], FRICTIONS.values())
        ),
    ],
)
def test_pressed_on_a_wall_friction_holds_a_ball_that_a_small_tilt_draws_along_it(
    rigs, rounded, friction
):
    """0.002 rad are less than the 0.01 rad at which this friction lets go."""
    plant = ExactPlant(
        rigs=rigs,
        level=(TILT, 0.002),
        rim=Rim(size=(0.2, 0.2)),
        friction=friction,
        size=(0.2, 0.2),
        rounded=rounded,
    )
    ball = rolled(plant, [0.07, 0.0, 0.0, 0.0], 1500, 50)[-4:]
    assert (ball[..., 1::2] == 0).all()
    assert (ball == ball[-1]).all()
    x, _, y, _ = ball[-1, 0]
    assert (np.hypot(x, y) if rounded else x) == pytest.approx(REACH, abs=1e-9)
    free = ExactPlant(
        rigs=rigs, level=(TILT, 0.05), rim=Rim(size=(0.2, 0.2)), friction=friction, size=(0.2, 0.2)
    )
    assert rolled(free, [0.07, 0.0, 0.0, 0.0], 1500, 50)[-1, 0, 2] < -0.05


@pytest.mark.long
def test_walls_of_rigs_side_by_side_are_each_their_own():
    sizes, bounce = np.array([[0.2, 0.0], [0.1, 0.3], [0.0, 0.0]]), np.array([0.5, 0.9, 0.1])
    plant = ExactPlant(rigs=3, level=(TILT, 0.0), rim=Rim(size=sizes, restitution=bounce))
    together = rolled(plant, [0.0, 0.2, 0.02, -0.05], 1500)
    for rig in range(3):
        rim = Rim(size=tuple(sizes[rig]), restitution=bounce[rig])
        alone = rolled(ExactPlant(level=(TILT, 0.0), rim=rim), [0.0, 0.2, 0.02, -0.05], 1500)
        assert (alone[:, 0] == together[:, rig]).all()
    assert plant.on_plate.tolist() == [True, True, False]


def test_a_ball_put_beyond_a_wall_comes_back_to_it():
    plant = ExactPlant(rim=Rim(size=(0.2, 0.2)))
    plant.place(np.array([[0.15, 0.0, 0.0, 0.0]]))
    plant.advance(np.zeros((1, 2)), 2)
    assert plant.state[0, :2].tolist() == [REACH, 0.0]


MECHANISM = [(1, None), (20, None)]
"""Numbers of rigs with which the engine's sensors see the balls, and numpy does."""


@pytest.mark.long
@pytest.mark.parametrize(("rigs", "sensing"), MECHANISM)
def test_the_mechanisms_ball_rolls_off_a_wall_at_once_and_as_fast_as_is_said(rigs, sensing):
    """Also one that has turned about an axis that lies askew, as its own axes do then."""
    plant = Mechanism(
        rigs=rigs, rim=Rim(size=(0.2, 0.3), restitution=0.7), friction=Friction(), sensing=sensing
    )
    ball = rolled(plant, [0.0, 0.3, -0.05, 0.2], 400)
    meets = int(np.argmax(ball[:, 0, 1] < 0))
    assert 0.001 * meets == pytest.approx(REACH / 0.3, abs=0.002)
    before, after = ball[meets - 2, 0], ball[meets + 1 : meets + 60, 0]
    assert after[:, 1] == pytest.approx(-0.7 * before[1], rel=1e-3)
    assert after[:, 3] == pytest.approx(before[3], rel=1e-3)
    assert plant.warnings.tolist() == [0] * rigs


@pytest.mark.long
@pytest.mark.parametrize(("rigs", "sensing"), MECHANISM)
def test_the_mechanisms_ball_bounces_as_that_of_the_exact_equations(rigs, sensing):
    """Without friction, of which the engine's differs where a ball turns round."""
    level, rim = (TILT, 0.02), Rim(size=(0.2, 0.2), restitution=0.5)
    parts = Parts(level=level)
    plants = [
        Mechanism(rigs=rigs, parts=parts, rim=rim, friction=Friction(), sensing=sensing),
        ExactPlant(rigs=1, level=level, rim=rim),
    ]
    balls = [rolled(plant, [-0.02, 0.1, 0.0, 0.05], 1500)[:, 0] for plant in plants]
    assert np.abs(balls[0] - balls[1])[:, ::2].max() < 2e-4
    assert (np.diff(np.sign(balls[1][:, 1::2]), axis=0) < 0).sum(axis=0).min() >= 1
    assert plants[0].on_plate.all()
    bare = Mechanism(rigs=rigs, parts=parts, friction=Friction(), sensing=sensing)
    assert rolled(bare, [-0.02, 0.1, 0.0, 0.05], 1500)[-1, 0, 0] > 0.15


@pytest.mark.long
def test_the_mechanisms_ball_comes_to_rest_in_the_corner():
    plant = Mechanism(
        parts=Parts(level=(TILT, 0.02)), rim=Rim(size=(0.2, 0.2)), friction=Friction(rolling=2e-4)
    )
    ball = rolled(plant, [-0.02, 0.1, 0.0, 0.05], 2500)[-200:, 0]
    assert ball[:, ::2] == pytest.approx(np.tile([REACH, -REACH], (200, 1)), abs=2e-5)


@pytest.mark.long
def test_a_rig_of_the_mechanism_gives_the_bits_that_it_gives_alone():
    rims = Rim(size=np.array([[0.2, 0.2], [0.12, 0.0]]), restitution=np.array([0.5, 0.3]))
    friction = Friction(rolling=2e-4, breakaway_ratio=2.0)
    both = Mechanism(rigs=2, rim=rims, friction=friction, sensing=True)
    together = rolled(both, [0.0, 0.2, 0.0, 0.1], 600)
    for rig in range(2):
        rim = Rim(size=tuple(rims.size[rig]), restitution=rims.restitution[rig])
        alone = Mechanism(rim=rim, friction=friction)
        assert (rolled(alone, [0.0, 0.2, 0.0, 0.1], 600)[:, 0] == together[:, rig]).all()


KICKED = {
    "plant.start.x_rate": 0.5,
    "plant.size": [0.4, 0.4],
    "rig.limits.area": [0.15, 0.15],
    "rig.limits.margin": 2.0,
    "duration": 1.5,
}


@pytest.mark.parametrize("kind", ["lagrange", pytest.param("mujoco", marks=pytest.mark.long)])
def test_with_a_rim_the_ball_does_not_fall_at_the_edge(kind):
    kicked = KICKED | {"plant.kind": kind, "rig.limits.angle_deg": 0.2, "controller.kind": "lqr"}
    assert bp.run("hold", kicked).outcome == "fell"
    held = bp.run("hold", kicked | {"plant.rim.size": [0.4, 0.4]})
    assert held.outcome == "finished"
    assert abs(held.ball[:, 0]).max() == pytest.approx(0.18, abs=1e-3)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["size=[0.03, 0.3]"], "plant.rim.size: must be 0 along x, for no walls, or above the"),
        (["size=[0.3, 0.5]"], "ball's 0.04 m and at most the plate's 0.395 m, got 0.5"),
        (["size=[0.3, -0.1]"], "plant.rim.size.1: must be greater than or equal to 0, got -0.1"),
        (["size=0.3"], "plant.rim.size: "),
        (["restitution=1.2"], "plant.rim.restitution: must be less than or equal to 1, got 1.2"),
        (["walls=3"], "plant.rim.walls: "),
    ],
)
def test_walls_that_cannot_be_are_refused_in_one_line(settings, said):
    with pytest.raises(ScenarioError) as refused:
        load("hold", [f"plant.rim.{each}" for each in settings])
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_ball_cannot_begin_beyond_a_wall():
    with pytest.raises(ScenarioError, match=r"plant.start.x: walls let .* go 0.08 m"):
        load("hold", ["plant.rim.size=[0.2, 0.2]", "plant.start.x=0.09"])
    disc = ["plant.shape=round", "plant.size=[0.3,0.3]", "rig.limits.area=[0.1,0.1]"]
    with pytest.raises(ScenarioError, match=r"plant.rim.size: of a round plate its diameter twice"):
        load("hold", [*disc, "plant.kind=lagrange", "plant.rim.size=[0.2, 0.1]"])
    askew = ["plant.rim.size=[0.2,0.2]", "plant.start.x=0.07", "plant.start.y=0.07"]
    with pytest.raises(ScenarioError, match=r"plant.start: the rim lets the ball's middle go 0.08"):
        load("hold", [*disc, "plant.kind=lagrange", *askew])


def test_a_rim_out_of_range_is_refused():
    with pytest.raises(ModelError, match="restitution must be at least 0 and at most 1"):
        Rim(restitution=1.5)


def test_near_is_true_before_a_ball_meets_a_wall():
    walls = Walls(Rim(size=(0.2, 0.2)), MODEL.radius, False, rigs=3)
    balls = np.array([[0.07, 0.0, 0.0, 0.0], [0.07, 0.6, 0.0, 0.0], [0.0, 0.0, -0.079, 0.0]]).T
    assert walls.near(balls, 0.02).tolist() == [False, True, True]
