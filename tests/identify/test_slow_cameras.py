"""`twin.identify.slow_cameras`: A camera of 5 Hz shows a rig as well as its samples allow."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from twin.identify.axis_logs import AxisLog
from twin.identify.axis_selection import AXIS_SELECTION
from twin.identify.first_look import look_first
from twin.identify.slow_cameras import scale_selection, scale_to_samples, scale_weak_form
from twin.identify.weak_form import WEAK_FORM
from twin.identify.windows import spans, usual_step

GAIN, DAMPING, DELAY_S = -0.7, 1.3, 0.1
"""Of a ball in water, m/s^2 per rad, 1/s, and s."""


def slow_log(seed, *, camera_hz=5.0, seconds=60.0, noise_m=0.002):
    """A ball that obeys x'' = gain u(t - delay) - damping x', solved exactly by steps of 10 ms."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 0.01)
    rates, phases = random.uniform(0.8, 3.0, 3), random.uniform(0, 6.3, 3)
    tilt = 0.3 * np.sin(rates * time[:, None] + phases).sum(axis=1)
    late = np.interp(time - DELAY_S, time, tilt)
    system = scipy.signal.StateSpace([[0, 1], [0, -DAMPING]], [[0], [GAIN]], [[1, 0]], [[0]])
    place = scipy.signal.lsim(system, late, time)[1]
    seen = np.arange(0, len(time), round(100 / camera_hz))
    ball = place[seen] + noise_m * random.standard_normal(len(seen))
    return AxisLog(time[::5], tilt[::5], True, time[seen], ball)


def test_the_windows_of_a_usual_camera_stay_as_they_are():
    assert scale_to_samples(1 / 20.5, AXIS_SELECTION) == (AXIS_SELECTION, WEAK_FORM)


@pytest.mark.parametrize("rate", [5.0, 8.0, 10.0])
def test_windows_hold_as_many_samples_as_a_fit_needs(rate):
    log = slow_log(1, camera_hz=rate)
    step = usual_step(log)
    selection = scale_selection(step)
    first = selection.fitting.search.first_window_s
    for longest in (first, *(share * selection.window_s for share in (1.0, 0.5, 0.32))):
        begin, end = spans(log, longest)
        assert (end - begin).sum() > 0.8 * np.ptp(log.sampled)
    # a prediction has a sample near its horizon, wherever it begins
    assert selection.fitting.hold_out.horizon_tolerance_s > step / 2
    assert selection.fitting.hold_out.lead_s >= 4 * step - 1e-9


def test_two_frames_that_a_slow_camera_misses_are_no_gap():
    log = slow_log(1)
    there = np.ones(len(log.sampled), bool)
    there[[50, 51, 120]] = False
    missed = replace(log, sampled=log.sampled[there], ball=log.ball[there])
    begin, end = spans(missed, 4.0)
    assert (end - begin).sum() > 0.95 * np.ptp(log.sampled)
    there[50:55] = False
    paused = replace(log, sampled=log.sampled[there], ball=log.ball[there])
    begin, end = spans(paused, 4.0)
    assert not ((begin < log.sampled[50]) & (end > log.sampled[55])).any()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_first_look_by_a_slow_camera_has_gain_and_damping(seed):
    log = slow_log(seed)
    look = look_first(log, scale_weak_form(usual_step(log)))
    assert look.gain == pytest.approx(GAIN, rel=0.15)
    assert look.damping == pytest.approx(DAMPING, rel=0.25)
