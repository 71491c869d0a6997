"""`controllers.catalog`.

Files of users in controllers/ and laws of outside packages, whole and broken."""

import os
import subprocess
import sys

import pytest

from controllers.catalog import locate_error

LAW = """
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.interfaces import Law


@dataclass(frozen=True, kw_only=True)
class Mine(Law):
    name: ClassVar[str] = "mine"

    def control(self, t, x, reference, q):
        return {answer}
"""

BROKEN = {
    "bracket.py": ("def f(:", ", line 1: SyntaxError: invalid syntax"),
    "leaves.py": ("import sys\nsys.exit(3)", ", line 2: SystemExit: 3"),
    "needs.py": ("\nimport absent", ", line 2: ModuleNotFoundError: No module named 'absent'"),
    "typed.py": (
        LAW.replace("Mine", "Typed").replace('"mine"', '"typed"\n    gain: "Flaot" = 1.0'),
        ": NameError: name 'Flaot' is not defined",
    ),
}

RUN = ("run", "hold", "--plant", "lagrange", "--set", "duration=0.1", "--set", "metrics.start=0")


MAIN = "from twin.cli import main; main()"
ASK = """
from controllers.catalog import broken, catalog
from controllers.interfaces import Law
print("mine" in catalog(Law), *broken(), sep="\\n")
"""


def python(folder, code, *arguments):
    """A program with a folder's files as if they lay in controllers/."""
    lead = f"import controllers; controllers.__path__.append({str(folder)!r})\n"
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    return subprocess.run(
        [sys.executable, "-c", lead + code, *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip


def left_out(done):
    return [line for line in done.stderr.splitlines() if "not imported" in line]


@pytest.fixture
def broken(tmp_path):
    for name, (content, _) in BROKEN.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    return tmp_path


@pytest.mark.long
def test_each_broken_file_or_entry_point_is_one_line_and_the_others_laws_run(broken):
    metadata = broken / "outside-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[ballplate.controllers]\nouter = nowhere.laws\n")
    (broken / "whole.py").write_text(LAW.format(answer="np.zeros(x.shape[:-1] + (2,))"))
    done = python(broken, MAIN, *RUN, "--set", "controller.kind=mine")
    assert done.returncode == 0
    assert "Hold on the centre" in done.stdout
    said = "ballplate: warning: not imported: "
    expected = [f"{said}{broken / name}{why}" for name, (_, why) in BROKEN.items()]
    expected.append(
        f"{said}entry point 'outer' (nowhere.laws): ModuleNotFoundError: No module named 'nowhere'"
    )
    assert sorted(left_out(done)) == sorted(expected)


def test_whoever_asks_for_the_law_of_a_broken_file_is_told_of_the_file(broken):
    done = python(broken, MAIN, *RUN, "--set", "controller.kind=bracket")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "controller.kind: no 'bracket'" in line
    assert f"not imported: {broken / 'bracket.py'}, line 1: SyntaxError" in line


@pytest.mark.long
def test_a_package_within_the_folder_is_found_and_a_broken_one_told(tmp_path):
    for name, content in (("good", ""), ("bad", "1 / 0")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(content)
        (tmp_path / name / "law.py").write_text(LAW.format(answer="0.0 * x[..., :2]"))
    found, line = python(tmp_path, ASK).stdout.splitlines()
    assert found == "True"
    assert line.endswith("bad/__init__.py, line 1: ZeroDivisionError: division by zero")


def test_an_error_that_no_law_has_to_do_with_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError) as caught:
        1 / 0  # noqa: B018
    assert locate_error(caught.value) is None
