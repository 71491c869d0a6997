"""Tests of `twin.devices.realtime`."""

import ctypes
import gc
import os
import subprocess
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices import realtime
from twin.devices.realtime import LOOP_OVERRUN, RealTimeClock, ahead, real_time

PERIOD = 1 / 512


class Time:
    """Made-up time: reading it takes 2 us, sleeping takes as long as asked and a little more."""

    def __init__(self, oversleep):
        self.now = 100.0
        self.oversleep = oversleep

    def __call__(self):
        self.now += 2e-6
        return self.now

    def sleep(self, seconds):
        assert seconds > 0
        self.now += seconds + self.oversleep


def clock(oversleep=0.0, **options):
    time = Time(oversleep)
    made = RealTimeClock(PERIOD, now=time, sleep=time.sleep, **options)
    made.start()
    return made, time


def test_what_is_left_of_a_period_that_is_missed_already_is_that_of_the_next():
    made, time = clock()
    made.wait()
    assert made.left == pytest.approx(PERIOD, abs=2e-5)
    time.now += 2.25 * PERIOD
    assert made.left == pytest.approx(0.75 * PERIOD, abs=2e-5)
    begin, left = time.now, made.left
    made.wait()
    assert time.now - begin == pytest.approx(left, abs=2e-5)


def test_being_late_within_a_period_is_counted_and_no_fault():
    made, _ = clock(oversleep=1e-3, allowed=10)
    for _ in range(100):
        made.wait()
    assert made.faults() == ()
    assert made.timing.late == 100


@pytest.mark.parametrize(("missed", "within"), [(1, None), (2, None), (3, 0.21), (6, 0.21)])
def test_a_loop_may_miss_two_of_three_periods_for_ever_and_more_for_a_fifth_of_a_second(
    missed, within
):
    made, time = clock()
    faults, begin = (), time.now
    while not faults and time.now < begin + 5:
        time.now += (missed + 0.5) * PERIOD
        made.wait()
        faults = made.faults()
    if within is None:
        assert not faults
        return
    (fault,) = faults
    assert fault.condition is LOOP_OVERRUN
    assert f"{missed} periods" in fault.detail
    assert time.now - begin < LOOP_OVERRUN.longest(PERIOD) < within


def test_a_stall_of_as_many_periods_is_a_fault_at_once():
    made, time = clock(allowed=10)
    made.wait()
    time.now += 12.5 * PERIOD
    made.wait()
    assert len(made.faults()) == 1


@given(work=st.lists(st.floats(0, 0.02), max_size=60))
def test_a_period_begins_at_the_next_multiple_and_those_that_passed_are_counted(work):
    made, time = clock(oversleep=1e-4)
    begin = time.now
    for seconds in work:
        time.now += seconds
        done = time.now
        made.wait()
        assert time.now - done < PERIOD + 2e-5
        assert 0 <= time.now - begin - made.tick * PERIOD < 2e-5
        assert made.time == made.tick * PERIOD
    assert made.timing.ticks + made.timing.missed == made.tick


@pytest.mark.parametrize("asleep", [False, True])
@pytest.mark.parametrize("told", [0.0, 9 * PERIOD])
def test_a_virtual_rigs_periods_are_put_off_by_what_its_computer_paused(asleep, told):
    made, time = clock(paused=lambda begin, end: told if end - begin > 5 * PERIOD else 0.0)
    made.wait()
    made.wait()
    if asleep:
        time.oversleep = 9 * PERIOD
    else:
        time.now += 9 * PERIOD
    made.wait()
    time.oversleep, lost = 0.0, 0 if told else 9
    # who is late by nine periods in sleep misses the next eight
    assert made.timing.missed == (0 if asleep else lost)
    assert made.timing.late == (1 if asleep and lost else 0)
    assert sum(made.timing.pauses) == told
    assert ("paused 1 time" in made.timing.text()[-1]) is (told > 0)
    made.wait()
    assert made.timing.missed == lost - (asleep and lost > 0)
    assert made.tick == 4 + made.timing.missed


linux = pytest.mark.skipif(sys.platform != "linux", reason="Linux's scheduling")


REAL_TIME = """
import gc, os, sys
from pathlib import Path
from twin.devices.realtime import real_time

def locked():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))

before = (os.sched_getscheduler(0), gc.isenabled(), sys.getswitchinterval(), locked())
with real_time() as obtained:
    assert not gc.isenabled()
    inside = os.sched_getscheduler(0)
    assert obtained.locked == (locked() > 0)
assert obtained.fifo == (inside == os.SCHED_FIFO | os.SCHED_RESET_ON_FORK)
assert (os.sched_getscheduler(0), gc.isenabled(), sys.getswitchinterval(), locked()) == before
assert gc.get_freeze_count() == 0
"""


@linux
def test_leaving_real_time_leaves_everything_as_it_was():
    # in a small process: to lock memory is to fetch it, gigabytes after some hundred tests
    done = subprocess.run(
        [sys.executable, "-c", REAL_TIME], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@linux
@pytest.mark.usefixtures("unlocked")
def test_a_thread_is_an_ordinary_one_or_comes_before_the_loop_where_it_must_not_wait():
    def priority():
        found.append(os.sched_getparam(0).sched_priority)

    found = []
    with real_time() as obtained:
        for work in (ahead(priority), priority):
            thread = threading.Thread(target=work)
            thread.start()
            thread.join()
        assert found == [81 if obtained.fifo else 0, 0]
    assert ahead(priority) is priority


@pytest.mark.usefixtures("unlocked")
@pytest.mark.parametrize("there", [True, False])
def test_processors_are_kept_awake_where_the_system_lets_one(monkeypatch, tmp_path, there):
    request = tmp_path / "latency"
    if there:
        request.write_bytes(b"")
    monkeypatch.setattr(realtime, "_LATENCY_DEVICE", str(request))
    with real_time() as obtained:
        assert ("processors kept awake" in obtained.words) is there
        assert request.exists() is there
    if there:
        assert request.read_bytes() == bytes(4)


@linux
@pytest.mark.usefixtures("unlocked")
def test_what_is_refused_is_said_with_what_to_do(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(realtime.os, "sched_setscheduler", refuse)
    with real_time() as obtained:
        assert obtained.fifo is False
    assert "limits.conf" in obtained.words[0]
    assert "not locked" in obtained.words[1]


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_where_the_system_has_no_such_scheduling_the_loop_runs_all_the_same(monkeypatch, platform):
    for name in [each for each in dir(os) if each.startswith(("sched_", "SCHED_"))]:
        monkeypatch.delattr(os, name)
    monkeypatch.setattr(ctypes, "CDLL", None)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(gc, "collect", int)  # of all tests
    with real_time() as obtained:
        assert not gc.isenabled()
    assert gc.isenabled()
    assert (obtained.fifo, obtained.locked) == (False, False)
    assert all("only Linux grants it" in words for words in obtained.words[:2])
