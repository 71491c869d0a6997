"""`twin.cli`: What is finished stays, and what cannot be is told in one line."""

import os
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
from ballplate import comparing
from twin.base.errors import ScenarioError, TwinError
from twin.base.writing import _lock, written_alone
from twin.emulator import serve
from twin.play.serve import Simulation
from twin.run import loop
from twin.run.metrics import INTERRUPTED_REASON
from twin.view.live_process import LiveProcess

pytestmark = pytest.mark.usefixtures("no_pictures")

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
    assert "written to kept~2/" in " ".join(out.split())
    assert bp.load("kept~2").metrics["reason"] == INTERRUPTED_REASON


def test_a_run_that_is_interrupted_replaces_one_that_was(ballplate, monkeypatch):
    interrupted(monkeypatch)
    for _ in range(2):
        ballplate("run", "circle", *SHORT)
    assert not Path("kept~2").exists()


def test_a_comparison_that_is_interrupted_says_so_and_keeps_what_has_run(ballplate, monkeypatch):
    real = comparing.map_scenarios

    def stopped(*given):
        yield next(real(*given))
        raise KeyboardInterrupt

    monkeypatch.setattr(comparing, "map_scenarios", stopped)
    code, out, err = ballplate("compare", "circle", "--vary", "controller.kind=[lqr,afl]", *SHORT)
    assert (code, err.count("interrupted")) == (1, 1)
    assert "lqr" in out
    assert [each.parent.name for each in Path("kept").rglob("run.parquet")] == ["lqr"]


@pytest.mark.parametrize("error", [KeyboardInterrupt("2 kept"), ImportError("initialization")])
def test_ctrl_c_is_one_line_also_where_a_library_makes_another_error_of_it(
    ballplate, monkeypatch, error
):
    def titles(_):
        raise error from KeyboardInterrupt()

    monkeypatch.setattr("ballplate.changes.titles", titles)
    code, out, err = ballplate("list")
    said = ": 2 kept" if isinstance(error, KeyboardInterrupt) else ""
    assert (code, out, err.strip()) == (1, "", f"ballplate: interrupted{said}")


INTERRUPTED_WITHIN = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job would ignore it
class Finder:
    def find_spec(self, name, *_):
        if name == "twin.cli":
            os.kill(os.getpid(), signal.SIGINT)
from twin.__main__ import main
sys.meta_path.insert(0, Finder())
main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows kills without a signal")
def test_ctrl_c_is_one_line_while_the_command_line_is_imported():
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_WITHIN], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (1, "ballplate: interrupted\n")


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


def test_the_lock_lies_beside_its_folder_and_is_gone_afterwards(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.gettempdir", lambda: 1 / 0)  # where anybody may write
    folder = tmp_path / "runs" / "kept"
    with written_alone(folder):
        assert [each.name for each in tmp_path.rglob("*")] == ["runs", ".kept.lock"]
        with pytest.raises(ScenarioError, match="another run is writing there"):
            written_alone(folder).__enter__()
    assert not [*tmp_path.iterdir()]
    with written_alone(tmp_path / ("n" * 240)):
        assert len([*tmp_path.glob(".*.lock")]) == 1


def test_a_lock_is_no_link_that_is_followed(tmp_path):
    (tmp_path / ".kept.lock").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ScenarioError, match="cannot be locked"):
        written_alone(tmp_path / "kept").__enter__()
    assert not (tmp_path / "elsewhere").exists()


def test_a_lock_that_its_holder_removes_meanwhile_is_taken_anew(tmp_path):
    calls = []

    def lock(number, _):
        calls.append(number)
        if len(calls) == 1:  # who held it ends just now
            (tmp_path / ".lock").unlink()

    os.close(_lock(tmp_path / ".lock", 0, lock))
    assert len(calls) == 2
    assert (tmp_path / ".lock").exists()


def test_a_scenario_that_begins_with_a_byte_order_mark_is_read(ballplate):
    text = 'title = "t"\nduration = 0.1\n[plant]\nkind = "lagrange"\n[controller]\nkind = "lqr"\n'
    Path("bom.toml").write_text(f"\ufeff{text}[reference]\nkind = 'hold'\n", encoding="utf-8")
    assert ballplate("run", "bom.toml")[0] == 0


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
    with pytest.raises(AssertionError, match="started process"), serve.serve_rig(scenario()):
        pass
    assert [each for each in begun if each != "tracker"] == [True] * 3
    assert "tracker" in (begun[0], begun[begun.index(True) - 1])
    assert not mask()


def test_an_emulator_whose_host_has_ended_ends_too(monkeypatch):
    rig = nullcontext(SimpleNamespace(tables=dict))  # it would serve next, and cannot
    for name, there in (("VirtualRig", lambda *_: rig), ("come_forward", lambda: None)):
        monkeypatch.setattr(serve, name, there)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    ours, its = Pipe()
    ours.close()
    assert serve._work(its, None, [0.0] * 6) is None


def test_a_warning_of_a_library_is_one_line(ballplate):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.showwarning", warnings.showwarning)
        patch.setattr("warnings.filters", [("always", None, Warning, None, 0)])
        patch.setattr("ballplate.changes.titles", lambda _: warnings.warn("a\nb", stacklevel=1))
        patch.setattr("twin.cli.runs.show_titles", lambda *_, **__: None)
        assert ballplate("list")[2] == "ballplate: warning: a b\n"
