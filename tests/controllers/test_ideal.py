import numpy as np
import pytest

from controllers.interfaces import Measurement
from controllers.observers import Ideal


def seen(state):
    shape = state.shape[:-1]
    return Measurement(0.0, state[..., ::2], np.zeros(shape), np.ones(shape, bool), state)


def test_state_is_handed_on_but_for_the_plate_rates():
    observer = Ideal()
    observer.start(np.zeros((3, 8)))
    state = np.random.default_rng(0).normal(size=(3, 8))
    x = observer.correct(seen(state))
    rates = [3, 7]
    others = [0, 1, 2, 4, 5, 6]
    np.testing.assert_array_equal(x[:, others], state[:, others])
    np.testing.assert_array_equal(x[:, rates], 0)


def test_plate_rates_are_the_integral_of_the_applied_input():
    observer = Ideal(period=0.01)
    rng = np.random.default_rng(1)
    start, inputs = rng.normal(size=8), rng.normal(size=(20, 2))
    observer.start(start)
    for u in inputs:
        observer.correct(seen(rng.normal(size=8)))
        observer.predict(u)
    x = observer.correct(seen(np.zeros(8)))
    np.testing.assert_allclose(x[3::4], start[3::4] + 0.01 * inputs.sum(axis=0), rtol=1e-12)


def test_true_state_is_not_written_to():
    observer = Ideal()
    observer.start(np.zeros(8))
    state = np.ones(8)
    observer.correct(seen(state))
    observer.predict(np.ones(2))
    np.testing.assert_array_equal(state, 1)


def test_rig_that_keeps_its_state_to_itself_is_refused():
    observer = Ideal()
    observer.start(np.zeros(8))
    measurement = Measurement(0.0, np.zeros(4), np.zeros(()), np.array(True))
    with pytest.raises(ValueError, match="'ideal' needs a simulated rig with ideal sensors"):
        observer.correct(measurement)
