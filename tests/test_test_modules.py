"""`twin`: each test module names in its first line what it tests, and that exists."""

import re
from importlib.util import find_spec
from pathlib import Path

TESTS = Path(__file__).parent


def test_the_first_line_of_a_test_module_names_a_module_that_exists():
    for file in sorted(TESTS.rglob("test_*.py")):
        with file.open(encoding="utf-8") as lines:
            first = next(lines, "")
        named = re.match(r'"""(?:Tests of )?`([\w.]+)`', first)
        assert named is not None, f"{file.relative_to(TESTS)}: begins with {first!r}"
        assert find_spec(named[1]) is not None, f"{file.relative_to(TESTS)}: {named[1]}"
