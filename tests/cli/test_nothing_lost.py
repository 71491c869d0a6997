"""What is finished stays, and what cannot be is told in one line."""

import json
import signal
import subprocess
import sys
import warnings
from contextlib import nullcontext
from multiprocessing import Pipe
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import SimpleNamespace

import pytest

import ballplate as bp
from twin.emulator import process
from twin.errors import ScenarioError, TwinError
from twin.play.process import Simulation
from twin.run import loop
from twin.run.loop import INTERRUPTED
from twin.view.live_process import LiveProcess
from twin.writing import written_alone

SHORT = ("--set", "duration=0.2", "--set", "plant.kind=lagrange", "--out", "kept")


def interrupted(monkeypatch):
    """Let every run be interrupted in its middle, as by Ctrl-C."""
    watch = loop.RunMonitor.watch

    def stop(self, measurement):
        if measurement.time > 0.1:
            raise KeyboardInterrupt
        return watch(self, measurement)

    monkeypatch.setattr(loop.RunMonitor, "watch", stop)


def test_a_run_that_is_interrupted_does_not_replace_one_that_is_finished(ballplate, monkeypatch):
    assert ballplate("run", "circle", *SHORT)[0] == 0
    before = Path("kept/run.parquet").read_bytes()
    interrupted(monkeypatch)
    code, out, _ = ballplate("run", "circle", *SHORT)
    assert code == 1
    assert Path("kept/run.parquet").read_bytes() == before
    assert "kept/ keeps its finished run" in " ".join(out.split())
    assert bp.load("kept~2").metrics["reason"] == INTERRUPTED


def test_a_run_that_is_interrupted_replaces_one_that_was(ballplate, monkeypatch):
    interrupted(monkeypatch)
    for _ in range(2):
        ballplate("run", "circle", *SHORT)
    assert not Path("kept~2").exists()


def test_a_second_run_into_a_folder_is_told(ballplate, tmp_path):
    with written_alone(tmp_path / "kept"):
        code, _, err = ballplate("run", "circle", *SHORT)
    assert (code, err.count("\n")) == (2, 1)
    assert "--out kept: another run is writing there" in err
    assert ballplate("run", "circle", *SHORT)[0] == 0


def test_the_lock_of_a_folder_goes_with_what_held_it(tmp_path):
    with pytest.raises(ZeroDivisionError), written_alone(tmp_path):
        raise ZeroDivisionError
    with written_alone(tmp_path), pytest.raises(ScenarioError), written_alone(tmp_path):
        pass


LOG = "time [s],measured_x [m],measured_phi [rad],measured_y [m],measured_theta [rad]\n"


def test_logs_with_one_name_are_all_compared(ballplate):
    for folder in ("a", "b"):
        Path(folder).mkdir()
        rows = "".join(f"{0.002 * k:.3f},0.15,0,0,0\n" for k in range(200))
        Path(folder, "log.csv").write_text(LOG + rows)
    code, out, _ = ballplate(
        "compare", "a/log.csv", "b/log.csv", "circle", "--plant", "lagrange", "--json"
    )
    assert code == 0
    assert {"log", "log~2"} <= set(json.loads(out))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("compare", "circle", "--vary", "controller.kind=[]"), "needs at least one value"),
        (("run", "circle", "--set", "duration=1", "--set", "duration=2"), "given 2 times"),
        (("run", "circle", "--out", ""), "--out: names no folder"),
        (("run", "circle", "--out="), "--out: names no folder"),
    ],
)
def test_what_cannot_be_meant_is_one_line(ballplate, arguments, words):
    code, _, err = ballplate(*arguments)
    assert (code, err.count("\n")) == (2, 1)
    assert words in err
    assert not list(Path().iterdir())


def test_a_scenario_that_begins_with_a_byte_order_mark_is_read(ballplate):
    text = 'title = "t"\nduration = 0.1\n[plant]\nkind = "lagrange"\n[controller]\nkind = "lqr"\n'
    Path("bom.toml").write_text(f"\ufeff{text}[reference]\nkind = 'hold'\n", encoding="utf-8")
    assert ballplate("run", "bom.toml")[0] == 0


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (LOG.replace(",", ";"), "columns are separated by ';'"),
        (LOG.replace("measured_y [m]", "measured_x [mm]"), "measured_x: two columns"),
    ],
)
def test_a_log_that_is_written_otherwise_is_told_why(ballplate, header, words):
    Path("log.csv").write_text(header + "0;0,1;0;0;0\n")
    code, _, err = ballplate("identify", "log.csv")
    assert (code, err.count("\n")) == (2, 1)
    assert words in err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_or_closed_standard_output_is_no_traceback(tmp_path):
    program = [str(Path(sys.executable).with_name("ballplate")), "list"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "standard output cannot be written" in done.stderr
    closed = subprocess.run(
        ["/bin/sh", "-c", f"{' '.join(program)} >&-"], capture_output=True, text=True, check=False
    )
    assert (closed.returncode, closed.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no masks of signals")
def test_a_process_is_left_alone_by_ctrl_c_before_it_runs_a_line(monkeypatch, scenario):
    begun = []

    def mask():
        return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())

    # what keeps count of shared memory unblocks Ctrl-C when it is started with the first process
    tracker = "multiprocessing.resource_tracker.ensure_running"
    monkeypatch.setattr(tracker, lambda: begun.append("tracker"))
    monkeypatch.setattr(SpawnProcess, "start", lambda _: begun.append(mask()))
    LiveProcess(print, ()).close()
    with pytest.raises(TwinError):
        Simulation(scenario())
    with pytest.raises(AssertionError, match="started process"), process.emulated(scenario()):
        pass
    assert [each for each in begun if each != "tracker"] == [True] * 3
    assert "tracker" in (begun[0], begun[begun.index(True) - 1])
    assert not mask()


def test_an_emulator_whose_host_has_ended_ends_too(monkeypatch):
    rig = nullcontext(SimpleNamespace(tables=dict))  # it would serve next, and cannot
    for name, there in (("VirtualRig", lambda *_: rig), ("come_forward", lambda: None)):
        monkeypatch.setattr(process, name, there)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    ours, its = Pipe()
    ours.close()
    assert process._work(its, None, None) is None


def test_a_warning_of_a_library_is_one_line(ballplate):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.showwarning", warnings.showwarning)
        patch.setattr("warnings.filters", [("always", None, Warning, None, 0)])
        patch.setattr("ballplate.catalogue.titles", lambda _: warnings.warn("a\nb", stacklevel=1))
        patch.setattr("twin.cli.scenarios.print_titles", lambda *_, **__: None)
        assert ballplate("list")[2] == "ballplate: warning: a b\n"


def test_the_old_option_resume_is_taken_and_begins_anew(ballplate):
    assert ballplate("run", "circle", *SHORT)[0] == 0
    before = bp.load("kept")["true_x"]
    code, _, err = ballplate("run", "circle", *SHORT, "--resume")
    assert (code, err.count("--resume: runs are exact again")) == (0, 1)
    assert (bp.load("kept")["true_x"] == before).all()
