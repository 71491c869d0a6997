"""Other packages called controllers or scenarios are told from ours."""

import shutil
import subprocess
import sys
from pathlib import Path

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


def test_another_package_called_controllers_is_one_line_that_names_it(tmp_path):
    other = tmp_path / "controllers"
    other.mkdir()
    (other / "__init__.py").touch()
    done = python(tmp_path, "-c", "from twin.cli import main; main()", "run", "circle")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ballplate: another package called controllers shadows ours: {other};")


def test_an_installation_in_one_folder_is_whole_too(tmp_path):
    installed(tmp_path, "controllers/__init__.py", "scenarios/circle.toml")
    assert python(tmp_path, "-c", ASK).stdout == "None\n"


def test_another_package_called_scenarios_is_told(tmp_path):
    installed(tmp_path, "controllers/__init__.py", "scenarios/__init__.py")
    said = python(tmp_path, "-c", ASK).stdout
    assert said.startswith(f"another package called scenarios lies over ours: {tmp_path}")


def test_missing_scenarios_are_told(tmp_path):
    installed(tmp_path, "controllers/__init__.py")
    assert f"{tmp_path / 'scenarios'} is missing" in python(tmp_path, "-c", ASK).stdout


def test_missing_controllers_are_told(tmp_path):
    installed(tmp_path, "scenarios/circle.toml")
    assert "controllers is missing" in python(tmp_path, "-S", "-c", ASK).stdout


def test_looking_costs_no_import():
    code = "import sys, twin.installation as i; i.problem(); print('controllers' in sys.modules)"
    assert python(".", "-c", code).stdout == "False\n"
