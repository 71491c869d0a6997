"""Which tests are long, and a part of them that fits into some minutes.

A test marked ``short("circle", "*-mujoco")`` has only the cases of these names, or like these
patterns, among the short tests; all its others are long. Properties that Hypothesis tries are short
tests with a few examples, and long ones with as many as it draws by itself.

``--within`` begins no more of them after some minutes, so that whoever waits knows for how long;
what it leaves out is said. ``--order`` makes it another part every time.
"""

import hashlib
import time
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

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
    """Mark what is long, and put whole files into the order of a word."""
    _mark_long(items, chosen=any("::" in each for each in config.args))
    if config.option.markexpr == "long":
        for item in items:
            if getattr(getattr(item, "function", None), "is_hypothesis_test", False):
                item.add_marker("long")
    yield
    if config.option.order:
        items.sort(key=lambda item: _shuffled(f"{config.option.order} {item.path.name}"))


def _mark_long(items: list[pytest.Item], *, chosen: bool) -> None:
    """Mark the cases that no mark ``short`` names; each pattern must name one, unless chosen."""
    named, stated = set[str](), set[str]()
    for item in items:
        if mark := item.get_closest_marker("short"):
            test, _, case = item.nodeid.removesuffix("]").partition("[")
            found = [each for each in mark.args if fnmatchcase(case, each)]
            if not found:
                item.add_marker("long")
            named.update(f"{test}: {each}" for each in found)
            stated.update(f"{test}: {each}" for each in mark.args)
    if not chosen and named != stated:
        raise pytest.UsageError(f"no case of these marks `short`: {sorted(stated - named)}")


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
