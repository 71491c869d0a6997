"""`twin.sim.plant.friction`.

Friction that bends before it slides: Dahl's model against its closed form, on both plants."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.mechanism import Mechanism

MODEL = BallPlate()
ARM, WAY = 2e-4, 1e-4
FULL = MODEL.c1 * ARM / MODEL.radius * MODEL.gravity
"""Deceleration of steady rolling, m/s^2."""
PLANTS = {"exact": ExactPlant, "mechanism": Mechanism}
parts = st.floats(-1, 1)


@settings(max_examples=25)
@given(z=st.tuples(parts, parts), v=st.tuples(parts, parts), time=st.floats(1e-4, 5))
def test_the_bend_solves_dahls_equation_and_is_never_longer_than_its_way(z, v, time):
    z, v = 0.7 * WAY * np.array(z), 1e-4 * np.array(v)

    def rate(_, bend):
        return v - np.hypot(*v) * bend / WAY

    exact = solve_ivp(rate, (0, time), z, method="LSODA", rtol=1e-9, atol=1e-14).y[:, -1]
    (found,) = Friction(presliding=WAY).bent(z[None], v[None], time)
    assert found == pytest.approx(exact, abs=1e-9)
    assert np.hypot(*found) <= WAY * (1 + 1e-12)


def rolled(kind, ball, ticks):
    """States of a ball that rolls on a held plate, one a millisecond, (ticks + 1, 8)."""
    plant = PLANTS[kind](step=0.001, friction=Friction(rolling=ARM, presliding=WAY))
    plant.start(np.array([ball]))
    states = [plant.state[0]]
    for _ in range(ticks):
        plant.advance(np.zeros((1, 2)), 1)
        states.append(plant.state[0])
    return np.array(states)


@pytest.mark.parametrize("kind", PLANTS)
def test_about_its_place_a_ball_is_held_by_a_spring_of_the_stiffness_at_the_origin(kind):
    # so slow that the bend stays a hundredth of its way: v = v0 cos(w t), w^2 = F / s
    w = np.sqrt(FULL / WAY)
    v0 = 0.01 * WAY * w
    x = rolled(kind, [0.0, v0, 0.0, 0.0], round(2 * np.pi / w / 1e-3))
    t = 1e-3 * np.arange(len(x))
    assert x[:, 1] == pytest.approx(v0 * np.cos(w * t), abs=0.06 * v0)
    assert x[:, 0] == pytest.approx(v0 / w * np.sin(w * t), abs=0.06 * v0 / w)


@pytest.mark.parametrize("kind", PLANTS)
def test_a_ball_that_has_come_far_is_slowed_as_by_steady_rolling(kind):
    x = rolled(kind, [0.0, 0.06, 0.0, 0.08], 500)
    v = np.hypot(x[:, 1], x[:, 5])
    late = slice(100, None)
    t = 1e-3 * np.arange(len(x))
    slope, _ = np.polyfit(t[late], v[late], 1)
    assert slope == pytest.approx(-FULL, rel=0.01)
    assert x[-1, 5] / x[-1, 1] == pytest.approx(4 / 3, rel=1e-3)


@pytest.mark.parametrize("kind", PLANTS)
def test_a_ball_that_is_put_somewhere_at_rest_stays_there(kind):
    plant = PLANTS[kind](step=0.001, friction=Friction(rolling=ARM, presliding=WAY))
    plant.start(np.array([[0.0, 0.06, 0.0, 0.08]]))
    plant.advance(np.zeros((1, 2)), 100)  # its contact is bent
    plant.place(np.array([[0.05, 0.0, -0.03, 0.0]]))
    plant.advance(np.zeros((1, 2)), 20)
    # the mechanism's plate gives way a little under the ball
    assert plant.state[0, 0::4] == pytest.approx([0.05, -0.03], abs=2e-6)
    assert plant.state[0, 1::4] == pytest.approx([0.0, 0.0], abs=1e-4)


def test_energy_is_never_created():
    rng = np.random.default_rng(2)
    ball = np.zeros((20, 4))
    ball[:, 1::2] = rng.normal(size=(20, 2)) * 0.01
    friction = Friction(rolling=ARM, presliding=WAY)
    plant = ExactPlant(rigs=20, step=2e-4, friction=friction)
    plant.start(ball)
    energies = []
    for _ in range(400):
        plant.advance(np.zeros((20, 2)), 4)
        v, bend = plant.state[:, 1::4], plant._balls.bend
        energies.append((v**2).sum(axis=1) / 2 + FULL / WAY * (bend**2).sum(axis=1) / 2)
    energies = np.array(energies)
    growth = np.diff(energies, axis=0).max(axis=0) / energies[0]
    assert growth.max() < 1e-5
    assert (energies[-1] < 0.2 * energies[0]).all()
