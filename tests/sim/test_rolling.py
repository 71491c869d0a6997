"""`twin.sim.plant.friction`.

Friction as one object: the same closed forms hold on both plants that it drives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.hal.interface import SCREEN_SIZE_M
from twin.hal.linkage import Linkage
from twin.identify.logs import MECHANISM_GRIP
from twin.run.finished import run as finished
from twin.scenario import load
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism

BALL = BallPlate()
RADIUS, GRAVITY, K1 = BALL.radius, BALL.gravity, BALL.k1
ROLLING = 0.2e-3
STEP = 0.001
PLANTS = ("exact", "mechanism", "rods")
LINKAGE = Linkage(crank=(0.04, 0.03), rod=(0.09, 0.1), arm=(0.1, 0.07), distance=(0.05, 0.045))


def plants(kind, friction, slopes=(0.0,), **start):
    """One rig a slope (tilt of the base about y in rad), its ball at (x, x') and along y."""
    tilts = [(slope, 0.0) for slope in slopes]
    rigs = len(tilts)
    if kind == "exact":
        plant = ExactPlant(rigs=rigs, step=STEP, friction=friction, level=np.array(tilts))
    else:
        rods = {"linkage": LINKAGE, "size": SCREEN_SIZE_M} if kind == "rods" else {}
        parts = [Parts(level=tilt if any(tilt) else None, **rods) for tilt in tilts]
        plant = Mechanism(rigs=rigs, step=STEP, threads=1, friction=friction, parts=parts)
    ball = np.zeros((rigs, 4))
    ball[:, 0], ball[:, 1] = start.get("x", 0.0), start.get("x_rate", 0.0)
    plant.start(ball)
    return plant


def run(plant, seconds):
    """Positions and speeds along x every 2 ms, shape (samples, N)."""
    still, rows = np.zeros((plant.rigs, 2)), []
    for _ in range(round(seconds / (2 * STEP))):
        plant.advance(still, 2)
        rows.append(plant.state[:, :2].copy())
    return np.moveaxis(np.array(rows), -1, 0)


@pytest.mark.parametrize("kind", PLANTS)
def test_a_rolling_ball_stops_after_the_distance_that_its_energy_lasts_and_stays(kind):
    # m v^2 / 2 (1 + J / (m r^2)) = m g (arm / r) s
    plant = plants(kind, Friction(rolling=ROLLING), x_rate=0.1)
    way, speed = run(plant, 3.0)
    inertia = 1 + BALL.inertia / (BALL.mass * RADIUS**2)
    expected = 0.1**2 / 2 * inertia * RADIUS / (GRAVITY * ROLLING)
    assert way[-1, 0] == pytest.approx(expected, rel=0.01)
    assert np.ptp(way[-250:, 0]) < 1e-6
    assert abs(speed[-1, 0]) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("kind", PLANTS)
def test_on_a_slope_viscous_friction_ends_the_acceleration_at_its_terminal_speed(kind):
    # tan(slope) r = rolling + viscous v
    viscous = 2e-3
    slope = math.radians(1.0)
    plant = plants(kind, Friction(rolling=ROLLING, viscous=viscous), [slope], x=-0.3)
    _, speed = run(plant, 4.5)
    terminal = (RADIUS * math.tan(slope) - ROLLING) / viscous
    time = 2 * STEP * (1 + np.arange(len(speed)))
    rate = K1 * viscous / RADIUS * math.cos(slope)
    approach = terminal * (1 - np.exp(-rate * time))
    assert speed[:, 0] == pytest.approx(approach, abs=0.01 * terminal)


@pytest.mark.long
@pytest.mark.parametrize("kind", PLANTS)
def test_the_ball_sticks_up_to_the_breakaway_slope_and_slips_beyond(kind):
    friction = Friction(rolling=ROLLING, breakaway_ratio=2.0, stribeck_speed=0.002)
    onset = math.atan(2 * ROLLING / RADIUS)
    way, speed = run(plants(kind, friction, [0.97 * onset, 1.03 * onset]), 2.0)
    assert np.abs(way[-1, 0]) < 1e-6
    assert way[-1, 1] > 0.01
    # once under way only the rolling arm is left: K1 (sin - arm / r cos)
    slope = 1.03 * onset
    late = speed[-1, 1] - speed[-251, 1]
    assert late / 0.5 == pytest.approx(
        K1 * (math.sin(slope) - ROLLING / RADIUS * math.cos(slope)), rel=0.05
    )


@pytest.mark.long
@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.parametrize("rolling", [0.05e-3, ROLLING, 0.4e-3])
def test_without_breakaway_the_ball_slips_from_the_rolling_slope_on(kind, rolling):
    onset = math.atan(rolling / RADIUS)
    way, _ = run(plants(kind, Friction(rolling=rolling), [0.97 * onset, 1.03 * onset]), 2.0)
    expected = K1 / 2 * (math.sin(1.03 * onset) - math.sin(onset)) * 2.0**2
    assert np.abs(way[-1, 0]) < 1e-6
    assert way[-1, 1] == pytest.approx(expected, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.parametrize("rest", [0.2, 1.0])
def test_a_ball_holds_the_steeper_a_slope_the_longer_it_has_rested(kind, rest):
    # arm after a rest t: rolling (1 + (ratio - 1) (1 - exp(-t / dwell))); tilted so gently that
    # the plate's own acceleration does not shake the ball loose
    friction = Friction(rolling=ROLLING, breakaway_ratio=3.0, stribeck_speed=2e-4, dwell_time=1.0)
    plant = plants(kind, friction, x_rate=0.1)
    _, speed = run(plant, 0.1 / (K1 * ROLLING / RADIUS) + 0.02)
    rested = 2 * STEP * np.count_nonzero(np.abs(speed[:, 0]) < 1e-5)
    run(plant, rest)
    rested, rate, slope = rested + rest, 0.0, 0.0
    while abs(plant.state[0, 1]) < 1e-4 and slope < 0.1:
        rate = min(rate + 0.3 * 2 * STEP, math.radians(4.0))
        plant.advance(np.array([[rate, 0.0]]) * plant.ratio, 2)
        rested, slope = rested + 2 * STEP, float(plant.state[0, 2])
    age = 1 - math.exp(-rested / 1.0)
    assert math.tan(slope) * RADIUS == pytest.approx(ROLLING * (1 + 2 * age), rel=0.1)


def test_a_ball_off_its_middle_swings_as_a_physical_pendulum():
    # at rest its centre of mass hangs below: I_contact w'' = -m g d w, once round after 2 pi r
    below = 2e-3
    parts = Parts(offset=(0.0, 0.0, -below))
    plant = Mechanism(rigs=1, step=STEP, friction=Friction(), parts=parts)
    plant.start(np.array([[0.0, 0.01, 0.0, 0.0]]))
    way, _ = run(plant, 6.0)
    crossings = np.flatnonzero(np.diff(np.sign(way[:, 0] - way[:, 0].mean())))
    period = 2 * 2 * STEP * np.diff(crossings).mean()
    about_contact = BALL.inertia + BALL.mass * (RADIUS - below) ** 2
    expected = 2 * math.pi * math.sqrt(about_contact / (BALL.mass * GRAVITY * below))
    assert period == pytest.approx(expected, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("omega", [0.75, 1.0])
def test_friction_is_against_the_way_and_in_the_mechanism_turns_with_it_a_contact_late(omega):
    """In the steady circle eta'' = f - F v / |v|, turned by omega times what it is late."""
    turns, late = 4 * math.pi / omega, {}
    for kind in ("lagrange", "mujoco"):
        on = [f"plant.kind={kind}", f"reference.omega={omega}", f"duration={6.0 + turns}"]
        # what is left without friction is (5.9) below
        on += ["plant.ball_spin=thesis"] if kind == "lagrange" else []
        record = finished(load("circle", (*on, "sensors.ideal=true", "metrics.start=0"))).record
        end = record.time > record.time[-1] - turns
        x, turned = record["state"][end, 0], np.exp(1j * omega * record.time[end])
        ball, slope = x[:, 0] + 1j * x[:, 4], x[:, 2] - 1j * x[:, 6]
        free = BALL.derivative(x, np.zeros((len(x), 2)))[:, [1, 5]] @ (1, 1j)
        at, tilt, pull = (np.mean(each * turned) for each in (ball, slope, free))
        drag = -(omega**2) * (at + BALL.c2 * tilt) - pull
        assert abs(drag) == pytest.approx(K1 * 0.18e-3 / RADIUS, rel=0.01)
        late[kind] = -np.angle(drag / (1j * omega * at)) / omega
    assert abs(late["lagrange"]) < 2e-3
    assert late["mujoco"] == pytest.approx(MECHANISM_GRIP, abs=3e-3)


def test_spin_about_the_vertical_is_braked_by_its_own_arm():
    # J w' = -arm m g
    plant = Mechanism(rigs=1, step=STEP, friction=Friction(), parts=Parts(spinning=1e-4))
    plant.start(np.zeros((1, 4)), spin=4.0)
    begin = plant._qvel[0, plant._at.ball_rate][5]
    run(plant, 0.5)
    lost = begin - plant._qvel[0, plant._at.ball_rate][5]
    expected = 1e-4 * BALL.mass * GRAVITY / BALL.inertia * 0.5
    assert lost == pytest.approx(min(expected, 4.0), rel=0.02)


def test_where_sliding_friction_gives_out_the_ball_slides_down():
    # beyond tan(slope) = mu (1 + m r^2 / J) a ball slides: x'' = g (sin - mu cos)
    mu, slope = 0.02, math.radians(5.0)
    assert math.tan(slope) > mu * (1 + BALL.mass * RADIUS**2 / BALL.inertia)
    parts = Parts(sliding=mu, level=(slope, 0.0))
    plant = Mechanism(rigs=1, step=STEP, friction=Friction(), parts=parts)
    plant.start(np.zeros((1, 4)))
    way, _ = run(plant, 0.5)
    expected = GRAVITY * (math.sin(slope) - mu * math.cos(slope)) / 2 * 0.5**2
    assert way[-1, 0] == pytest.approx(expected, rel=0.02)
