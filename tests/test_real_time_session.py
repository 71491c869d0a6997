"""`twin`: The tests with deadlines by the clock have the machine for themselves."""

import subprocess
import sys
from pathlib import Path

import pytest

PLUGINS = Path(__file__).parent / "plugins"
WITHOUT = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest")
TESTS = """
import os, time
from pathlib import Path
import pytest

def spend(name, code=0):
    begin = time.monotonic()
    time.sleep(0.2)
    with (Path(__file__).parent / "log").open("a") as log:
        log.write(f"{name} {os.getpid()} {begin} {time.monotonic()}\\n")
    assert not code

@pytest.mark.parametrize("number", range(3))
def test_any(number):
    spend("any")

@pytest.mark.real_time
@pytest.mark.parametrize("number", range(2))
def test_alone(number):
    spend("alone", ALONE)

@pytest.mark.long
@pytest.mark.real_time
def test_long():
    spend("long")

def test_last():
    spend("any", ANY)
"""


@pytest.fixture
def call(tmp_path):
    """Runs a folder of tests with the plugin: exit code, and what ran in which process when."""
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["real_time_session"]')
    markers = "markers =\n  long: long\n  real_time: alone"
    settings = f"addopts = -m 'not long'\npythonpath = {PLUGINS}\n{markers}"
    (tmp_path / "pytest.ini").write_text(f"[pytest]\n{settings}")

    def run(*arguments, failing=(), files=2):
        for number in range(files):
            text = TESTS.replace("ANY", str("any" in failing))
            text = text.replace("ALONE", str("alone" in failing))
            (tmp_path / f"test_{number}.py").write_text(text)
        command = [sys.executable, "-m", "pytest", *WITHOUT, "-q", *arguments]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        ran = [line.split() for line in (tmp_path / "log").read_text().splitlines()]
        (tmp_path / "log").unlink()
        found = [(name, pid, float(begin), float(end)) for name, pid, begin, end in ran]
        return done.returncode, found, done.stdout + done.stderr

    return run


@pytest.mark.long
def test_tests_by_the_clock_run_once_each_alone_after_all_others(call, tmp_path):
    (tmp_path / "test_ordinary.py").write_text(
        "open('imported', 'a').write('.')\ndef test_ordinary(): pass"
    )
    code, ran, out = call("-n", "2", "--dist", "worksteal")
    assert code == 0, out
    assert sorted(name for name, *_ in ran) == ["alone"] * 4 + ["any"] * 8
    others = [each for each in ran if each[0] == "any"]
    alone = [each for each in ran if each[0] == "alone"]
    assert len({pid for _, pid, *_ in others}) == 2
    assert len({pid for _, pid, *_ in alone}) == 1
    assert min(begin for *_, begin, _ in alone) > max(end for *_, end in others)
    imported = (tmp_path / "imported").read_text()
    assert imported == "..", "a file without such tests is collected once by each process"


@pytest.mark.long
@pytest.mark.parametrize("failing", ["any", "alone"])
def test_a_failure_on_either_side_fails_the_command(call, failing):
    code, ran, _ = call("-n", "2", failing=[failing], files=1)
    assert code == 1
    assert len(ran) == 6


@pytest.mark.long
def test_without_tests_by_the_clock_there_is_no_second_session(call):
    code, ran, out = call("-n", "2", "-k", "any", files=1)
    assert code == 0, out
    assert "alone" not in [name for name, *_ in ran]
    assert out.count("passed") == 1


def test_this_suite_is_run_so(pytestconfig):
    assert pytestconfig.pluginmanager.hasplugin("real_time_session")


@pytest.mark.long
def test_in_one_process_and_by_a_mark_the_same_tests_run(call):
    code, ran, out = call("-n", "0", files=1)
    assert code == 0, out
    assert [name for name, *_ in ran] == ["any"] * 3 + ["alone"] * 2 + ["any"]
    code, ran, out = call("-n", "2", "-m", "long", files=1)
    assert code == 0, out
    assert [name for name, *_ in ran] == ["long"]
