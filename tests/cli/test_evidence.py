"""`twin.cli`.

What is kept of a run, on a busy computer and where it is killed: whole, or it says so."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path

import can
import pytest

import ballplate as bp
from ballplate import running
from ballplate.evidence import write_trace
from ballplate.reporter import Reporter
from twin.devices.akd.recording import TraceWriter
from twin.devices.akd.traces import parts, read_trace, seal
from twin.emulator.lockstep import LockstepRig
from twin.run.files import STREAM_FILE
from twin.run.opened import open_run
from twin.scenario.load import load
from twin.view.html import html

pytestmark = pytest.mark.usefixtures("no_pictures", "quick_pictures")


class Warned(Reporter):
    """Keeps the warnings."""

    def __init__(self):
        self.warnings = []

    def warn(self, line):
        self.warnings.append(line)


def frame(number):
    return can.Message(
        timestamp=1.0 + 1e-4 * number,
        arbitration_id=0x181,
        is_extended_id=False,
        data=number.to_bytes(8, "little"),
    )


def numbers(file):
    return [int.from_bytes(each.data, "little") for each in read_trace(file).frames]


def signal_writer(number):
    for child in multiprocessing.active_children():
        os.kill(child.pid, number)


@pytest.mark.long
def test_a_trace_waits_for_a_writer_that_a_busy_computer_stopped_for_six_seconds(tmp_path):
    file, told = tmp_path / "trace.log", Warned()
    with write_trace(file, told, bounded=True) as hear:
        signal_writer(signal.SIGSTOP)
        threading.Timer(6.0, signal_writer, (signal.SIGCONT,)).start()
        for number in range(20_000):
            hear(frame(number))
    assert numbers(file) == list(range(20_000))
    assert not told.warnings


def without_end(hear, place):
    """Frames of which the last are not written, as their writer is killed."""
    for number in range(100):
        hear(frame(number))
    # a file that has just been opened holds nothing yet, which is no trace
    while not place.is_file() or place.read_bytes().count(b"#") < 100:
        time.sleep(0.02)
    signal_writer(signal.SIGKILL)
    for number in range(100, 130):
        hear(frame(number))


@pytest.mark.long
def test_a_trace_whose_writer_was_killed_says_so_in_run_report_and_trace(
    tmp_path, monkeypatch, ballplate
):
    @contextmanager
    def simulated(_, chosen, *__, hear, **___):
        yield None, chosen
        without_end(hear, tmp_path / "run" / "trace.log")

    monkeypatch.setattr(running, "open_rig", simulated)
    told, short = Warned(), {"duration": 0.02, "baseline": False, "plant": {"kind": "lagrange"}}
    done = bp.run("hold", on="emulated", out=tmp_path / "run", reporter=told, **short)
    lacks = "30 of 130 frames missing: the process that writes it ended before"
    assert [lacks in line for line in told.warnings] == [True]
    assert lacks in done.summary()["incomplete"][0]
    (again,) = open_run(tmp_path / "run")
    assert again.incomplete == done.incomplete
    assert lacks in html([again])
    assert lacks in " ".join(ballplate("trace", str(tmp_path / "run"))[1].split())


@pytest.mark.parametrize("damage", ["changed", "cut", "gone", "none"])
def test_a_trace_that_was_damaged_since_is_told(tmp_path, damage):
    file = tmp_path / "trace.log"
    with closing(TraceWriter(file, "can0", part=1500)) as writer:
        for first in range(0, 200, 20):
            writer.write(map(frame, range(first, first + 20)))
    seal(file)
    assert len(parts(file)) == 3
    assert not read_trace(file).remarks
    text = file.read_bytes()
    if damage == "changed":
        file.write_bytes(text.replace(b"#05000000", b"#15000000"))
    elif damage == "cut":
        file.write_bytes(text[: len(text) // 2])
    elif damage == "gone":
        (tmp_path / "trace-1.log").unlink()
    remarks = read_trace(file).remarks
    assert bool(remarks) is (damage != "none")
    assert all("damaged" in line for line in remarks)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("trace.sha256", b"", "trace.sha256: is damaged"),
        ("trace.sha256", b"\xff\0garbage\n", "trace.sha256: is damaged"),
        ("trace-1.log", b"(1.0) can0 701#05\n", "trace-1.log: was not there when"),
    ],
)
def test_checksums_that_are_damaged_and_a_part_too_many_are_told(tmp_path, name, content, said):
    with closing(TraceWriter(tmp_path / "trace.log", "can0", part=10**6)) as writer:
        writer.write(map(frame, range(20)))
    seal(tmp_path / "trace.log")
    (tmp_path / name).write_bytes(content)
    assert read_trace(tmp_path / "trace.log").remarks[0].startswith(said)


def test_a_line_of_checksums_that_is_damaged_beside_a_good_one_is_told(tmp_path):
    file = tmp_path / "trace.log"
    with closing(TraceWriter(file, "can0", part=1500)) as writer:
        writer.write(map(frame, range(200)))
    seal(file)
    sums = tmp_path / "trace.sha256"
    first, *others = sums.read_text().splitlines(keepends=True)
    sums.write_text("".join([first, *(f"x{each}" for each in others)]))
    for part in parts(file)[1:]:
        part.unlink()
    assert read_trace(file).remarks[0].startswith("trace.sha256: is damaged")


def test_report_says_that_a_trace_was_damaged_since(tmp_path, ballplate):
    settings = {"duration": 0.02, "baseline": False, "plant": {"kind": "lagrange"}}
    bp.run("hold", out=tmp_path / "run", **settings)
    with closing(TraceWriter(tmp_path / "run" / "trace.log", "can0", part=10**6)) as writer:
        writer.write(map(frame, range(20)))
    seal(tmp_path / "run" / "trace.log")
    (tmp_path / "run" / "trace.log").unlink()
    assert ballplate("report", str(tmp_path / "run"))[0] == 0
    page = (tmp_path / "run" / "report.html").read_text()
    assert "Not whole: trace.log: is missing, or damaged" in page


class Rig(LockstepRig):
    """A rig in virtual time whose host asked for no real time."""

    scheduling = ()


FALLS = ("plant.start.x_rate=0.7", "duration=20", "plant.kind=lagrange")


@contextmanager
def in_lockstep(*_, **__):
    """In the place of a rig that is connected: an emulated one in virtual time."""
    chosen = load("hold", FALLS)
    yield Rig(chosen), chosen


AFTER = {
    "the clean model": "ballplate.running._begin_clean_run",
    "the timing": "ballplate.running.tell_timing",
    "the picture": "twin.run.finished.draw_runs",
}
KILLED = """
import os, signal, sys
import pytest
import ballplate as bp
sys.path.insert(0, sys.argv[1])
import test_evidence
kill = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
chosen = (lambda *_: kill) if sys.argv[3].endswith("_begin_clean_run") else kill
pytest.MonkeyPatch().setattr(sys.argv[3], chosen)
pytest.MonkeyPatch().setattr("ballplate.running.open_rig", test_evidence.in_lockstep)
bp.run("hold", {"baseline": True}, on="emulated", out=sys.argv[2])
"""


def check_end(folder):
    """A run folder without a picture tells how its run ended."""
    (run,) = open_run(folder)
    assert (run.outcome, run.metrics["reason"]) == ("lost", "the ball is no longer detected")
    assert run.ledger["ticks"] > 10
    names = {each.name for each in folder.iterdir()}
    # a kill may come before the stream is taken away: beside a whole record it is not read
    assert names - {"trace.log", "trace.sha256", STREAM_FILE} == {"run.parquet", "metrics.json"}


@pytest.mark.long
@pytest.mark.parametrize("place", AFTER)
def test_a_rigs_run_that_is_killed_after_its_end_has_that_end(tmp_path, place):
    program = [sys.executable, "-c", KILLED, Path(__file__).parent, tmp_path / "run", AFTER[place]]
    done = subprocess.run(program, check=False)
    assert done.returncode == -signal.SIGKILL
    check_end(tmp_path / "run")


def test_a_rigs_run_is_kept_with_its_end_before_its_clean_model_begins(tmp_path, monkeypatch):
    monkeypatch.setattr(running, "open_rig", in_lockstep)
    monkeypatch.setattr(running, "stream_record", lambda *_: nullcontext(lambda _: None))
    monkeypatch.setattr(running, "write_trace", lambda *_, **__: nullcontext(lambda _: None))
    monkeypatch.setattr(running, "_begin_clean_run", lambda *_: lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        bp.run("hold", {"baseline": True}, on="emulated", out=tmp_path / "run")
    check_end(tmp_path / "run")


def test_the_clean_model_runs_only_for_as_long_as_the_run_did(monkeypatch):
    seen, one_run = [], running.one_run

    def look(scenario, label, *more, **options):
        done = one_run(scenario, label, *more, **options)
        seen.append((label, done.end))
        return done

    monkeypatch.setattr(running, "one_run", look)
    monkeypatch.setattr("twin.base.jobs.cores", lambda: 1)
    done = bp.run("hold", [*FALLS[:2], "baseline=true"])
    assert done.outcome == "fell"
    (_, measured), (label, clean) = seen
    assert (label, clean) == (running.CLEAN_LABEL, pytest.approx(measured))
    assert measured < 5.0


def test_a_record_that_is_replaced_keeps_no_picture_or_numbers_of_the_run_before(
    tmp_path, monkeypatch
):
    short = {"duration": 0.02, "baseline": False, "plant": {"kind": "lagrange"}}
    bp.run("hold", out=tmp_path / "run", **short)
    assert (tmp_path / "run" / "picture.png").exists()
    monkeypatch.setattr("twin.run.finished.write_json", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        bp.run("hold", out=tmp_path / "run", **short)
    assert [each.name for each in Path(tmp_path / "run").iterdir()] == ["run.parquet"]
