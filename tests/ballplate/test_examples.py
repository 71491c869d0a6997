"""The examples, and what the README shows of the package, run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ballplate.changes import scenario_of
from controllers import catalog
from twin.scenario.schema import MetricsTable

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
README = (ROOT / "README.md").read_text(encoding="utf-8")
NAMES = {
    "first_steps", "own_law", "own_observer", "sweep_to_pandas", "identify_from_a_log",
    "step_the_rig", "python_control", "learning",
}  # fmt: skip
PAGE = ROOT / "examples" / "learning.py"
"""Makes a page of the documentation, and takes its time."""
BRIEF = [path for path in EXAMPLES if path != PAGE]


@pytest.fixture
def brief(tmp_path, monkeypatch):
    """Every run is cut to a moment, in this process."""

    def cut(*given, **how):
        scenario = scenario_of(*given, **how)
        return scenario.model_copy(update={"duration": 0.05, "metrics": MetricsTable()})

    for module in ("running", "comparing", "sweeping", "stepping"):
        monkeypatch.setattr(f"ballplate.{module}.scenario_of", cut)
    monkeypatch.setattr("twin.jobs.cores", lambda: 1)
    monkeypatch.setattr(catalog, "_registered", {})
    monkeypatch.chdir(tmp_path)
    yield
    catalog.forget()


def run(code, name):
    """Run a program in a module of its own."""
    module = type(sys)(name)
    sys.modules[name] = module
    try:
        exec(compile(code, name, "exec"), vars(module))
    finally:
        del sys.modules[name]


def test_these_are_the_examples():
    assert {path.stem for path in EXAMPLES} == NAMES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_a_text_notebook_of_few_lines_of_code(path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# %% [markdown]\n# # ")
    lines = [line.strip() for line in text.splitlines()]
    most = 120 if path == PAGE else 40
    assert sum(bool(line) and not line.startswith("#") for line in lines) <= most


@pytest.mark.long
@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    "path", [path for path in BRIEF if "identify" not in path.stem], ids=lambda path: path.stem
)
def test_an_example_runs_with_short_runs(path, capsys):
    run(path.read_text(encoding="utf-8"), path.stem)
    assert capsys.readouterr().out


@pytest.mark.long
@pytest.mark.usefixtures("brief")
def test_what_the_readme_shows_of_python_runs():
    package, _ = re.findall(r"```py\n(.*?)```", README, re.DOTALL)
    run(package, "readme")


@pytest.mark.long
def test_what_the_readme_shows_of_gymnasium_runs(tmp_path):
    _, environments = re.findall(r"```py\n(.*?)```", README, re.DOTALL)
    code = f"{environments}\nenv.reset(seed=1), envs.reset(seed=1)"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=tmp_path, check=False)
    assert done.returncode == 0


@pytest.mark.long
@pytest.mark.parametrize("path", BRIEF, ids=lambda path: path.stem)
def test_an_example_runs_as_it_stands(path, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", path], cwd=tmp_path, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    if path.stem == "identify_from_a_log":
        (found,) = re.findall(r"rolling friction (\S+) mm", done.stdout)
        assert float(found) == pytest.approx(0.25, abs=0.01)


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
