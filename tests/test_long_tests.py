"""`twin`.

A part of the long tests runs within a time, and says what it leaves out."""

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
    pytester.makeini("[pytest]\nmarkers =\n  long: long\n  real_time: clock")
    for name, content in PROJECT.items():
        (pytester.path / name).write_text(content)

    def run(*arguments):
        done = pytester.inline_run("-n0", *arguments, plugins=[long_tests])
        passed, skipped, failed = done.listoutcomes()
        return len(passed), len(skipped), len(failed)

    return run


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
