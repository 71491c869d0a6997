"""Long tests that need not run again, because nothing they depend on has changed since they passed.

``tests/verified.toml`` holds, for each file of long tests, the hash of what it depended on
(``dependencies.py``) when all its long tests passed. ``--only-changed`` leaves out the files whose
hash is still the same and says so; ``--record-verified`` writes the hashes of files whose long
tests have all just passed. Tests by the clock depend on the machine and always run.

``--within`` ends that after some minutes, so that whoever waits for it knows for how long; what it
leaves out is said, and ``--order`` makes it another part every time.
"""

import hashlib
import time
import tomllib
from collections import Counter
from dataclasses import dataclass, field

import pytest
from dependencies import ROOT, fingerprint

VERIFIED = ROOT / "tests" / "verified.toml"
HEAD = """\
# What each file of long tests depended on when all of them had passed. Written by
# uv run pytest -m long --record-verified
"""


@dataclass
class LongTests:
    """What a session knows of the long tests.

    Attributes:
        whole: All of each file, chosen or not.
        unchanged: How many were left out of each file.
        before: Hash of each file as the session began.
        late: Files to whose tests, or some of them, no time was left.
        passed: Those whose call has passed.
        spoilt: Those of which any part has not.
    """

    whole: dict[str, list[str]] = field(default_factory=dict)
    unchanged: dict[str, int] = field(default_factory=dict)
    before: dict[str, str] = field(default_factory=dict)
    late: set[str] = field(default_factory=set)
    passed: set[str] = field(default_factory=set)
    spoilt: set[str] = field(default_factory=set)


KNOWN = pytest.StashKey[LongTests]()
BEGUN = pytest.StashKey[float]()
LATE = "no time was left for it"


def pytest_addoption(parser):
    group = parser.getgroup("long tests")
    group.addoption(
        "--only-changed",
        action="store_true",
        help="leave out long tests that have passed with all they depend on as it is",
    )
    group.addoption(
        "--record-verified",
        action="store_true",
        help="write down what the long tests that pass depend on",
    )
    group.addoption("--within", type=float, help="minutes after which no more of them begin")
    group.addoption("--order", help="any word: each has its own order of the files")


def read_verified() -> dict[str, str]:
    """Hash by file, as last written."""
    return tomllib.loads(VERIFIED.read_text("utf-8")) if VERIFIED.is_file() else {}


def candidates() -> list[str]:
    """Files that may have long tests, below the project's folder."""
    return [
        path.relative_to(ROOT).as_posix()
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
        if "mark.long" in path.read_text("utf-8")
    ]


def file_of(item) -> str:
    """The file of a test, below the project's folder."""
    return item.path.relative_to(ROOT).as_posix()


def pytest_configure(config):
    config.stash[KNOWN] = LongTests()
    if config.option.record_verified:
        chosen = [each for each in config.invocation_params.args if "::" in str(each)]
        some = (getattr(config.option, name, False) for name in ("lf", "failedfirst"))
        if chosen or any(some):
            raise pytest.UsageError("--record-verified needs whole files of tests")
        if not hasattr(config, "workerinput"):
            config.stash[KNOWN].before = {file: fingerprint(ROOT / file) for file in candidates()}


def is_long(item):
    """Whether a test is long and its result no matter of the machine's speed."""
    return item.get_closest_marker("long") and not item.get_closest_marker("real_time")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Count the long tests, then leave out those of files that have not changed."""
    known = config.stash[KNOWN]
    for item in filter(is_long, items):
        known.whole.setdefault(file_of(item), []).append(item.nodeid)
    yield
    if config.option.only_changed:
        verified = read_verified()
        same = {file for file in known.whole if verified.get(file) == fingerprint(ROOT / file)}
        out = [item for item in items if is_long(item) and file_of(item) in same]
        known.unchanged = dict(Counter(map(file_of, out)))
        config.hook.pytest_deselected(items=out)
        items[:] = [item for item in items if item not in out]
    if config.option.order:
        items.sort(key=lambda item: _shuffled(f"{config.option.order} {item.path.name}"))
    if hasattr(config, "workerinput"):
        config.workeroutput["long"] = (known.whole, known.unchanged)


def _shuffled(word: str) -> str:
    return hashlib.sha256(word.encode()).hexdigest()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Begin no long test when their time is over."""
    most = item.config.option.within
    over = most is not None and time.monotonic() > item.session.stash[BEGUN] + 60 * most
    if over and item.get_closest_marker("long"):
        pytest.skip(LATE)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """Take over what a process has counted; every one has collected the same."""
    known, output = node.config.stash[KNOWN], getattr(node, "workeroutput", {})
    known.whole, known.unchanged = output.get("long", (known.whole, known.unchanged))


class Outcomes:
    """Listens where the results of all processes arrive."""

    def __init__(self, known):
        self.known = known

    def pytest_runtest_logreport(self, report):
        """Count a test as passed only if no part of it was anything else."""
        if not report.passed:
            self.known.spoilt.add(report.nodeid)
        if report.skipped and LATE in str(report.longrepr):
            self.known.late.add(report.nodeid.partition("::")[0])
        if report.passed and report.when == "call":
            self.known.passed.add(report.nodeid)


def pytest_sessionstart(session):
    session.stash[BEGUN] = time.monotonic()
    if not hasattr(session.config, "workerinput"):
        session.config.pluginmanager.register(Outcomes(session.config.stash[KNOWN]))


def pytest_terminal_summary(terminalreporter, config):
    """Say what was left out, and write down what passed."""
    known = config.stash[KNOWN]
    for file, count in known.unchanged.items():
        terminalreporter.write_line(
            f"{file}: {count} long tests not run: nothing they depend on has changed since they "
            "passed"
        )
    if known.late:
        terminalreporter.write_line(f"{LATE}, or for some of it: {', '.join(sorted(known.late))}")
    if config.option.record_verified:
        good = known.passed - known.spoilt
        passed = {file for file, tests in known.whole.items() if good.issuperset(tests)}
        for file in record(passed, known.before):
            terminalreporter.write_line(f"{file}: recorded as passed")


def record(passed, before) -> list[str]:
    """Write the hashes of files that passed and did not change meanwhile; forget absent files."""
    fresh = {
        file: before[file]
        for file in sorted(passed & before.keys())
        if before[file] == fingerprint(ROOT / file)
    }
    kept = {file: old for file, old in read_verified().items() if (ROOT / file).is_file()}
    lines = [f'"{file}" = "{value}"\n' for file, value in sorted((kept | fresh).items())]
    VERIFIED.write_text(HEAD + "".join(lines), encoding="utf-8")
    return list(fresh)
