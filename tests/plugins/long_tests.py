"""A part of the long tests that fits into some minutes.

``--within`` begins no more of them after some minutes, so that whoever waits knows for how long;
what it leaves out is said. ``--order`` makes it another part every time.
"""

import hashlib
import time
from dataclasses import dataclass, field

import pytest


@dataclass(eq=False)
class LeftOut:
    """Listens where the results of all processes arrive.

    Attributes:
        files: Files to whose tests, or some of them, no time was left.
    """

    files: set[str] = field(default_factory=set)

    def pytest_runtest_logreport(self, report):
        if report.skipped and LATE in str(report.longrepr):
            self.files.add(report.nodeid.partition("::")[0])


LEFT_OUT = pytest.StashKey[LeftOut]()
BEGUN = pytest.StashKey[float]()
LATE = "no time was left for it"


def pytest_addoption(parser):
    group = parser.getgroup("long tests")
    group.addoption("--within", type=float, help="minutes after which no more of them begin")
    group.addoption("--order", help="any word: each has its own order of the files")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Put whole files into the order of a word."""
    yield
    if config.option.order:
        items.sort(key=lambda item: _shuffled(f"{config.option.order} {item.path.name}"))


def _shuffled(word: str) -> str:
    return hashlib.sha256(word.encode()).hexdigest()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Begin no long test when their time is over."""
    most = item.config.option.within
    over = most is not None and time.monotonic() > item.session.stash[BEGUN] + 60 * most
    if over and item.get_closest_marker("long"):
        pytest.skip(LATE)


def pytest_sessionstart(session):
    session.stash[BEGUN] = time.monotonic()
    if not hasattr(session.config, "workerinput"):
        session.config.stash[LEFT_OUT] = LeftOut()
        session.config.pluginmanager.register(session.config.stash[LEFT_OUT])


def pytest_terminal_summary(terminalreporter, config):
    """Say what was left out."""
    if files := config.stash[LEFT_OUT].files:
        terminalreporter.write_line(f"{LATE}, or for some of it: {', '.join(sorted(files))}")
