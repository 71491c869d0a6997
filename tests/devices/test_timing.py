"""Tests of `twin.devices.realtime`."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.realtime import LatencyHistogram, TimingLog, describe_lateness

MICRO = 1e-6


def counted(*micros):
    times = LatencyHistogram()
    for value in micros:
        times.add(value * MICRO)
    return times


def test_a_duration_beyond_the_limit_is_still_the_longest():
    times = counted(10, 10, 50_000)
    assert times.quantile(1.0) == pytest.approx(0.05)
    assert times.quantile(0.6) == pytest.approx(10 * MICRO)


def test_nothing_counted_is_zero():
    assert LatencyHistogram().as_dict() == {"number": 0, "p50_us": 0, "p99_us": 0, "max_us": 0}


@given(micros=st.lists(st.integers(0, 19_000), min_size=1, max_size=60), share=st.floats(0.01, 1.0))
def test_a_quantile_is_that_of_the_sorted_durations(micros, share):
    expected = np.quantile(micros, share, method="inverted_cdf")
    assert counted(*micros).quantile(share) == pytest.approx(expected * MICRO, abs=1e-9)


def timing():
    """Ten periods of 2 ms, two late, one of them after three missed ones; two stages."""
    now = iter(np.cumsum([0, 100, 50, 1000, 100, 150]) * MICRO)
    log = TimingLog(0.002, now=lambda: next(now))
    for lateness in (5, 5, 5, 5, 5, 5, 5, 5, 600):
        log.tick(lateness * MICRO)
    log.tick(1500 * MICRO, missed=3)
    for _ in range(2):
        log.begin()
        log.mark("read")
        log.mark("control")
    log.trips.add(400 * MICRO)
    return log


def test_the_timing_log_says_what_happened_in_numbers():
    assert timing().as_dict() == {
        "period_us": 2000,
        "pauses_us": [],
        "ticks": 10,
        "missed": 3,
        "late": 2,
        "lateness": {"number": 10, "p50_us": 5, "p99_us": 1500, "max_us": 1500},
        "stages": {
            "read": {"number": 2, "p50_us": 100, "p99_us": 100, "max_us": 100},
            "control": {"number": 2, "p50_us": 50, "p99_us": 150, "max_us": 150},
        },
        "round_trip": {"number": 1, "p50_us": 400, "p99_us": 400, "max_us": 400},
    }


def test_the_timing_log_says_what_happened_in_words():
    assert timing().text() == [
        "10 ticks of 2 ms, 3 missed (23.08 %), 2 late by more than 0.5 ms",
        "lateness: p50 0.005 ms, p99 1.500 ms, max 1.500 ms",
        "read: p50 0.100 ms, p99 0.100 ms, max 0.100 ms",
        "control: p50 0.050 ms, p99 0.150 ms, max 0.150 ms",
        "bus round trip: p50 0.400 ms, p99 0.400 ms, max 0.400 ms",
    ]


def test_a_fault_is_put_down_to_a_late_computer_only_if_it_was_late():
    log = TimingLog(0.002)
    for _ in range(100):
        log.tick(0.0001)
    assert describe_lateness(log.as_dict()) == ""
    log.tick(0.011)
    assert "1 of 101 periods were late or missed, one by 11 ms" in describe_lateness(log.as_dict())
    often = TimingLog(0.002)
    for late in (0.0001, 0.001) * 10:
        often.tick(late)
    assert "this computer was too late, not the rig: 10 of 20 periods" in describe_lateness(
        often.as_dict()
    )
    skipped = TimingLog(0.002)
    skipped.tick(0.0, missed=30)
    assert "30 of 31 periods were late or missed; close" in describe_lateness(skipped.as_dict())
