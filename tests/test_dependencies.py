"""`twin`.

A long test that has passed runs again when anything it depends on changes, and only then."""

from functools import cache

import pytest
import verified_long
from dependencies import ROOT, environment, fingerprint

TABLES = ROOT / "tests" / "thesis" / "test_reproduce_long.py"
TRIALS = ROOT / "tests" / "identify" / "test_identify_long.py"
FMU = ROOT / "tests" / "fmu" / "test_interface.py"
STUDIES = ROOT / "tests" / "study" / "test_long.py"


@cache
def today(test):
    return fingerprint(test)


def changed(path):
    """Reads files as they are but one, which has a blank line more."""
    return lambda each: each.read_bytes() + b"\n" * (each == ROOT / path)


@pytest.mark.parametrize(
    ("test", "path"),
    [
        (TABLES, "tests/thesis/test_reproduce_long.py"),
        (TABLES, "tests/conftest.py"),
        (TABLES, "src/twin/thesis/__init__.py"),
        (TABLES, "src/twin/thesis/chapter8.py"),
        (TABLES, "src/twin/thesis/data/full_state.toml"),
        (TABLES, "src/twin/sim/plant/exact.py"),  # through several others
        (TABLES, "controllers/classical.py"),  # by name, through the catalog
        (TABLES, "models/ballplate.xml"),
        (TRIALS, "src/twin/identify/least_squares.py"),
        (TRIALS, "scenarios/excite.toml"),
        (FMU, "tests/fmu/exercise.c"),
        (STUDIES, "src/twin/view/viewer.py"),  # starts the command line, which imports by name
    ],
)
def test_a_changed_dependency_changes_the_hash(test, path):
    assert fingerprint(test, changed(path)) != today(test)


@pytest.mark.parametrize(
    ("test", "path"),
    [(TABLES, "src/twin/view/viewer.py"), (TRIALS, "src/twin/devices/akd/protocol.py")],
)
def test_a_change_in_an_unrelated_room_does_not(test, path):
    assert (ROOT / path).is_file()
    assert fingerprint(test, changed(path)) == today(test)


def test_the_version_of_every_library_is_part_of_it(monkeypatch):
    assert any(line.startswith("mujoco-core==") for line in environment())
    before = fingerprint(TABLES)
    monkeypatch.setattr("dependencies.version", lambda name: f"0 of {name}")
    assert fingerprint(TABLES) != before


PROJECT = {
    "tests/test_one.py": """
import pytest

@pytest.mark.long
@pytest.mark.parametrize("number", range(2))
def test_long(number):
    assert number < {most}

def test_short():
    pass
""",
    "tests/test_clock.py": """
import pytest

@pytest.mark.long
@pytest.mark.real_time
def test_clock():
    pass
""",
}


@pytest.fixture
def session(pytester, monkeypatch):
    """A project with two long tests in one file, and the plugin at work on it."""
    source = {"text": "first"}
    monkeypatch.setattr(verified_long, "ROOT", pytester.path)
    monkeypatch.setattr(verified_long, "VERIFIED", pytester.path / "tests" / "verified.toml")
    monkeypatch.setattr(verified_long, "fingerprint", lambda _: source["text"])
    pytester.makeini("[pytest]\nmarkers =\n  long: long\n  real_time: clock")
    (pytester.path / "tests").mkdir()

    def run(*arguments, most=2, text="first"):
        source["text"] = text
        for name, content in PROJECT.items():
            (pytester.path / name).write_text(content.replace("{most}", str(most)))
        done = pytester.inline_run("-n0", *arguments, plugins=[verified_long])
        passed, skipped, failed = done.listoutcomes()
        left = (len(skipped),) if skipped else ()
        return len(passed), len(failed), *left

    return run


def test_what_has_passed_is_left_out_until_something_changes(session):
    assert session("-m", "long", "--only-changed") == (3, 0)  # nothing recorded yet
    assert session("-m", "long", "--record-verified") == (3, 0)
    assert session("-m", "long", "--only-changed") == (1, 0)  # the clock's always runs
    assert session("-m", "long") == (3, 0)
    assert session("-m", "long", "--only-changed", text="second") == (3, 0)


def test_only_whole_files_that_passed_are_recorded(session):
    assert session("-m", "long", "--record-verified", most=1) == (2, 1)
    assert session("-m", "long", "--only-changed") == (3, 0)
    assert session("-m", "long", "--record-verified", "-k", "0 or clock") == (2, 0)
    assert session("-m", "long", "--only-changed") == (3, 0)


def test_those_to_which_no_time_is_left_are_told_and_not_taken_for_passed(session, capfd):
    assert session("-m", "", "--within", "0", "--record-verified") == (1, 0, 3)  # the short one
    assert "no time was left for it" in capfd.readouterr().out
    assert session("-m", "long", "--only-changed", "--within", "1") == (3, 0)


def test_every_word_has_an_order_of_whole_files(session, capfd):
    orders = set()
    for word in range(6):
        session("-m", "long", "-v", "--order", str(word))
        lines = [line.split() for line in capfd.readouterr().out.splitlines() if "PASSED" in line]
        orders.add("".join("c" if "test_clock" in name else "o" for name, *_ in lines))
    assert orders == {"coo", "ooc"}
