"""`twin.cli.new`: What `ballplate new` writes works, and a file of one's own is taken in."""

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from controllers.catalog import add, catalog, forget, outside
from controllers.interfaces import Law, Observer, Reference
from twin.base.shipped import shipped_scenarios
from twin.cli.new import LAW_STARTS
from twin.run.finished import run
from twin.scenario import load
from twin.study import schema
from twin.study.work import sources

PAGE = (Path(__file__).parents[2] / "docs" / "law.md").read_text(encoding="utf-8")
SHORT = ("plant.kind=lagrange", "duration=0.1", "metrics.start=0")
BASES = {"law": Law, "observer": Observer, "reference": Reference}
TABLES = {"law": "controller", "observer": "observer", "reference": "reference"}
LAW = """
from dataclasses import dataclass
from typing import ClassVar
from controllers.interfaces import Law
@dataclass(frozen=True, kw_only=True)
class Mine(Law):
    name: ClassVar[str] = "{name}"
    def control(self, t, x, reference, q):
        return 0.0 * x[..., :2]
"""

pytestmark = pytest.mark.usefixtures("own_laws", "no_pictures")


@pytest.fixture
def new(ballplate):
    """Calls ``ballplate new``, after which the catalog looks again; what it says."""

    def call(*arguments):
        code, out, err = ballplate("new", *arguments)
        assert code == 0, err
        forget()
        return " ".join(out.split())

    return call


def test_the_law_it_writes_is_that_of_the_page_about_laws(new):
    new("law", "cascade")
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert Path("laws/cascade.py").read_text(encoding="utf-8") == code
    assert len(code.splitlines()) <= 40


@pytest.mark.parametrize("kind", list(BASES))
def test_what_it_writes_is_found_by_its_name_and_runs(kind, new):
    said = new(kind, "my_own")
    key = f"{TABLES[kind]}.kind=my_own"
    assert "laws/my_own.py; try: ballplate run" in said
    assert key in said
    assert catalog(BASES[kind])["my_own"].__name__ == "MyOwn"
    assert run(load("hold", (key, *SHORT))).outcome == "finished"


@pytest.mark.parametrize("like", LAW_STARTS)
def test_a_law_may_begin_like_another(like, new):
    new("law", "mine", "--like", like)
    law = catalog(Law)["mine"]
    assert law.__name__ == "Mine"
    assert law.memory == (4 if like == "pid" else 0)
    keys = ("reference.x=0.001", *SHORT)
    own = run(load("hold", ("controller.kind=mine", *keys)))
    assert own.outcome == "finished"
    if like == "pid":  # it moves the ball as the shipped one
        shipped = run(load("hold", ("controller.kind=pid", *keys)))
        np.testing.assert_allclose(own.motion.ball, shipped.motion.ball, atol=1e-12)


@pytest.mark.parametrize("kind", list(BASES))
def test_every_class_has_the_public_path_that_templates_and_examples_use(kind):
    public = importlib.import_module(f"ballplate.{kind}s")
    shipped = {
        cls.__name__ for cls in catalog(BASES[kind]).values() if "controllers." in cls.__module__
    }
    assert shipped <= set(public.__all__)
    more = {"law": "Feedback", "observer": "DelayedObserver Quantity", "reference": "Reference"}
    assert set(more[kind].split()) <= set(public.__all__)


def test_the_scenario_and_the_study_it_writes_are_whole(new):
    new("scenario", "first_try")
    new("study", "my_study")
    assert load("first_try.toml").title == "First try"
    study = schema.read("my_study.toml")
    assert "ballplate run first_try.toml" in Path("first_try.toml").read_text()
    assert study.title == "My study"
    assert [each.scenario for each in study.variants] == ["", "", "cure"]


@pytest.mark.parametrize("shipped", ["cure", "thesis/9_3_075"])
def test_a_scenario_may_begin_as_a_copy(shipped, new):
    assert "try: ballplate run mine.toml" in new("scenario", "mine", "--like", shipped)
    assert Path("mine.toml").read_bytes() == shipped_scenarios()[shipped].read_bytes()


@pytest.mark.parametrize("content", [b"t,x\n1,2\n", b"\xff\xfe"])
def test_what_is_no_scenario_is_not_copied(content, ballplate):
    Path("other.toml").write_bytes(content)
    code, _, err = ballplate("new", "scenario", "mine", "--like", "other.toml")
    assert (code, err.count("\n")) == (2, 1)
    assert "--like: other.toml" in err
    assert not Path("mine.toml").exists()


def test_a_folder_that_cannot_be_written_is_one_line(ballplate):
    Path("laws").write_text("a file where the folder should be")
    code, _, err = ballplate("new", "law", "mine")
    assert (code, err.count("\n")) == (2, 1)
    assert "cannot write" in err


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A law in a file of the working folder."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "mine.py"
    file.write_text(LAW.format(name="mine"))
    return file


def test_a_law_of_any_file_is_taken_in_here_and_in_children(mine):
    assert "mine" not in catalog(Law)
    add(mine)
    assert "mine" in catalog(Law)
    asked = "from controllers.catalog import *; from controllers.interfaces import Law; import json"
    child = subprocess.run(
        [sys.executable, "-c", f"{asked}; print(json.dumps(list(catalog(Law))))"],
        check=True, capture_output=True, text=True, env=dict(os.environ),
    )  # fmt: skip
    assert "mine" in json.loads(child.stdout)


def test_a_study_knows_when_an_own_law_has_changed(mine):
    Path("laws").mkdir()
    file = mine.rename("laws/mine.py").resolve()
    assert [module.__file__ for module in outside()] == [str(file)]
    assert file in sources()
