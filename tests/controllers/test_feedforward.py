import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from controllers.linear import LQR, Feedforward, PolePlacement
from controllers.references import Circle, Hold, Lissajous, Sine

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


def test_the_flat_model_started_on_the_trajectory_stays_on_it():
    law = Feedforward()

    def rate(t, x):
        return MODEL.flat(x, law.control(t, x, FAST, NOTHING))

    times = np.linspace(0, 8, 81)
    x = solve_ivp(rate, (0, 8), np.zeros(8), t_eval=times, rtol=1e-9, atol=1e-12).y.T
    np.testing.assert_allclose(x[:, [0, 4]], FAST(times)[0], atol=1e-7)


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


def test_a_resting_reference_leaves_the_feedback_alone():
    x = np.random.default_rng(6).normal(size=8) * 0.1
    hold = Hold(x=0.1, y=-0.05)
    alone = LQR(rho=300, kappa=0.3).control(0.0, x, hold, NOTHING)
    np.testing.assert_allclose(Feedforward().control(0.0, x, hold, NOTHING), alone)


def test_a_reference_beyond_gravity_still_gives_a_finite_input():
    u = Feedforward().control(0.1, np.zeros(8), Sine(amplitude=0.1, omega=20.0), NOTHING)
    assert np.isfinite(u).all()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"poles": (-1, -2, -3)}, "poles must be 4 numbers, got 3"),
        ({"poles": (-1, -2, -3, 4)}, "poles must have a negative real part, got 4"),
        ({"poles": (-1, -2, -3, -4), "rho": 100}, "poles replace rho and kappa"),
    ],
    ids=range(3),
)
def test_settings_that_cannot_be_are_refused_in_one_line(wrong, said):
    with pytest.raises(ValueError, match=rf"\A{said}.*\Z"):
        Feedforward(**wrong)
