import numpy as np
import pytest

from controllers.advanced import InternalModel
from controllers.ballplate import BallPlate
from controllers.references import Hold, Sine

MODEL = BallPlate()


def closed(law):
    """The linear plant (5.35) under the law, of plant and memory, shape (n, n)."""
    A, B, _ = MODEL.linear()
    rows = []
    for s in np.eye(8 + law.memory):
        x, q = s[:8], s[8:]
        u = law.control(0.0, x, Hold(), q)
        rows.append(np.concatenate((A @ x + B @ u, law.memory_rate(0.0, x, Hold(), q))))
    return np.array(rows).T


def last_error(law, path, force, omega):
    """Amplitude of the error in the steady state, of a path and a force that swing with omega.

    Args:
        law: The law.
        path: The reference.
        force: Of time in s, as acceleration of x and y.
        omega: In rad/s.
    """
    _, B, _ = MODEL.linear()
    zero, none = np.zeros(8), np.zeros(law.memory)

    def pushed(t):
        x = B @ law.control(t, zero, path, none)
        x[1::4] += force(t)
        return np.concatenate((x, law.memory_rate(t, zero, path, none)))

    def phasor(value):
        quarter = np.pi / 2 / omega if omega else 0.0
        return value(0.0) - 1j * value(quarter) * (omega > 0)

    A = closed(law)
    s = np.linalg.solve(1j * omega * np.eye(len(A)) - A, phasor(pushed))
    return np.abs(s[0:8:4] - phasor(lambda t: path(t)[0])).max()


def swinging(omega):
    return lambda t: np.array([0.05 * np.cos(omega * t + 0.3), 0.03 * np.sin(omega * t)])


def test_a_sinusoid_of_the_models_frequency_leaves_no_error_and_another_does():
    law = InternalModel(frequencies=(0.75,))
    path = Sine(amplitude=(0.15, 0.1), omega=0.75)
    assert last_error(law, path, swinging(0.75), 0.75) < 1e-12
    assert last_error(law, Hold(x=0.1), lambda t: np.array([0.03, -0.02]), 0.0) < 1e-12
    assert last_error(law, Hold(), swinging(1.5), 1.5) > 1e-4
    assert last_error(InternalModel(frequencies=(0.75, 1.5)), Hold(), swinging(1.5), 1.5) < 1e-12


@pytest.mark.parametrize("frequencies", [(), (0.5,), (0.75, 2.25), (2.0,)])
def test_all_that_is_wrong_dies_out_as_fast_as_is_asked(frequencies):
    law = InternalModel(frequencies=frequencies, decay=0.4)
    assert np.linalg.eigvals(closed(law)).real.max() < -0.4
