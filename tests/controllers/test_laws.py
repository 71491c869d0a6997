"""Tests of `controllers.classical`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from controllers.classical import (
    AFL,
    LQR,
    AFLIntegral,
    Backstepping,
    Feedforward,
    PolePlacement,
    SlidingMode,
)
from controllers.interfaces import Reference
from controllers.predictive import Predictive
from controllers.references import Hold, Sine
from controllers.repetition import InternalModel

LAWS = (
    PolePlacement(),
    LQR(),
    Feedforward(),
    AFL(),
    AFLIntegral(),
    Backstepping(),
    SlidingMode(),
    InternalModel(),
    Predictive(),
)
every_law = pytest.mark.parametrize("law", LAWS, ids=[law.name for law in LAWS])
PATH = Sine(amplitude=(0.1, 0.15), omega=(1.1, 0.7), wave=("sin", "cos"))
number = st.floats(-0.5, 0.5)


class Swapped(Reference):
    """The path with x and y exchanged."""

    def __call__(self, t):
        return PATH(t)[..., ::-1]


class Each(Reference):
    """The path, and the path with x and y exchanged, for two rigs."""

    def __call__(self, t):
        return np.stack((PATH(t), Swapped()(t)), axis=-2)


@pytest.mark.short("lqr", "afl", "mpc")
@every_law
@settings(max_examples=25)
@given(data=st.data(), t=st.floats(0, 20))
def test_rigs_may_follow_each_their_own_reference(law, data, t):
    x = data.draw(arrays(float, (2, 8), elements=number))
    q = data.draw(arrays(float, (2, law.memory), elements=number))
    together, slopes = law.control(t, x, Each(), q), law.memory_rate(t, x, Each(), q)
    for i, path in enumerate((PATH, Swapped())):
        alone = law.control(t, x[i], path, q[i])
        np.testing.assert_allclose(together[i], alone, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(slopes[i], law.memory_rate(t, x[i], path, q[i]))


@pytest.mark.short("lqr", "backstepping", "mpc")
@every_law
@settings(max_examples=25)
@given(data=st.data(), t=st.floats(0, 20))
def test_exchanging_the_axes_exchanges_the_inputs_and_their_sign(law, data, t):
    x = data.draw(arrays(float, 8, elements=number))
    q = data.draw(arrays(float, law.memory, elements=number))
    # A plate angle that accelerates the ball along x does so against y (5.35).
    mirrored = np.concatenate((x[4:], x[:4])) * np.tile((1, 1, -1, -1), 2)
    exchanged = q.reshape(-1, 2)[:, ::-1].ravel()
    u = law.control(t, x, PATH, q)
    np.testing.assert_allclose(
        law.control(t, mirrored, Swapped(), exchanged), -u[::-1], rtol=1e-6, atol=1e-9
    )


@every_law
def test_a_ball_at_rest_where_it_should_be_needs_no_input(law):
    x = np.zeros(8)
    x[[0, 4]] = 0.1, -0.05
    u = law.control(0.0, x, Hold(x=0.1, y=-0.05), np.zeros(law.memory))
    np.testing.assert_allclose(u, 0, atol=1e-15)


@every_law
def test_a_ball_to_one_side_tilts_the_plate_to_bring_it_back(law):
    x = np.zeros(8)
    x[[0, 4]] = 0.05, 0.05
    u1, u2 = law.control(0.0, x, Hold(), np.zeros(law.memory))
    # x'' = +k1 sin(phi), y'' = -k1 sin(theta).
    assert u1 < 0 < u2


@pytest.mark.long
@every_law
def test_the_exact_model_settles_on_a_point_on_both_axes(law):
    """Of (5.9), from rest under continuous control."""
    goal = Hold(x=0.1, y=-0.08)

    def rate(t, s):
        x, q = s[:8], s[8:]
        u = law.control(t, x, goal, q)
        return np.concatenate((law.model.derivative(x, u), law.memory_rate(t, x, goal, q)))

    s = solve_ivp(
        rate, (0, 20), np.zeros(8 + law.memory),
        method="DOP853", rtol=1e-8, atol=1e-10, max_step=0.2,
    ).y  # fmt: skip
    # The sliding mode's sigmoid leaves a neighbourhood, the others come to rest.
    np.testing.assert_allclose(s[[0, 4], -1], (0.1, -0.08), atol=0.005)
