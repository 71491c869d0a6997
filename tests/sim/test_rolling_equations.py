"""`twin.sim.plant.exact`.

The exact equations held against Newton and Euler of a sphere, in world coordinates."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from controllers.ballplate import BallPlate
from twin.base.errors import ModelError, ScenarioError
from twin.run.finished import run
from twin.scenario.load import load
from twin.sim.plant.exact import ExactPlant, RollingModel, rolling
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import tilted_gravity
from twin.sim.plant.mechanism import Mechanism

HOLLOW = BallPlate()
SOLID = BallPlate(mass=0.263, inertia=0.4 * 0.263 * 0.02**2)
X, Y = np.eye(3)[0], np.eye(3)[1]


def cross(a):
    """Matrices that a cross product from the left is, shape (..., 3, 3)."""
    x, y, z = np.moveaxis(a, -1, 0)
    o = np.zeros_like(x)
    rows = ((o, -z, y), (z, o, -x), (-y, x, o))
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def newton_euler(ball, state, spin, u, gravity, *, locked=False):
    """Rates of velocity and spin of a sphere that touches and does not slip, in plate axes.

    Unknown are the sphere's accelerations, the force of the contact and, of a spin that is locked
    to the plate, a torque about the normal: with m V' = F + m g, J W' = -r n x F (+ torque) and the
    time derivative of V - W x r n = w x (c - r n), c being the centre.

    Args:
        ball: Its parameters.
        state: (5.5), shape (K, 8).
        spin: W . n, rad/s, shape (K,); of no matter where it is locked.
        u: Plate accelerations, shape (K, 2).
        gravity: In world axes, shape (3,).
        locked: Whether the spin is that of the plate.

    Returns:
        x'', y'' and the rate of W . n, shape (K, 3).
    """
    x, vx, phi, wy, y, vy, theta, wx = state.T
    m, r, J = ball.mass, ball.radius, ball.inertia
    first = Rotation.from_rotvec(theta[:, None] * X)
    plate = first * Rotation.from_rotvec(phi[:, None] * Y)
    axis = first.apply(Y)
    w = wx[:, None] * X + wy[:, None] * axis
    w_rate = u[:, 1:] * X + u[:, :1] * axis + wy[:, None] * np.cross(wx[:, None] * X, axis)
    n = plate.apply((0.0, 0.0, 1.0))
    n_rate = np.cross(w, n)
    zero = np.zeros_like(x)
    c = plate.apply(np.stack((x, y, zero + ball.height + r), axis=-1))
    along = plate.apply(np.stack((vx, vy, zero), axis=-1))
    V = along + np.cross(w, c)
    own = (w * n).sum(axis=-1) if locked else spin
    # W x r n = V - w x (c - r n): what is across the normal; and along it the spin
    W = np.cross(n, V - np.cross(w, c - r * n)) / r + own[:, None] * n
    A, b = np.zeros((len(x), 10, 10)), np.zeros((len(x), 10))
    A[:, :3, :3], A[:, :3, 6:9], b[:, :3] = m * np.eye(3), -np.eye(3), m * np.asarray(gravity)
    A[:, 3:6, 3:6], A[:, 3:6, 6:9], A[:, 3:6, 9] = J * np.eye(3), cross(r * n), -n
    A[:, 6:9, :3], A[:, 6:9, 3:6] = np.eye(3), cross(r * n)
    b[:, 6:9] = np.cross(W, r * n_rate) + np.cross(w_rate, c - r * n) + np.cross(w, V - r * n_rate)
    if locked:
        A[:, 9, 3:6], b[:, 9] = n, (w_rate * n).sum(axis=-1) + ((w - W) * n_rate).sum(axis=-1)
    else:
        A[:, 9, 9] = 1.0
    found = np.linalg.solve(A, b[..., None])[..., 0]
    moving = np.cross(w_rate, c) + np.cross(w, np.cross(w, c)) + 2 * np.cross(w, along)
    seen = plate.inv().apply(found[:, :3] - moving)
    np.testing.assert_allclose(seen[:, 2], 0.0, atol=1e-11)  # it stays on the plate
    spin_rate = (found[:, 3:6] * n).sum(axis=-1) + (W * n_rate).sum(axis=-1)
    return np.column_stack((seen[:, :2], spin_rate))


def random_motion(count, seed=1):
    """States, spins and plate accelerations as fast as any rig's."""
    rng = np.random.default_rng(seed)
    size = (0.2, 0.5, 0.25, 1.3, 0.2, 0.5, 0.25, 1.3)
    state = rng.uniform(-1, 1, (count, 8)) * size
    return state, rng.uniform(-20, 20, count), rng.uniform(-12, 12, (count, 2))


def equations(ball, kind, state, spin, u, gravity):
    """x'', y'' and the rate of the spin by the product's equations, shape (K, 3)."""
    about = RollingModel.of(ball, kind)
    angle = state.T[2::4]
    at = rolling(about, np.sin(angle), np.cos(angle), state.T[3::4], u.T, gravity)
    scale = about.share * ball.radius
    x, vx, y, vy = state.T[[0, 1, 4, 5]]
    found = at.free(x, vx, y, vy, scale * spin)
    return np.stack((*found, -(at.hx * vx + at.hy * vy) / (scale or np.nan)), axis=-1)


@pytest.mark.parametrize("ball", [HOLLOW, SOLID, BallPlate(radius=0.03, height=0.0)])
@pytest.mark.parametrize("level", [(0.0, 0.0), (0.05, -0.03)])
def test_the_equations_are_newton_and_euler_of_a_rolling_sphere(ball, level):
    state, spin, u = random_motion(4000)
    gravity = tilted_gravity(level, ball.gravity)
    right = newton_euler(ball, state, spin, u, gravity)
    found = equations(ball, "free", state, spin, u, gravity)
    scale = (1, 1, ball.radius)  # the rate of the spin as an acceleration at the surface
    np.testing.assert_allclose(scale * found, scale * right, rtol=0, atol=1e-12)
    locked = newton_euler(ball, state, spin, u, gravity, locked=True)[:, :2]
    found = equations(ball, "locked", state, 0 * spin, u, gravity)[:, :2]
    np.testing.assert_allclose(found, locked, rtol=0, atol=1e-12)
    thesis = equations(ball, "thesis", state, 0 * spin, u, gravity)[:, :2]
    wz = state[:, 7] * np.sin(state[:, 2])
    lost = (1 - ball.c1) * wz[:, None] * state[:, [5, 1]] * (1, -1)
    np.testing.assert_allclose(locked - thesis, lost, rtol=0, atol=1e-12)
    assert np.abs(lost).max() > 0.03


def test_the_thesis_has_its_equations_to_the_bit_where_a_scenario_asks_for_them():
    """The model that laws are designed on is (5.9), as the plant is with that key."""
    state, _, u = random_motion(200)
    found = equations(HOLLOW, "thesis", state, 0.0, u, (0.0, 0.0, -HOLLOW.gravity))[:, :2]
    np.testing.assert_allclose(found, HOLLOW.derivative(state, u)[:, 1::4], rtol=0, atol=1e-12)


TABLE = 2.0
"""Rate of the turntable, rad/s."""


def on_a_turntable(kind, seconds=4.0, step=0.001):
    """Places of a solid ball in axes that stand still, on a plate that turns about its normal.

    At phi = pi/2 the plate's normal is the axis of theta; gravity is along it.
    """
    plant = ExactPlant(
        SOLID, step=step, level=(-np.pi / 2, 0.0), size=(100.0, 100.0), ball_spin=kind
    )
    ticks = round(seconds / (2 * step))
    state = np.array([[0.1, 0.2, np.pi / 2, 0.0, 0.05, -0.1, 0.0, TABLE]])
    plant.resume(state)
    found = [plant.state[0]]
    for _ in range(ticks):
        plant.advance(np.array([[0.0, TABLE]]), 2)
        found.append(plant.state[0])
    x, y, theta = np.array(found)[:, [0, 4, 6]].T
    return (x + 1j * y) * np.exp(1j * theta)


@pytest.mark.parametrize("kind", ["free", "locked"])
def test_a_solid_ball_on_a_turntable_circles_at_two_sevenths_of_its_rate(kind):
    place = on_a_turntable(kind)
    time = 0.002 * np.arange(len(place))
    wave = np.exp(2j / 7 * TABLE * time)
    (middle, radius), *_ = np.linalg.lstsq(np.stack((0 * time + 1, wave), axis=-1), place)
    np.testing.assert_allclose(middle + radius * wave, place, rtol=0, atol=1e-9)
    assert abs(radius) > 0.1


def test_by_the_thesis_it_spirals_outwards_and_never_circles():
    place = on_a_turntable("thesis", seconds=8.0)
    c1 = SOLID.c1
    growth = np.sqrt(c1 * (1 - c1)) * TABLE  # of exp(growth t), from the characteristic equation
    last = np.abs(place[-1] / place[-1 - 500])
    assert np.log(last) / 1.0 == pytest.approx(growth, rel=0.01)


def plate_rates(time):
    """Commanded plate rates: phi of 8 deg and theta of 7 deg at 9 rad/s, a quarter turn apart."""
    size = np.radians((8.0, 7.0)) * 9.0
    return size * np.stack((np.cos(9.0 * time), -np.sin(9.0 * time)), axis=-1)


@pytest.mark.short("True")
@pytest.mark.parametrize("linked", [False, True])
def test_the_plant_goes_where_an_integrator_of_its_own_takes_the_sphere(linked):
    """By a method of order 8 at tolerances of 1e-12, one ramp of the plate's rates at a time."""
    ticks, period = 40, 0.002
    kind = "locked" if linked else "free"
    plants = [ExactPlant(rigs=rigs, step=0.0005, ball_spin=kind) for rigs in (1, 3)]
    start, spin = np.array([[0.05, 0.1, -0.03, 0.2]]), 0.0 if linked else 12.0
    for plant in plants:
        plant.start(start, spin)
    z = np.array([0.05, 0.1, 0.0, 0.0, -0.03, 0.2, 0.0, 0.0, spin])
    for tick in range(ticks):
        rate = plate_rates(period * (tick + 1))
        u = (rate - z[3:8:4]) / period

        def slope(_, z, u=u):
            x, n = z[None, :8], z[None, 8]
            gravity = (0.0, 0.0, -HOLLOW.gravity)
            ax, ay, spun = newton_euler(HOLLOW, x, n, u[None], gravity, locked=linked)[0]
            return np.array([z[1], ax, z[3], u[0], z[5], ay, z[7], u[1], spun])

        z = solve_ivp(slope, (0, period), z, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        for plant in plants:
            plant.advance(np.tile(rate, (plant.rigs, 1)), 4)
    assert np.abs(z[2:8:4]).min() > 0.03
    for plant in plants:
        np.testing.assert_allclose(plant.state[-1], z[:8], rtol=0, atol=1e-10)
        np.testing.assert_allclose(plant.spin[-1], z[8], rtol=0, atol=1e-8)


def integrated(kind, angles, seconds):
    """Where a ball from rest on the middle rolls on a plate with these angles of time."""
    about, rates, u = RollingModel.of(HOLLOW, kind), angles.derivative(), angles.derivative(2)

    def slope(t, z):
        x, vx, y, vy, q = z
        sines, cosines = np.sin(angles(t)), np.cos(angles(t))
        at = rolling(about, sines, cosines, rates(t), u(t), (0.0, 0.0, -HOLLOW.gravity))
        ax, ay = at.free(x, vx, y, vy, q)
        return np.array([vx, ax, vy, ay, -(at.hx * vx + at.hy * vy)])

    times = (0, seconds)
    return solve_ivp(slope, times, np.zeros(5), "DOP853", rtol=1e-9, max_step=0.01).y[[0, 2], -1]


@pytest.mark.short("1")
@pytest.mark.parametrize("sense", [1, -1])
def test_the_mechanism_has_the_term_and_a_spin_that_is_free(sense):
    """Its ball on a plate that swings far and fast, beside that of each of the equations.

    They are given the plate's motion as the mechanism really made it. It begins gently: a plate
    that jumps lets the ball slip.
    """
    honest = Mechanism(rigs=1, step=0.001, threads=1, friction=Friction(rolling=0.0))
    honest.start(np.zeros((1, 4)))
    states, time = [honest.state[0]], 0.001 * np.arange(1201)
    for t in time[1:]:
        rate = plate_rates(t) * (1, sense) * min(1.0, t / 0.5)
        honest.advance(rate[None] * honest.ratio, 1)
        states.append(honest.state[0])
    angles = CubicSpline(time, np.array(states)[:, 2::4])
    ends = {kind: integrated(kind, angles, 1.2) for kind in ("free", "locked", "thesis")}
    apart = {kind: np.hypot(*(end - states[-1][0::4])) for kind, end in ends.items()}
    assert apart["free"] < 0.5e-3  # of a way of 212 mm
    assert apart["thesis"] > 1.5 * apart["free"]
    assert apart["locked"] > 3 * apart["free"]


def test_a_spin_is_kept_by_a_change_of_the_ball_and_given_by_a_start():
    plant = ExactPlant(rigs=2)
    plant.start(np.zeros((2, 4)), np.array([3.0, -5.0]))
    assert plant.spin == pytest.approx([3.0, -5.0], rel=1e-15)
    about = {"friction": None, "level": (0.01, 0.0), "ball_spin": "free"}
    plant.change(size=(0.7, 0.4), rounded=False, model=SOLID, **about)
    assert plant.spin == pytest.approx([3.0, -5.0], rel=1e-15)
    plant.begin(np.array([1]), np.zeros((1, 4)))
    assert plant.spin == pytest.approx([3.0, 0.0], rel=1e-15)
    for kind in ("locked", "thesis"):
        with pytest.raises(ModelError, match=f"a ball with '{kind}' spin"):
            ExactPlant(ball_spin=kind).start(np.zeros((1, 4)), 1.0)


def test_each_spin_has_runs_of_its_own():
    far = ("duration=0.6", "metrics.start=0", "plant.start.x=0.1", "plant.start.y_rate=0.3")
    kinds = [
        run(load("circle", ("plant.kind=lagrange", f"plant.ball_spin={kind}", *far)))
        for kind in ("free", "locked", "thesis")
    ]
    free, locked, thesis = (each.record["state"] for each in kinds)
    assert 1e-5 < np.abs(free - locked).max() < 2e-3
    assert 1e-5 < np.abs(locked - thesis).max() < 2e-3


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        (
            ("plant.ball_spin=locked",),
            "plant.ball_spin: the mechanism has a ball that spins freely; set plant.kind",
        ),
        (
            ("plant.kind=lagrange", "plant.ball_spin=thesis", "plant.start.spin=2.0"),
            "plant.start.spin: must be 0 with plant.ball_spin = 'thesis'",
        ),
        (("plant.kind=lagrange", "plant.ball_spin=fixed"), "plant.ball_spin: must be 'free'"),
        (
            ("plant.kind=lagrange", "plant.friction.spinning_mm=1.0"),
            "the exact equations have a ball that spins without friction",
        ),
    ],
)
def test_what_does_not_go_together_is_one_line(keys, line):
    with pytest.raises(ScenarioError) as refused:
        load("circle", keys)
    assert line in str(refused.value)
