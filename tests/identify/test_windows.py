"""`twin.identify.windows`: The samples of a window are those between its ends, each in its bin."""

import numpy as np

from twin.identify.least_squares import SampleWindows
from twin.identify.windows import SAMPLE_BIN_S, Spans, find_moving, samples_in_bins


def test_samples_lie_in_the_bins_that_their_times_say():
    rng = np.random.default_rng(1)
    time = np.sort(rng.uniform(0, 20, 900))
    begin = np.sort(rng.uniform(-1, 20, 40))  # some overlap, some begin before the first sample
    length = SAMPLE_BIN_S * rng.integers(0, 120, 40)
    # a sample on each edge of a window
    time = np.sort(np.concatenate((time, begin, begin + length)))
    row, sample, place = samples_in_bins(time, Spans(begin, length, begin > 5))
    expected = [
        (w, n, int(np.floor((t - first) / SAMPLE_BIN_S + 1e-6)))
        for w, (first, long) in enumerate(zip(begin, length, strict=True))
        for n, t in enumerate(time)
        if -1e-6 * SAMPLE_BIN_S <= t - first < long - 1e-6 * SAMPLE_BIN_S
    ]
    assert len(expected) > 1000
    assert np.array_equal(np.stack((row, sample, place), axis=-1), expected)


def test_no_window_holds_no_sample():
    none = np.zeros(0)
    found = samples_in_bins(np.arange(5.0), Spans(none, none, none > 0))
    assert [len(each) for each in found] == [0, 0, 0]


def test_windows_in_which_the_ball_moves_are_found_by_the_samples_they_have():
    ball = np.array([[0.0, 0.004, 0.9], [0.0, 0.006, 0.0], [0.01, -0.2, 0.01]])
    weight = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    windows = SampleWindows(np.arange(3.0), ball, ball[..., None], weight[..., None])
    assert find_moving(windows, 0.005).tolist() == [False, True, False]
    assert find_moving(windows, 0.007).tolist() == [True, True, True]
