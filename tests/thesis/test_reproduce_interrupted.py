"""Ctrl-C ends the whole command. Apart from the tables, which depend on less than a program."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.long


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_ends_the_command_and_its_processes_with_one_line():
    code = "from twin.cli import main; main()"
    command = [sys.executable, "-c", code, "reproduce", "8.14", "--processes", "2"]
    own = {"stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen(command, **own) as process:
        try:
            assert process.stderr.readline().startswith("reproducing")
            time.sleep(3)
            process.send_signal(signal.SIGINT)
            _, rest = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 1
    assert rest.splitlines()[-1:] == ["ballplate: interrupted"]
    assert "Traceback" not in rest
    assert ended(process.pid)


def ended(group):
    """Whether the process group is gone within 10 s."""
    for _ in range(100):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False
