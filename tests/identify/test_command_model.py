"""`twin.identify.command_model`: what is computed of a tilt, and what is not computed again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.identify.command_model import (
    ACCELERATION_STEPS,
    FINE_LAG_STEP_S,
    DeadBandScan,
    TiltHistory,
    apply_play,
    residual_by_dead_band,
)
from twin.identify.windows import axis_windows, spans

DRIVE = (0.04, 0.0, 0.4, 0.0, 0.08)
"""Lag in s, no dead band, half a play and no slew in swings, lever in m."""


def follow_by_plain_recurrence(track, half):
    """A plate behind a gap, sample by sample."""
    place, places = 0.0, []
    for each in track.tolist():
        place = min(max(place, each - half), each + half)
        places.append(place)
    return places


@pytest.mark.parametrize("half", [0.0, 0.05, 0.5, 3.0])
@pytest.mark.parametrize(
    "track",
    [
        np.round(np.random.default_rng(4).normal(0.0, 0.7, 300), 1),
        np.repeat(np.random.default_rng(5).normal(0.0, 0.7, 60), 7),
        np.linspace(1.5, -2.0, 30),
        np.linspace(-1.5, 2.0, 30),
        np.full(5, 1.2),
        np.array([-0.7]),
        np.array([0.2, 0.2, -0.9, -0.9, -0.9, 0.4, 0.4]),
    ],
    ids=["noise", "steps", "falls", "rises", "rests", "one", "falls first"],
)
def test_play_is_that_of_the_plain_recurrence_to_the_last_bit(track, half):
    assert apply_play(track, half).tolist() == follow_by_plain_recurrence(track, half)


def test_a_tilt_is_simulated_no_longer_than_samples_show_it_and_is_the_same_until_then(log):
    """Behind lag, play and lever, sample by sample; the command stands from row to row."""
    found = TiltHistory(log)
    whole = TiltHistory(replace(log, sampled=log.time, ball=0 * log.time))
    assert found.time[-1] == pytest.approx(log.sampled[-1] + 1.0, abs=2 * FINE_LAG_STEP_S)
    assert whole.time[-1] == pytest.approx(log.time[-1], abs=2 * FINE_LAG_STEP_S)
    late = np.linspace(0.0, log.sampled[-1] + 0.9, 500)  # a clock may be half a second late
    assert (found.at(late, *DRIVE) == whole.at(late, *DRIVE)).all()
    assert (found.integrate(late, *DRIVE) == whole.integrate(late, *DRIVE)).all()

    count, stay = len(found.time) - 1, np.exp(-FINE_LAG_STEP_S / DRIVE[0])
    sent = log.tilt[np.arange(count) * 2 // 20] / np.std(log.tilt)
    lagged = [sent[0]]
    for each in sent[1:]:
        lagged.append(stay * lagged[-1] + (1 - stay) * each)
    plate = np.array(follow_by_plain_recurrence(np.array(lagged), DRIVE[2]))
    turns = ACCELERATION_STEPS[True]
    bend = (plate[2 * turns :] - 2 * plate[turns:-turns] + plate[: -2 * turns]) / (
        turns * FINE_LAG_STEP_S
    ) ** 2
    inside = plate[turns:-turns] - DRIVE[4] / BallPlate.gravity * bend
    at = found.time[1 + turns : count + 1 - turns]
    assert found.at(at, *DRIVE)[:-1] == pytest.approx(inside[:-1], abs=1e-6)


def test_a_part_of_a_log_shares_what_was_simulated_and_a_log_of_other_commands_does_not(log):
    whole = TiltHistory(log, 0.3)
    part = whole.on(log.between(3.0, 9.0))
    assert part.lagged is whole.lagged
    assert part.scale == 0.3
    assert len(part.log.sampled) < len(log.sampled)
    at = np.linspace(3.0, 9.0, 100)
    assert (part.at(at, *DRIVE) == TiltHistory(part.log, 0.3).at(at, *DRIVE)).all()
    longer = TiltHistory(part.log).on(log)
    assert longer.time[-1] > part.log.sampled[-1] + 1.5
    for other in (replace(log, tilt=2 * log.tilt), replace(log, lever=0.1)):
        again = whole.on(other)
        assert again.log is other
        assert again.lagged is not whole.lagged
    doubled = whole.on(replace(log, tilt=2 * log.tilt)).at(at, 0.04)
    assert doubled == pytest.approx(2 * whole.at(at, 0.04), rel=1e-9)


def test_dead_bands_are_compared_by_commands_that_windows_show_alone(log):
    """What is commanded after the last window changes nothing."""
    windows = axis_windows(log, *spans(log, 2.5))
    scan = DeadBandScan(dead_bands=(0.0, 0.1, 0.3, 0.9))
    last = windows.begin[-1] + windows.time.max() - 0.1
    found, later, earlier = (
        residual_by_dead_band(
            TiltHistory(replace(log, tilt=log.tilt + 0.1 * changed), 0.05), windows, 0.1, 0.05, scan
        )
        for changed in (0, log.time > last + 0.04, abs(log.time - last + 0.2) < 0.1)
    )
    assert len(set(found)) == 4
    assert (found == later).all()
    assert (found != earlier).all()
