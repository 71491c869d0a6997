"""`twin.emulator.can_bus`.

The emulated bus: what it does to frames, and what it makes of a computer that is late."""

import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from serving import serving

from twin.base.jobs import wait_until
from twin.emulator import serve
from twin.emulator.can_bus import BusFaults, BusServer, EmulatedBus, SlcanPort, Towards
from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import Frame
from twin.emulator.serve import PauseWatch


@pytest.fixture
def bus():
    return EmulatedBus([EmulatedDrive(node) for node in (1, 2)])


def frames(faults, count=100, cob_id=0x181):
    return [faults.deliver(Frame(cob_id, bytes(range(8))), Towards.HOST) for _ in range(count)]


def test_the_same_seed_does_the_same_damage():
    made = []
    for _ in range(2):
        faults = BusFaults(seed=3)
        faults.drop(share=0.3)
        made.append(frames(faults))
    assert made[0] == made[1]
    assert 50 < sum(bool(each) for each in made[0]) < 90


def test_damage_hits_only_its_frames_way_and_time():
    faults = BusFaults()
    faults.drop(0x181, towards=Towards.HOST, after=1.0, lasting=1.0)
    assert frames(faults, 1) == [[(0.0, Frame(0x181, bytes(range(8))))]]
    faults.time = 1.5
    assert frames(faults, 1) == [[]]
    assert frames(faults, 1, 0x182) != [[]]
    assert faults.deliver(Frame(0x181), Towards.DRIVES)
    faults.time = 2.0
    assert frames(faults, 1) != [[]]


def test_a_delayed_frame_comes_later_and_once(bus):
    bus.step(0.001)
    bus.to_host()
    bus.faults.delay(0x581, by=0.005)
    bus.from_host(Frame(0x601, bytes.fromhex("4000100000000000")))
    bus.step(0.004)
    assert bus.to_host() == []
    bus.step(0.002)
    assert [frame.cob_id for frame in bus.to_host()] == [0x581]


@pytest.mark.real_time
def test_an_emulator_that_starves_says_how_far_it_was_behind(bus):
    with SlcanPort(bus) as port, serving(BusServer(bus, port)) as server:
        with server.lock:
            time.sleep(0.08)
        assert wait_until(lambda: server.lag.longest > 0.06, 60.0)


FORWARD = """
import os
from twin.emulator.serve import EMULATOR_PRIORITY, come_forward
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    allowed = True
except OSError:
    allowed = False
os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
come_forward()
assert (os.sched_getscheduler(0) == os.SCHED_FIFO) is allowed
assert not allowed or os.sched_getparam(0).sched_priority == EMULATOR_PRIORITY
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no SCHED_FIFO here")
def test_an_emulator_in_a_process_of_its_own_comes_before_ordinary_ones():
    done = subprocess.run([sys.executable, "-c", FORWARD], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()


MS = 1e-3


@pytest.mark.parametrize(
    ("gaps", "paused"),
    [
        # both stood still from 10 on; the host comes round at 30, the emulator at 31
        ([(0, 10, 30), (1, 10, 31)], [20, 20]),
        ([(1, 10, 31), (0, 10, 30)], [21, 20]),
        # one computed for long, the other came round meanwhile
        ([(1, 28, 29), (0, 10, 30)], [0, 0]),
        ([(0, 28, 30), (1, 10, 31)], [0, 0]),
        # one computed from 5 on, and the computer paused from 10 to 30
        ([(1, 10, 30), (0, 5, 30.5)], [20, 20]),
        # what the other missed in two parts before this one looked, and what it misses still
        ([(1, 10, 30), (1, 31, 36), (0, 10, 37)], [20, 5, 26]),
        ([(1, 10, 30), (0, 10, 60)], [20, 50]),
        # a missed period is no pause
        ([(1, 10, 14), (0, 10, 14)], [0, 0]),
        # what the other told of an earlier one is not counted again
        ([(0, 10, 30), (1, 10, 30), (1, 59, 60), (0, 40, 60)], [20, 20, 0, 0]),
    ],
)
def test_a_pause_is_what_neither_process_had_of_the_computer(gaps, paused, monkeypatch):
    monkeypatch.setattr(PauseWatch, "_waited", lambda _, now: now)
    cells = [0.0] * 6
    sides = [PauseWatch(cells, side) for side in (0, 1)]
    for side in sides:
        side.paused(9 * MS, 10 * MS)
    found = [sides[side].paused(begin * MS, end * MS) for side, begin, end in gaps]
    assert found == pytest.approx([each * MS for each in paused])


def test_a_host_waits_for_an_emulator_that_has_no_processor_and_both_leave_that_out(monkeypatch):
    cells, clock = [0.0] * 6, SimpleNamespace(now=10 * MS)
    host, rig = (PauseWatch(cells, side) for side in (0, 1))
    left = []

    def sleep(seconds):
        clock.now += seconds
        if 60 * MS <= clock.now < 60.3 * MS:
            left.append(rig.paused(10 * MS, clock.now))

    monkeypatch.setattr(serve, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: clock.now))
    rig.paused(9 * MS, 10 * MS)
    assert host.paused(9 * MS, 10 * MS) == 0
    clock.now = 12 * MS  # a period later nothing is late yet
    assert host.paused(10 * MS, clock.now) == 0
    clock.now = 14.1 * MS
    away = host.paused(12 * MS, clock.now)
    assert clock.now == pytest.approx(60 * MS, abs=0.5 * MS)
    assert away == pytest.approx(48 * MS, abs=0.5 * MS)
    assert left == [pytest.approx(away, abs=0.5 * MS)]
    # one that is dead is waited for once
    clock.now = 80 * MS
    host.paused(60 * MS, clock.now)
    assert clock.now == pytest.approx(80 * MS + PauseWatch.MOST, abs=MS)
    before = clock.now
    host.paused(before, before + 2 * MS)
    assert clock.now == before
