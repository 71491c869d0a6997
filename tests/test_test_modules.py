"""`twin`: each test module names in its first line what it tests, and that exists."""

import ast
import re
from importlib.util import find_spec
from pathlib import Path

import pytest

TESTS = Path(__file__).parent


@pytest.mark.parametrize(
    "file", sorted(TESTS.rglob("test_*.py")), ids=lambda file: str(file.relative_to(TESTS))
)
def test_the_first_line_of_a_test_module_names_a_module_that_exists(file):
    first = (ast.get_docstring(ast.parse(file.read_text("utf-8"))) or "").partition("\n")[0]
    named = re.match(r"(?:Tests of )?`([\w.]+)`", first)
    assert named is not None, f"{file.relative_to(TESTS)}: begins with {first!r}"
    assert find_spec(named[1]) is not None, named[1]
