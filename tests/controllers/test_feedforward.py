import numpy as np
import pytest

from controllers.ballplate import BallPlate
from controllers.classical import LQR, Feedforward, PolePlacement
from controllers.references import Circle, Lissajous, Sine

MODEL = BallPlate()
NOTHING = np.zeros(0)
FAST = Lissajous(amplitude=(0.2, 0.12), omega=(3.0, 2.0), start=2.0)


@pytest.mark.parametrize("path", [FAST, Circle(omega=1.0)], ids=["lissajous", "circle"])
def test_the_trajectory_is_one_of_the_flat_model(path):
    law, h = Feedforward(), 1e-4
    # None of the times is where the polynomial start ends: the derivative of u* jumps there.
    t = 0.113 + 0.05 * np.arange(197)
    x, u = law.trajectory(path(t))
    rate = (law.trajectory(path(t + h))[0] - law.trajectory(path(t - h))[0]) / (2 * h)
    np.testing.assert_allclose(rate, MODEL.flat(x, u), atol=1e-5)


def test_the_feedback_acts_on_the_way_from_the_trajectory():
    law, t = Feedforward(rho=100, kappa=0.1), 0.7
    x = np.random.default_rng(5).normal(size=8) * 0.1
    desired, u = law.trajectory(FAST(t))
    expected = u - LQR(rho=100, kappa=0.1).K @ (x - desired)
    np.testing.assert_allclose(law.control(t, x, FAST, NOTHING), expected)


def test_poles_make_the_feedback_of_pole_placement():
    np.testing.assert_array_equal(
        Feedforward(poles=(-2, -3, -4, -5)).K, PolePlacement(poles=(-2, -3, -4, -5)).K
    )


def test_a_reference_beyond_gravity_still_gives_a_finite_input():
    u = Feedforward().control(0.1, np.zeros(8), Sine(amplitude=0.1, omega=20.0), NOTHING)
    assert np.isfinite(u).all()
