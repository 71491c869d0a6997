"""Tests of `twin.base.jobs`."""

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.shared_memory import SharedMemory

import pytest

from twin.base.jobs import SecondProcess, cores, results

ORPHAN = """
import multiprocessing, os, sys, time
from contextlib import ExitStack
from twin.scenario.load import load
from twin.scenario.schema import Scenario

def begun(kind, scenario, stack):
    if kind == "second process":
        from twin.base.jobs import SecondProcess
        stack.enter_context(SecondProcess(wanted=True)).begin(os.getpid)()
    elif kind == "play":
        from twin.play.serve import Simulation
        return Simulation(scenario)
    elif kind == "emulated rig":
        from twin.emulator.serve import serve_rig
        stack.enter_context(serve_rig(scenario))
    else:
        from twin.shadow import report
        from twin.view import live_process, recording
        if kind == "shadow":
            return live_process.LiveProcess(report.work, (scenario, None))
        about = (scenario, "run", "rerun+http://127.0.0.1:1/proxy", None, False)
        return live_process.LiveProcess(recording.work, about)

if __name__ == "__main__":
    with ExitStack() as stack:
        kept = begun(sys.argv[1], load("hold", ("plant.kind=lagrange",)), stack)
        print(*(each.pid for each in multiprocessing.active_children()), flush=True)
        time.sleep(600)
"""


def gone(process):
    """Whether a process ends within the time that a busy machine may need."""
    for _ in range(1200):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


def stay(sign):
    sign.touch()
    time.sleep(600)


def killed_elsewhere(value):
    if os.getpid() != value:
        os.kill(os.getpid(), signal.SIGKILL)
    return value


def test_without_a_second_process_work_is_done_here_and_only_when_it_is_asked_for():
    done = []
    with SecondProcess(wanted=False) as beside:
        result = beside.begin(done.append, 1)
        assert not done
        result()
        assert done == [1]


@pytest.mark.long
def test_work_of_a_second_process_that_is_killed_is_done_here():
    with SecondProcess(wanted=True) as beside:
        first = beside.begin(killed_elsewhere, os.getpid())
        assert first() == os.getpid()
        assert beside.begin(os.getpid)() == os.getpid()


def test_an_error_in_the_second_process_is_raised_here():
    with SecondProcess(wanted=True) as beside, pytest.raises(ZeroDivisionError):
        beside.begin(divmod, 1, 0)()


def test_leaving_ends_the_second_process_whatever_it_is_at(tmp_path):
    with SecondProcess(wanted=True) as beside:
        process = beside.begin(os.getpid)()
        beside.begin(stay, tmp_path / "begun")
        while not (tmp_path / "begun").exists():
            time.sleep(0.01)
    assert gone(process)


def test_leaving_a_second_process_leaves_no_thread_that_python_wakes_at_the_end():
    before = threading.active_count()
    for _ in range(5):
        with SecondProcess(wanted=True) as second:
            second.begin(time.sleep, 30.0)
        assert threading.active_count() == before


def test_a_second_process_leaves_ctrl_c_to_the_first_even_while_it_starts():
    with SecondProcess(wanted=True) as beside:
        before = set(multiprocessing.active_children())
        result = beside.begin(os.getpid)
        (process,) = set(multiprocessing.active_children()) - before
        os.kill(process.pid, signal.SIGINT)
        assert result() == process.pid


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
def test_a_second_process_ends_without_a_word_although_the_first_ends_in_order(capfd):
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)  # as every command does
    try:
        with SecondProcess(wanted=True) as beside:
            process = beside.begin(os.getpid)()
        assert gone(process)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert capfd.readouterr() == ("", "")


@pytest.mark.long
@pytest.mark.parametrize("kind", ["second process", "play", "emulated rig", "shadow", "viewer"])
def test_no_process_outlives_the_one_that_began_it(kind, tmp_path):
    script = tmp_path / "first.py"
    script.write_text(ORPHAN)
    first = subprocess.Popen([sys.executable, script, kind], stdout=subprocess.PIPE, text=True)
    others = [int(number) for number in first.stdout.readline().split()]
    first.kill()
    first.wait()
    assert others
    try:
        assert all(map(gone, others))
    finally:
        for each in others:
            with contextlib.suppress(ProcessLookupError):
                os.kill(each, signal.SIGKILL)
        first.stdout.close()


KILLED = """
import os, signal
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from twin.base.jobs import start_resource_tracker
resource_tracker.ensure_running() if {early} else start_resource_tracker()
memory = SharedMemory(create=True, size=8)
print(memory.name, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes it by itself")
@pytest.mark.parametrize("early", [False, True])
def test_the_shared_memory_of_a_killed_process_is_removed_without_a_word(early):
    ran = subprocess.run(
        [sys.executable, "-c", KILLED.format(early=early)],
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert ran.returncode == -signal.SIGKILL
    assert ("resource_tracker" in ran.stderr) == early  # Python's own way, for comparison
    with pytest.raises(FileNotFoundError):
        SharedMemory(ran.stdout.strip())


def test_results_are_the_same_on_any_number_of_processes():
    jobs = [(number, number) for number in range(7)]
    expected = {number: abs(number) for number in range(7)}
    for processes in (1, 2):
        assert dict(results(abs, jobs, processes)) == expected


@pytest.mark.skipif(sys.platform != "linux", reason="processors are given to processes on Linux")
def test_only_the_processors_given_to_this_process_count():
    given = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(given)})
        assert cores() == 1
    finally:
        os.sched_setaffinity(0, given)
    assert cores() == len(given)


FORKED = """
import os, sys, threading
from twin.base.jobs import SecondProcess
import fractions
with SecondProcess(wanted=True) as beside:
    forked = beside.begin(eval, "'fractions' in __import__('sys').modules")()
threading.Thread(target=threading.Event().wait, daemon=True).start()
with SecondProcess(wanted=True) as beside:
    beside_thread = beside.begin(eval, "'fractions' in __import__('sys').modules")()
print(forked, beside_thread)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux only")
def test_a_process_has_what_is_imported_unless_a_thread_makes_a_fork_unsafe():
    first = subprocess.run(
        [sys.executable, "-c", FORKED], stdout=subprocess.PIPE, text=True, check=True
    )
    assert first.stdout.split() == ["True", "False"]


UNGUARDED = """
from twin.base.jobs import results
print("begins")
print(sorted(dict(results(abs, enumerate([-1, 2]), 2)).values()))
"""


def test_a_script_without_a_guard_runs_once_although_it_starts_processes(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (done.stdout.splitlines(), done.stderr) == (["begins", "[1, 2]"], "")
