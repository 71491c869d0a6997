"""Tests with deadlines by the clock run after all others, one by one, in the same command.

With several processes, none of them runs a test marked ``real_time``. When all are over and gone,
a second session of the same call runs those tests in one process; it collects only their files.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NONE = pytest.ExitCode.NO_TESTS_COLLECTED
VARIABLE = "BALLPLATE_REAL_TIME_FILES"
ONLY = pytest.StashKey[frozenset[str]]()
"""The files that the second session collects."""
FILES = pytest.StashKey[set[str]]()
"""Files with tests that the processes have left to the second session."""


def pytest_configure(config):
    config.stash[FILES] = set()
    if VARIABLE in os.environ:
        config.stash[ONLY] = frozenset(os.environ.pop(VARIABLE).split(os.pathsep))


def pytest_ignore_collect(collection_path: Path, config):
    """All files without such tests, in the second session."""
    only = config.stash.get(ONLY, None)
    if only is None or collection_path.is_dir():
        return None
    return str(collection_path) not in only or None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """In a process that others run beside: leave the tests by the clock out, and tell where."""
    if hasattr(config, "workerinput"):
        alone = [item for item in items if item.get_closest_marker("real_time")]
        config.hook.pytest_deselected(items=alone)
        items[:] = [item for item in items if item not in alone]
        config.workeroutput["alone"] = sorted({str(item.path) for item in alone})


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Hear from a process which files have tests left."""
    output = getattr(node, "workeroutput", {})
    node.config.stash[FILES].update(output.get("alone", ()))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session, exitstatus):
    """When all other tests are over and their processes gone, they run one by one."""
    yield
    config = session.config
    files = config.stash[FILES]
    if files and exitstatus in {0, 1, NONE}:
        marks = f"({config.option.markexpr or 'real_time'}) and real_time"
        again = (*config.invocation_params.args, "-n", "0", "-m", marks)
        command = (sys.executable, "-m", "pytest", *again)
        known = {**os.environ, VARIABLE: os.pathsep.join(sorted(files))}
        code = subprocess.call(command, cwd=config.invocation_params.dir, env=known)
        session.exitstatus = max({exitstatus, code} - {NONE}, default=NONE)
