"""The examples, and what docs/python.md shows of the package, run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PYTHON = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
PAGE = ROOT / "examples" / "learning.py"
"""Makes a page of the documentation, and takes its time."""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_a_text_notebook_of_few_lines_of_code(path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# %% [markdown]\n# # ")
    lines = [line.strip() for line in text.splitlines()]
    most = 120 if path == PAGE else 40
    assert sum(bool(line) and not line.startswith("#") for line in lines) <= most


PACKAGE, ENVIRONMENTS = re.findall(r"```py\n(.*?)```", PYTHON, re.DOTALL)
PROGRAMS = {path.stem: path.read_text(encoding="utf-8") for path in EXAMPLES if path != PAGE}
PROGRAMS["nmpc"] = PROGRAMS["nmpc"].replace("STEP = 8.0", "STEP = 3.0")
PROGRAMS["package of the page"] = PACKAGE
PROGRAMS["environments of the page"] = f"{ENVIRONMENTS}\nenv.reset(seed=1), envs.reset(seed=1)"


@pytest.mark.long
@pytest.mark.parametrize("name", PROGRAMS)
def test_an_example_runs_as_it_stands(name, tmp_path):
    (tmp_path / "program.py").write_text(PROGRAMS[name], encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", "program.py"], cwd=tmp_path, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    if name == "identify_from_a_log":
        (found,) = re.findall(r"rolling friction (\S+) mm", done.stdout)
        assert float(found) == pytest.approx(0.25, abs=0.01)
    if name == "nmpc":
        rows = re.findall(
            r"^(\S+) +(\S+) +took +(\S+) ms: finished, e_tt (\S+) %$", done.stdout, re.M
        )
        error = {row[:2]: float(row[3]) for row in rows}
        assert {name for name, time in error if time != "measured"} == {
            *("cure", "lqr", "nmpc", "informed_nmpc")
        }
        assert error["informed_nmpc", "0"] < error["nmpc", "0"] < error["lqr", "0"]


@pytest.mark.long
def test_the_example_that_learns_makes_its_page_also_with_few_short_episodes(tmp_path):
    text = PAGE.read_text(encoding="utf-8")
    for much, little in (
        ("FAMILY_RIGS = 5, 10, 12, 8", "FAMILY_RIGS = 2, 4, 2, 1"),
        ("DURATION, JUDGED = 14.0, 5.6", "DURATION, JUDGED = 0.4, 0.2"),
    ):
        assert much in text
        text = text.replace(much, little)
    (tmp_path / PAGE.name).write_text(text, encoding="utf-8")
    subprocess.run([sys.executable, "-W", "error", PAGE.name], cwd=tmp_path, check=True)
    page = (tmp_path / "learning.md").read_text(encoding="utf-8")
    assert page.startswith("# A baseline that learns\n\nMade by ")
    assert page.count("| learned, seed ") == 2
    assert (tmp_path / "learning.png").is_file()
