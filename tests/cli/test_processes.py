"""`twin.cli`: Commands on one processor and on several, ended early and left to end."""

import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import sleep

import pytest

from twin.base import jobs

QUICK = ("--plant", "lagrange", "--set", "duration=0.2", "--set", "metrics.start=0")


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.skipif(sys.platform == "win32", reason="Windows kills without a signal")
def test_ctrl_c_a_kill_and_a_closed_terminal_end_a_run_in_order(tmp_path):
    def ended_by(number):
        place = tmp_path / number.name
        code = "from ballplate import reporter; reporter.LINE_EVERY = 0.2\n"
        code += "from twin.cli import main; main()"
        arguments = ["run", "hold", *QUICK[:2], "--set", "duration=3600", "--out", str(place)]
        with subprocess.Popen(
            [sys.executable, "-c", code, *arguments], stderr=subprocess.PIPE, text=True
        ) as process:
            next(line for line in process.stderr if "%" in line)  # the run goes on
            process.send_signal(number)
            error = process.communicate(timeout=60)[1]
        outcome = json.loads((place / "metrics.json").read_text())
        return process.returncode, error.count("Traceback"), outcome["outcome"]

    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with ThreadPoolExecutor() as pool:
        assert list(pool.map(ended_by, signals)) == [(1, 0, "aborted")] * 3


LONG = ("--set", "duration=6", "--set", "metrics.start=2")


def run_command(ballplate, monkeypatch, processors, out, *arguments):
    """What a command with so many processors writes, but for the speed; and what it says."""
    monkeypatch.setattr(jobs, "cores", lambda: processors)
    code, _, err = ballplate(*arguments, "--out", out)
    assert code == 0
    files = {file.relative_to(out): file.read_bytes() for file in Path(out).rglob("*.p*")}
    for file in Path(out).rglob("metrics.json"):
        content = json.loads(file.read_text())
        del content["real_time_factor"]
        files[file.relative_to(out)] = content
    return files, [line for line in err.splitlines() if line.endswith("...")]


@pytest.mark.long
def test_a_run_writes_the_same_bytes_on_one_processor_and_on_two(ballplate, monkeypatch):
    begun = []
    begin = jobs.SecondProcess.begin

    def noted(self, *job):
        begun.append(self.there)
        return begin(self, *job)

    monkeypatch.setattr(jobs.SecondProcess, "begin", noted)
    command = ("run", "circle", *LONG)
    one = run_command(ballplate, monkeypatch, 1, "one", *command)
    assert not any(begun)
    two = run_command(ballplate, monkeypatch, 2, "two", *command)
    assert begun[-1]
    assert one == two
    assert {str(path) for path in one[0]} == {"run.parquet", "picture.png", "metrics.json"}
    assert one[1] == ["honest twin ...", "clean model ..."]


@pytest.mark.long
def test_a_comparison_writes_the_same_bytes_on_one_process_and_on_two(ballplate, monkeypatch):
    command = ("compare", "circle", "--vary", "seed=[1,2]", "--vary")
    command += ("plant.friction.rolling_mm=[0,0.2]", "--set", "duration=0.5")
    command += ("--set", "metrics.start=0")
    one = run_command(ballplate, monkeypatch, 1, "one", *command, "-j", "1")[0]
    two = run_command(ballplate, monkeypatch, 1, "two", *command, "-j", "2")[0]
    assert one == two
    assert len(one) == 4 * 3 + 1


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no process groups")
def test_ctrl_c_ends_a_comparison_on_two_processes_and_keeps_what_is_done(tmp_path):
    code = "from ballplate import reporter; reporter.LINE_EVERY = 0.0; from twin.cli import main\n"
    code += "if __name__ == '__main__': main()"
    arguments = ["compare", "hold", *QUICK[:2], "--vary", "duration=[1,3600]", "-j", "2"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments, "--out", str(tmp_path)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        kept = tmp_path / "duration=1" / "picture.png"
        while not kept.exists():
            assert process.poll() is None
            sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        error = process.communicate(timeout=60)[1]
    assert process.returncode == 1
    assert "Traceback" not in error
    assert (tmp_path / "compare.png").is_file()
    assert not (tmp_path / "duration=3600").exists()
    assert not list(tmp_path.rglob(".*"))
