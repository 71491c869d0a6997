"""`twin`.

What is long, and that a part of it runs within a time and says what it leaves out."""

import long_tests
import pytest

PROJECT = {
    "test_one.py": """
import pytest

@pytest.mark.long
@pytest.mark.parametrize("number", range(2))
def test_long(number):
    pass

def test_short():
    pass
""",
    "test_clock.py": """
import pytest

@pytest.mark.long
@pytest.mark.real_time
def test_clock():
    pass
""",
}


@pytest.fixture
def session(pytester):
    """A project with two long tests in one file, and the plugin at work on it."""
    pytester.makeini("[pytest]\nmarkers =\n  long: long\n  short: some\n  real_time: clock")
    for name, content in PROJECT.items():
        (pytester.path / name).write_text(content)

    def run(*arguments):
        done = pytester.inline_run("-n0", *arguments, plugins=[long_tests])
        passed, skipped, failed = done.listoutcomes()
        return len(passed), len(skipped), len(failed)

    return run


CASES = """
import pytest

@pytest.mark.short("circle", "sine-[12]")
@pytest.mark.parametrize("name", ["circle", "sine-1", "sine-3", "hold"])
def test_law(name):
    pass
"""


def test_of_a_test_marked_short_the_other_cases_are_long(session, pytester, capfd):
    (pytester.path / "test_law.py").write_text(CASES)
    assert session("test_law.py", "-m", "not long") == (2, 0, 0)
    assert session("test_law.py", "-m", "long", "-v") == (2, 0, 0)
    long = [line for line in capfd.readouterr().out.splitlines() if "PASSED" in line]
    assert ["[sine-3]" in line or "[hold]" in line for line in long[-2:]] == [True, True]
    assert session("test_law.py::test_law[hold]") == (1, 0, 0)


def test_a_mark_short_of_a_case_that_does_not_exist_is_an_error(session, pytester, capfd):
    (pytester.path / "test_law.py").write_text(CASES.replace('short("circle"', 'short("cycle"'))
    assert session("test_law.py") == (0, 0, 0)
    assert "no case of these marks `short`: ['test_law.py::test_law: cycle']" in str(
        capfd.readouterr()
    )


PROPERTY = """
from hypothesis import given, strategies

@given(strategies.booleans())
def test_property(value):
    pass
"""


def test_a_property_is_a_short_and_a_long_test(session, pytester):
    (pytester.path / "test_law.py").write_text(PROPERTY)
    assert session("test_law.py", "-m", "not long") == (1, 0, 0)
    assert session("test_law.py", "-m", "long") == (1, 0, 0)


def test_those_to_which_no_time_is_left_are_told_and_not_taken_for_passed(session, capfd):
    assert session("--within", "0") == (1, 3, 0)  # the short one
    assert "no time was left for it, or for some of it: test_clock.py" in capfd.readouterr().out
    assert session("-m", "long", "--within", "1") == (3, 0, 0)
    assert "no time was left" not in capfd.readouterr().out


def test_every_word_has_an_order_of_whole_files(session, capfd):
    orders = set()
    for word in range(6):
        session("-m", "long", "-v", "--order", str(word))
        lines = [line.split() for line in capfd.readouterr().out.splitlines() if "PASSED" in line]
        orders.add("".join("c" if "test_clock" in name else "o" for name, *_ in lines))
    assert orders == {"coo", "ooc"}
