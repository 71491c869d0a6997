"""`twin.identify.clocks`: Clocks that wrap, and seconds with nanoseconds apart."""

import numpy as np
import pytest

from twin.identify.any_logs import read_any
from twin.identify.clocks import pair_seconds, unwrap
from twin.identify.log_columns import wanted_columns
from twin.identify.survey import survey

T = 0.02 * np.arange(400)
X = 0.05 * np.sin(1.3 * T)
MS = 20.0 * np.arange(400)
WRAPPED = {
    "16 bits": ((MS + 60000) % 65536, "ms"),
    "16 bits with a sign": ((MS + 60000) % 65536 - 32768, "ms"),
    "24 bits": ((1e3 * MS + 2**24 - 3e6) % 2**24, "us"),
    "32 bits": ((MS + 2**32 - 5010) % 2**32, "ms"),
    "32 bits in us": ((1e3 * MS + 2**32 - 3e6) % 2**32, "us"),
    "us in s": ((T + 4294.0) % 4294.967296, "s"),
    "us in ms": ((MS + 4294000.0) % 4294967.296, "ms"),
    "8 bits": ((MS / 10) % 256, "10ms"),
}


@pytest.mark.parametrize("name", WRAPPED)
def test_a_counter_that_wraps_goes_on(tmp_path, name):
    clock, unit = WRAPPED[name]
    rows = [f"{t:.7f},{x:.6f},{np.cos(t0)}" for t, x, t0 in zip(clock, X, T, strict=True)]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["tick,x,u", *rows]))
    log = read_any(file, wanted_columns(f"time=tick:{unit},measured_x=x:m,command_phi=u:deg"))
    assert log.axes["x"].sampled == pytest.approx(T, abs=1e-5)
    assert any("tick wraps" in note for note in log.notes)
    assert any("wraps" in note for note in survey(file).notes)


@pytest.mark.parametrize(
    ("hours", "base"), [(24, 86396.0), (12, 43196.0)], ids=["24 hours", "12 hours"]
)
def test_a_time_of_day_goes_on_after_midnight_and_noon(tmp_path, hours, base):
    at = (base + T) % (3600 * hours)
    clocks = [f"{t // 3600:02.0f}:{t % 3600 // 60:02.0f}:{t % 60:06.3f}" for t in at.round(3)]
    rows = [f"{t};{1e3 * x:.3f};{np.cos(t0)}" for t, x, t0 in zip(clocks, X, T, strict=True)]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["time;x;u", *rows]))
    log = read_any(file, wanted_columns("time=time,measured_x=x:mm,command_phi=u:deg"))
    assert log.axes["x"].sampled == pytest.approx(T, abs=2e-3)


def test_a_log_is_surveyed_by_a_time_of_day_with_an_empty_cell(tmp_path):
    at = (86398.0 + T) % 86400
    clocks = [f"{t // 3600:02.0f}:{t % 3600 // 60:02.0f}:{t % 60:06.3f}" for t in at.round(3)]
    clocks[-5] = ""
    rows = [f"{t};{1e3 * x:.3f};{np.cos(t0)}" for t, x, t0 in zip(clocks, X, T, strict=True)]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["time;x;u", *rows]))
    assert any("time: wraps 1 time" in note for note in survey(file).notes)


@pytest.mark.parametrize("last", [65000.0, 65300.0, 70000.0, 2.0**31])
def test_a_board_that_begins_anew_does_not_wrap(last):
    first = last - MS[::-1]
    clock = np.concatenate((first, MS))
    going, wraps = unwrap(clock)
    assert wraps == 0
    assert (going == clock).all()


def test_numbers_that_lack_or_lose_a_row_at_the_wrap_go_on():
    clock = (MS + 60000) % 65536
    at = int(np.flatnonzero(np.diff(clock) < 0)[0])
    clock[at] = np.nan
    going, wraps = unwrap(np.delete(clock, at + 1))
    assert wraps == 1
    steps = np.diff(going[np.isfinite(going)])
    assert set(steps) == {20.0, 60.0}


def test_nanoseconds_belong_to_the_seconds_of_the_same_stamp():
    names = ["header.stamp.sec", "x", "header.stamp.nanosec", "other.secs", "secs", "nsecs"]
    assert pair_seconds(names) == [(0, 2), (4, 5)]
