"""The ball's path between its touches."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.whatif.moment import FEWEST, HALF, path


@given(seed=st.integers(0, 10_000), rate=st.sampled_from([30, 58, 200]))
def test_the_path_is_the_parabola_of_least_squares_through_the_touches_about_it(seed, rate):
    noise = np.random.default_rng(seed)
    known = np.cumsum(noise.uniform(0.5, 1.5, 60) / rate)
    ball = np.stack((np.sin(3 * known), known**2), axis=1) + noise.normal(0, 1e-3, (60, 2))
    time = np.linspace(known[0] - 0.05, known[-1] + 0.05, 90)
    place, speed = path(time, (known, ball))
    for row, now in enumerate(time):
        near = (known >= now - HALF) & (known < now + HALF)
        if near.sum() < FEWEST or known[near][0] > now or known[near][-1] < now:
            assert np.isnan(place[row]).all()
            continue
        curve = np.polyfit(known[near] - now, ball[near], 2)
        np.testing.assert_allclose(place[row], curve[2], atol=1e-9)
        np.testing.assert_allclose(speed[row], curve[1], atol=1e-7)


def test_without_touches_nothing_is_known():
    place, speed = path(np.arange(3.0), (np.zeros(0), np.zeros((0, 2))))
    assert np.isnan(place).all()
    assert np.isnan(speed).all()
