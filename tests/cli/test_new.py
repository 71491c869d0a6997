import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from controllers import catalog as catalog_module
from controllers.catalog import ADDED, add, broken, catalog, outside
from controllers.interfaces import Law, Observer, Reference
from twin.cli import main
from twin.cli.new import LIKE
from twin.run.finished import run
from twin.scenario import load
from twin.study import schema
from twin.study.work import sources

README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
SHORT = ("plant.kind=lagrange", "duration=0.1", "metrics.start=0")
BASES = {"law": Law, "observer": Observer, "reference": Reference}
TABLES = {"law": "controller", "observer": "observer", "reference": "reference"}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(ADDED, "")
    catalog_module.forget()
    yield tmp_path
    catalog_module.forget()


def ballplate(*arguments):
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    return end.value.code


def refusal(capsys, *arguments):
    assert ballplate(*arguments) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    return text


def test_the_law_it_writes_is_that_of_the_readme(folder):
    assert ballplate("new", "law", "cascade") == 0
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert (folder / "laws" / "cascade.py").read_text(encoding="utf-8") == code


@pytest.mark.parametrize("kind", list(BASES))
def test_what_it_writes_is_found_by_its_name_and_runs(kind, folder, capsys):
    assert ballplate("new", kind, "my_own") == 0
    said = " ".join(capsys.readouterr().out.split())
    key = f"{TABLES[kind]}.kind=my_own"
    assert "laws/my_own.py; try: ballplate run" in said
    assert key in said
    catalog_module.forget()
    cls = catalog(BASES[kind])["my_own"]
    assert cls.__name__ == "MyOwn"
    assert run(load("hold", (key, *SHORT))).outcome == "finished"


@pytest.mark.parametrize("like", LIKE)
def test_a_law_may_begin_like_another(like, folder, capsys):
    assert ballplate("new", "law", "mine", "--like", like) == 0
    catalog_module.forget()
    law = catalog(Law)["mine"]
    assert law.__name__ == "Mine"
    assert law.memory == (4 if like == "pid" else 0)
    assert run(load("hold", ("controller.kind=mine", *SHORT))).outcome == "finished"


def test_a_law_written_like_a_pid_moves_the_ball_as_the_shipped_one(folder):
    assert ballplate("new", "law", "mine", "--like", "pid") == 0
    catalog_module.forget()
    ways = [
        run(load("hold", (f"controller.kind={kind}", "reference.x=0.001", *SHORT))).motion.ball
        for kind in ("mine", "pid")
    ]
    np.testing.assert_allclose(*ways, atol=1e-12)


def test_only_a_law_may_begin_like_another(folder, capsys):
    assert "--like" in refusal(capsys, "new", "observer", "mine", "--like", "pid")


@pytest.mark.parametrize("kind", list(BASES))
def test_every_class_has_the_public_path_that_templates_and_examples_use(kind):
    public = importlib.import_module(f"ballplate.{kind}s")
    shipped = {
        cls.__name__ for cls in catalog(BASES[kind]).values() if "controllers." in cls.__module__
    }
    assert shipped <= set(public.__all__)
    more = {"law": "Feedback", "observer": "DelayedObserver Quantity", "reference": "Reference"}
    assert set(more[kind].split()) <= set(public.__all__)


def test_the_scenario_and_the_study_it_writes_are_whole(folder):
    assert ballplate("new", "scenario", "first_try") == 0
    assert ballplate("new", "study", "my_study") == 0
    assert load("first_try.toml").title == "First try"
    study = schema.read("my_study.toml")
    assert "ballplate run first_try.toml" in (folder / "first_try.toml").read_text()
    assert (study.title, len(study.variants)) == ("My study", 2)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("law", "My-Law"), "must be small letters, digits and _"),
        (("law", "lambda"), "must be small letters, digits and _"),
        (("law", "../x"), "must be small letters, digits and _"),
        (("law", "afl"), "law 'afl': the name is taken by controllers.nonlinear"),
        (("observer", "afl"), "observer 'afl': the name is taken by"),
    ],
)
def test_a_name_that_cannot_be_is_one_line_and_writes_nothing(arguments, expected, folder, capsys):
    assert expected in refusal(capsys, "new", *arguments)
    assert not list(folder.iterdir())


def test_nothing_is_written_over(folder, capsys):
    (folder / "mine.toml").write_text("kept")
    assert "mine.toml: exists" in refusal(capsys, "new", "scenario", "mine")
    assert (folder / "mine.toml").read_text() == "kept"


def test_a_folder_that_cannot_be_written_is_one_line(folder, capsys):
    (folder / "laws").write_text("a file where the folder should be")
    assert "cannot be written" in refusal(capsys, "new", "law", "mine")


def law(name, answer="0.0 * x[..., :2]", cls="Mine"):
    return (
        "from dataclasses import dataclass\nfrom typing import ClassVar\n"
        "from controllers.interfaces import Law\n"
        "@dataclass(frozen=True, kw_only=True)\n"
        f"class {cls}(Law):\n    name: ClassVar[str] = '{name}'\n"
        f"    def control(self, t, x, reference, q):\n        return {answer}\n"
    )


def test_a_law_of_any_file_is_taken_in_here_and_in_children(folder):
    (folder / "deep").mkdir()
    file = folder / "deep" / "mine.py"
    file.write_text(law("mine"))
    assert "mine" not in catalog(Law)
    add(file)
    assert "mine" in catalog(Law)
    asked = "from controllers.catalog import *; from controllers.interfaces import Law; import json"
    child = subprocess.run(
        [sys.executable, "-c", f"{asked}; print(json.dumps(list(catalog(Law))))"],
        check=True, capture_output=True, text=True, cwd=folder, env=dict(os.environ),
    )  # fmt: skip
    assert "mine" in json.loads(child.stdout)


def test_the_option_takes_a_file_in(folder, capsys):
    (folder / "mine.py").write_text(law("mine"))
    changes = [item for text in SHORT for item in ("--set", text)]
    kind = ("--set", "controller.kind=mine")
    assert ballplate("run", "hold", "--law", "mine.py", *kind, *changes, "--json") == 0
    assert json.loads(capsys.readouterr().out)["outcome"] == "finished"


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("absent.py", None, "--law absent.py: not a Python file"),
        ("notes.txt", "words", "--law notes.txt: not a Python file"),
        ("wrong.py", "x = 1\nx = (", "wrong.py, line 2: SyntaxError"),
        ("empty.py", "", "--law empty.py: no law, observer or reference in it has a name"),
        ("twice.py", law("afl"), "the name 'afl' is taken by"),
    ],
)
def test_a_file_that_cannot_be_taken_in_is_one_line(name, content, expected, folder, capsys):
    if content is not None:
        (folder / name).write_text(content)
    assert expected in refusal(capsys, "run", "hold", "--law", name)
    assert not os.environ[ADDED]


def test_a_name_that_is_taken_is_told_and_the_first_one_stays(folder):
    (folder / "laws").mkdir()
    (folder / "laws" / "afl.py").write_text(law("afl"))
    assert catalog(Law)["afl"].__module__ == "controllers.nonlinear"
    (line,) = broken()
    assert "laws/afl.py" in line
    assert "the name 'afl' is taken by" in line


def test_a_study_knows_when_an_own_law_has_changed(folder):
    (folder / "laws").mkdir()
    file = folder / "laws" / "mine.py"
    file.write_text(law("mine"))
    assert [module.__file__ for module in outside()] == [str(file)]
    assert file in sources()


def test_an_error_in_an_own_law_shows_its_own_line(folder, capsys):
    (folder / "laws").mkdir()
    (folder / "laws" / "mine.py").write_text(law("mine", "unheard_of"))
    changes = [item for text in SHORT for item in ("--set", text)]
    code = ballplate("run", "hold", "--set", "controller.kind=mine", *changes)
    text = capsys.readouterr().err
    assert code == 1
    assert "mine.py, line 8: NameError: name 'unheard_of' is not defined" in text
    assert "Traceback" not in text
