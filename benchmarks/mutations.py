"""Puts deliberate faults into a copy of the tree, one at a time, and sees which test notices.

    uv run python -m benchmarks.mutations            # all of them
    uv run python -m benchmarks.mutations --list
    uv run python -m benchmarks.mutations --only stale_key

Of each fault the tests named in ``faults.py`` are asked first, then the rest of the quick suite,
up to the first that fails. Exit code 1 if more than one fault was not noticed, 2 if one cannot be
made because its text is gone.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.faults import FAULTS, Fault

ROOT = Path(__file__).parent.parent
LEFT_OUT = (".venv", ".git", "__pycache__", ".*_cache", ".hypothesis", "runs", "dist")
MAY_SURVIVE = 1
QUICK = ("-x", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no", "-n", "0")
OWN = "tests/test_mutations.py"
"""Notices by design that a text is gone: it does not count."""


def stale(faults: Sequence[Fault]) -> list[str]:
    """Which faults cannot be made: their text is not there, or more than once."""
    found = []
    for fault in faults:
        count = (ROOT / fault.file).read_text(encoding="utf-8").count(fault.text)
        if count != 1:
            found.append(f"{fault.name}: {fault.file}: '{fault.text}' stands there {count} times")
    return found


@contextmanager
def copied() -> Iterator[Path]:
    """A copy of the tree that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="mutations-") as name:
        folder = Path(name) / "tree"
        shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*LEFT_OUT))
        yield folder


@contextmanager
def made(fault: Fault, tree: Path) -> Iterator[None]:
    """The fault in the copy, taken out again whatever happens."""
    place = tree / fault.file
    before = place.read_text(encoding="utf-8")
    place.write_text(before.replace(fault.text, fault.replacement), encoding="utf-8")
    try:
        yield
    finally:
        shutil.copy2(ROOT / fault.file, place)


def failing(tree: Path, tests: Sequence[str]) -> str:
    """The first test of the copy that fails; empty if none does.

    Raises:
        RuntimeError: If pytest could not carry them out.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((str(tree / "src"), str(tree)))}
    command = (sys.executable, "-m", "pytest", *QUICK, "-rfE", f"--ignore={OWN}", *tests)
    result = subprocess.run(
        command, cwd=tree, env=environment, capture_output=True, text=True, check=False
    )
    if result.returncode == 0:
        return ""
    noticed = re.search(r"^(?:FAILED|ERROR) (\S.*?)(?: - |$)", result.stdout, re.MULTILINE)
    if result.returncode not in (1, 2) or noticed is None:
        raise RuntimeError(f"pytest ended with {result.returncode}:\n{result.stdout[-2000:]}")
    return noticed[1]


def noticed(fault: Fault, tree: Path) -> str:
    """The test that notices a fault; empty if none does.

    Raises:
        RuntimeError: If that test fails without the fault, too.
    """
    with made(fault, tree):
        first = [f"tests/{each}" for each in fault.tests]
        test = failing(tree, first) or failing(tree, ["tests"])
    if test and failing(tree, [test]):
        raise RuntimeError(f"{test} fails without a fault, too")
    return test


def main() -> int:
    """Carry out what is asked; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", metavar="NAME", choices=[each.name for each in FAULTS])
    parser.add_argument("--list", action="store_true", help="only say what the faults are")
    options = parser.parse_args()
    faults = [each for each in FAULTS if options.only in (None, each.name)]
    problems = stale(faults)
    if problems:
        print(*problems, sep="\n", file=sys.stderr)
        return 2
    if options.list:
        for fault in faults:
            print(f"{fault.name:26} {fault.file:38} {fault.meaning}")
        return 0
    survived = []
    with copied() as tree:
        for fault in faults:
            begin = time.monotonic()
            test = noticed(fault, tree)
            survived += [] if test else [fault.name]
            took = f"{time.monotonic() - begin:.0f} s"
            print(f"{fault.name:26} {test or 'NOT NOTICED'} ({took})", flush=True)
    print(f"{len(faults) - len(survived)} of {len(faults)} noticed")
    return int(len(survived) > MAY_SURVIVE)


if __name__ == "__main__":
    sys.exit(main())
