"""Other packages called controllers or scenarios are told from ours."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import twin
from twin.installation import problem

ASK = "from twin.installation import problem; print(problem())"


def python(folder, *arguments):
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False
    )


def installed(folder, *empty):
    """Our packages' folders as in site-packages, and further empty files."""
    (folder / "twin").mkdir()
    (folder / "twin" / "__init__.py").touch()
    shutil.copy(Path(twin.__file__).parent / "installation.py", folder / "twin")
    for name in empty:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).touch()


def test_this_installation_is_whole():
    assert problem() is None


def hostile(folder):
    """Packages of our names that must not be imported, where Python looks first."""
    for name in ("controllers", "scenarios", "models", "twin"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(f"raise RuntimeError('a stranger: {name}')")


FROM_HERE = """
import ballplate
from twin.jobs import results
from twin.shipped import find
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
    named = f"ImportError: another module called twin was imported before ballplate: {tmp_path}"
    assert last.startswith(named)


def test_another_package_called_controllers_is_one_line_that_names_it(tmp_path):
    other = tmp_path / "controllers"
    other.mkdir()
    (other / "__init__.py").touch()
    command = "import controllers; from twin.cli import main; main()"
    done = python(tmp_path, "-c", command, "run", "circle")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ballplate: another package called controllers shadows ours: {other};")


INSIDE, DATA, PACKAGE = "controllers/__init__.py", "scenarios/circle.toml", "scenarios/__init__.py"


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ((INSIDE, DATA), "None"),
        ((INSIDE, PACKAGE), "another package called scenarios lies over ours: {}"),
        ((INSIDE,), "scenarios is missing"),
        ((DATA,), "controllers is missing"),
    ],
)
def test_an_installation_in_one_folder_is_whole_or_what_is_wrong_is_told(tmp_path, files, says):
    installed(tmp_path, *files)
    assert says.format(tmp_path) in python(tmp_path, "-S", "-c", ASK).stdout


def test_looking_costs_no_import():
    code = "import sys, twin.installation as i; i.problem(); print('controllers' in sys.modules)"
    assert python(".", "-c", code).stdout == "False\n"
