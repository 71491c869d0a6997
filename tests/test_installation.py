"""`twin.installation`: Other packages of our names are told from ours."""

import subprocess
import sys

import pytest


def python(folder, *arguments):
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )


def hostile(folder):
    """Packages of our names that must not be imported, where Python looks first."""
    for name in ("controllers", "scenarios", "models", "twin"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(f"raise RuntimeError('a stranger: {name}')")


FROM_HERE = """
import ballplate
from twin.base.jobs import results
from twin.base.shipped import find
print(ballplate.run("hold", duration=0.01, plant={"kind": "lagrange"}).outcome)
print(*(path.name for _, path in results(find, [("one", "hold"), ("other", "circle")], 2)))
"""


@pytest.mark.long
def test_packages_of_our_names_in_the_current_folder_are_not_taken(tmp_path):
    hostile(tmp_path)
    done = python(tmp_path, "-c", FROM_HERE)
    first, second = done.stdout.splitlines()
    assert first == "finished", done.stderr
    assert set(second.split()) == {"hold.toml", "circle.toml"}
    stranger = python(tmp_path, "-c", "import controllers")
    assert stranger.stderr.endswith("a stranger: controllers\n")


def test_a_module_called_twin_that_is_there_already_is_one_line_that_names_it(tmp_path):
    (tmp_path / "twin.py").touch()
    done = python(tmp_path, "-c", "import twin, ballplate")
    last = done.stderr.splitlines()[-1]
    named = f"ImportError: a different module called twin was imported before ballplate: {tmp_path}"
    assert last.startswith(named)
