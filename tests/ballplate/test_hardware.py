"""`ballplate.hardware`.

What is told of a rig after its run, and what stays of one that is killed."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import nullcontext, suppress
from functools import partial
from types import SimpleNamespace

import can
import numpy as np
import pytest

import ballplate as bp
from ballplate.evidence import stream_record, write_trace
from ballplate.reporter import Reporter
from ballplate.rig_access import summarize_events, tell_timing
from twin.base.errors import TwinError
from twin.devices.akd.conditions import NODE_ABSENT, DriveError
from twin.devices.akd.traces import read_trace
from twin.devices.realtime import TimingLog, real_time
from twin.hal.interface import Condition, Severity
from twin.hal.rig import Entry
from twin.identify.logs import read
from twin.run import plants
from twin.run.connect import ComputingTime
from twin.run.finished import run
from twin.scenario.load import load

pytestmark = pytest.mark.usefixtures("no_pictures", "quick_pictures")


class Heard(Reporter):
    """Keeps what it is told."""

    def __init__(self):
        self.lines = []

    def note(self, line, *, weighty=False):
        self.lines.append(line)


@pytest.mark.parametrize(
    ("severity", "told"),
    [(Severity.WARNING, False), (Severity.LEVEL, True), (Severity.STOP, True)],
)
def test_a_late_computer_is_told_first_where_a_condition_ended_the_run(severity, told):
    timing = TimingLog(0.002)
    for _ in range(20):
        timing.tick(0.004)
    note = SimpleNamespace(
        condition=Condition("unsteady", severity, 0.1, "", ""), text="PDOs unsteady"
    )
    clock = SimpleNamespace(timing=timing)
    rig = SimpleNamespace(clock=clock, scheduling=(), journal=[Entry(0.37, note)])
    heard = Heard()
    tell_timing(rig, heard)
    assert heard.lines[0].startswith("this computer was too late") is told
    assert heard.lines[-1] == f"0.370 s {severity}: PDOs unsteady"


BUSY = """
import time
from dataclasses import dataclass
import numpy as np
from ballplate.laws import Law

@dataclass(frozen=True, kw_only=True)
class Busy(Law):
    name = "busy"

    def control(self, t, x, reference, q):
        until = time.perf_counter() + 0.0025
        while time.perf_counter() < until:
            pass
        return np.zeros_like(x[..., :2])
"""


@pytest.mark.long
@pytest.mark.usefixtures("unlocked")
def test_a_law_that_computes_for_longer_than_a_period_never_meets_a_rig(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws" / "busy.py").write_text(BUSY)
    brief = partial(ComputingTime.measured, seconds=0.2)
    monkeypatch.setattr(ComputingTime, "measured", brief)
    with pytest.raises(TwinError, match=r"busy computes for 1\.\d\d .* no period can be kept"):
        bp.run("circle", controller="busy", on="emulated")


@pytest.mark.parametrize(
    ("median", "worst", "enough", "never"),
    [(0.4, 0.7, True, False), (0.4, 0.9, False, False), (0.6, 0.7, False, False), (0.9, 1, 0, 1)],
)
def test_a_computer_is_judged_by_what_is_left_of_a_period(median, worst, enough, never):
    time = ComputingTime("pid", 0.002, 0.002 * median, 0.002 * worst)
    assert (time.enough, time.never) == (enough, never)
    assert time.text.startswith(f"pid computes for {median:.2f} of the period of 2 ms")


@pytest.mark.parametrize(
    "keys", [(), ("rig.cam_error_percent=[2.0, 0.0]",), ("rig.cams=per_axis",)]
)
def test_what_a_rig_believes_of_its_cams_needs_no_mechanism(keys, monkeypatch):
    scenario, angle = load("circle", keys), np.array([[0.03, -0.02]])
    wanted = plants.build_plant([scenario])[1].motor(angle)
    monkeypatch.setattr(plants, "build_plant", None)
    assert np.array_equal(plants.assumed_transmission(scenario).motor(angle), wanted)


def killed(program, place, read, whole):
    """What a program leaves that kills itself, once another process has written all of it."""
    done = subprocess.run([sys.executable, "-c", program, place], check=False)
    assert done.returncode == -signal.SIGKILL
    end = time.monotonic() + 60
    found = None
    while time.monotonic() < end and (found is None or not whole(found)):
        time.sleep(0.1)
        with suppress(TwinError):  # nothing yet
            found = read(place)
    return found


KILLED = """
import os, signal, sys
from pathlib import Path
from ballplate.evidence import stream_record
from twin.run.finished import run
from twin.scenario.load import load

def attach(recorder):
    recorder.observers.append(lambda time, _: time < 0.999 or os.kill(os.getpid(), signal.SIGKILL))

short = ("plant.kind=lagrange", "duration=2", "metrics.start=0")
scenario = load("circle", short)
with stream_record(scenario, Path(sys.argv[1]), lambda _: None) as both:
    run(scenario, watch=lambda recorder: (both(recorder), attach(recorder)))
"""


@pytest.mark.long
def test_what_a_killed_run_recorded_is_written_to_the_last_row(tmp_path):
    folder = tmp_path / "runs" / "killed"
    found = killed(KILLED, folder, bp.load, lambda run: len(run.time) >= 501)
    assert found.time[-1] == 1.0
    assert found.outcome == "aborted"
    assert found.scenario.title
    assert len(read(folder).time) == 501


SAYING = """
import os, signal, sys
from pathlib import Path
import can
from ballplate.reporter import Reporter
from ballplate.evidence import write_trace

with write_trace(Path(sys.argv[1]), Reporter(), bounded=True) as hear:
    for number in range(30_000):
        data = number.to_bytes(8, "little")
        hear(can.Message(timestamp=1 + 1e-5 * number, arbitration_id=0x181, data=data))
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.long
def test_the_trace_of_a_killed_run_has_its_last_frame(tmp_path):
    file = tmp_path / "runs" / "killed" / "trace.log"
    found = killed(SAYING, file, read_trace, lambda trace: len(trace.frames) >= 30_000)
    assert [int.from_bytes(each.data, "little") for each in found.frames] == list(range(30_000))


@pytest.mark.long
def test_an_error_on_the_wire_ends_with_where_the_trace_lies(tmp_path):
    file, told = tmp_path / "trace.log", Heard()
    said = can.Message(timestamp=1.0, arbitration_id=0x601, is_extended_id=False, data=bytes(8))
    error = DriveError(NODE_ABSENT, "drive phi (node 1)", "does not answer")

    def fail():
        with write_trace(file, told, bounded=True) as hear:
            hear(said)
            raise error

    with pytest.raises(DriveError) as caught:
        fail()
    assert caught.value is error
    assert str(error) == (
        "drive phi (node 1): does not answer; the frames of the bus: ballplate trace "
        f"{tmp_path}/trace.log"
    )
    assert not told.lines
    assert [bytes(each.data) for each in read_trace(file).frames] == [bytes(8)]


@pytest.mark.short("older1")
@pytest.mark.parametrize("older", [[], ["trace.log"]])
def test_a_bus_that_was_never_opened_leaves_no_trace_and_an_older_one_is_not_its(tmp_path, older):
    for name in older:
        (tmp_path / name).touch()
    with (
        pytest.raises(DriveError, match=r"cannot be opened$"),
        write_trace(tmp_path / "trace.log", Heard(), bounded=True),
    ):
        raise DriveError(NODE_ABSENT, "CAN", "cannot be opened")
    assert [each.name for each in tmp_path.iterdir()] == older


@pytest.mark.short("True")
@pytest.mark.parametrize("fails", [False, True])
def test_a_stream_stays_only_where_the_run_is_not_kept(tmp_path, scenario, fails):
    folder = tmp_path / "run"
    try:
        with stream_record(scenario(), folder, lambda _: None) as attach:
            run(scenario(), watch=attach)
            assert not fails or 1 / 0
    except ZeroDivisionError:
        assert len(bp.load(folder).time) == 200
    assert folder.exists() is fails


@pytest.mark.long
@pytest.mark.usefixtures("unlocked")
def test_a_run_on_a_rig_never_replaces_one(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "ballplate.running.open_rig", lambda _, its, *__, **___: nullcontext((None, its))
    )
    short = {"duration": 0.02, "baseline": False, "plant": {"kind": "lagrange"}}
    for on, names in (("emulated", ["one", "one~2"]), (None, ["one", "one"])):
        made = [bp.run("hold", on=on, out=tmp_path / str(on) / "one", **short) for _ in names]
        assert [each.folder.name for each in made] == names


@pytest.mark.long
@pytest.mark.real_time
def test_a_run_waits_for_a_virtual_rig_that_has_no_processor():
    stopped = []

    def stop():
        for child in multiprocessing.active_children():
            if os.sched_getscheduler(child.pid) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
                os.kill(child.pid, signal.SIGSTOP)
                time.sleep(0.06)
                os.kill(child.pid, signal.SIGCONT)
                stopped.append(child.pid)

    with real_time() as granted:
        if not granted.fifo:
            pytest.skip("no real-time priority here: which process is the rig's cannot be told")
    timers = [threading.Timer(each, stop) for each in np.arange(2.0, 8.0, 0.5)]
    for timer in timers:
        timer.start()
    run = bp.run("circle", ["baseline=false", "duration=6.0", "metrics.start=0"], on="emulated")
    for timer in timers:
        timer.cancel()
    assert stopped
    assert run.outcome == "finished", run.metrics
    assert sum(run.ledger["pauses_us"]) > 40_000 * len(stopped) * 0.5


def test_warnings_of_one_cause_are_one_line_and_stops_stay_single():
    late = Condition("PDO late", Severity.WARNING, 0.1, "", "")
    lost = Condition("heartbeat lost", Severity.STOP, 0.1, "", "")
    events = [
        (0.2, late, "drive phi (node 1): PDO late: TPDO1, 1 of earlier cycles"),
        (0.3, late, "drive theta (node 2): PDO late: TPDO1, 1 of earlier cycles"),
        (4.5, late, "drive phi (node 1): PDO late: TPDO2, 2 of earlier cycles"),
        (5.0, lost, "drive phi (node 1): heartbeat lost: none for 202 ms"),
        (5.1, lost, "drive theta (node 2): heartbeat lost: none for 202 ms"),
        (6.0, late, "rig file: PDO late: first"),
        (6.0004, late, "rig file: PDO late: second"),
    ]
    assert summarize_events(events) == [
        "5.000 s stop: drive phi (node 1): heartbeat lost: none for 202 ms",
        "5.100 s stop: drive theta (node 2): heartbeat lost: none for 202 ms",
        "0.200 to 4.500 s warning: drive phi (node 1): PDO late: 2 reports; first: TPDO1, "
        "1 of earlier cycles",
        "0.300 s warning: drive theta (node 2): PDO late: TPDO1, 1 of earlier cycles",
        "6.000 s warning: rig file: PDO late: 2 reports; first: first",  # no 6.000 to 6.000
    ]
