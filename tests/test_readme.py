import importlib
import re
import shlex
import tomllib
from importlib.metadata import EntryPoint
from itertools import pairwise
from pathlib import Path

import pytest

import controllers
from controllers import catalog as catalog_module
from controllers.catalog import catalog
from controllers.interfaces import Law
from twin.run.finished import run
from twin.scenario.load import check, read, resolved, setting
from twin.scenario.rig import check_rig
from twin.scenario.schema import KINDS, Scenario, choices
from twin.scenario.variants import parsed, variants

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def snippet(tmp_path, monkeypatch):
    """The README's control law, dropped into the package as a user would."""
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (tmp_path / "cascade.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(controllers, "__path__", [*controllers.__path__, str(tmp_path)])
    catalog_module.forget()
    yield code
    catalog_module.forget()


def test_the_readmes_law_is_found_and_drives_the_ball_around_the_circle(snippet, scenario):
    assert len(snippet.splitlines()) <= 40
    assert "cascade" in catalog(Law)
    done = run(
        scenario(
            "controller.kind=cascade",
            "reference.kind=circle",
            "reference.amplitude=0.1",
            "duration=10",
            "metrics.start=7",
            "plant.friction.rolling_mm=0",
        )
    )
    assert done.outcome == "finished"
    assert done.metrics["tracking_error_percent"] < 15


def test_the_readmes_laws_settings_are_checked_like_all_others(snippet, scenario):
    with pytest.raises(ValueError, match=r"controller\.bal: unknown key; did you mean 'ball'"):
        scenario("controller.kind=cascade", "controller.bal=[1,1]")


def test_an_outside_package_contributes_by_an_entry_point(tmp_path, monkeypatch):
    (tmp_path / "outside_laws.py").write_text(
        "from controllers.linear import LQR\nclass Outside(LQR):\n    name = 'outside'\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    entry = EntryPoint("outside", "outside_laws", catalog_module.GROUP)
    monkeypatch.setattr(catalog_module, "entry_points", lambda group: [entry])
    catalog_module.forget()
    try:
        assert "outside" in catalog(Law)
    finally:
        catalog_module.forget()


def test_the_readmes_rig_file_is_one():
    (text,) = (
        code for code in re.findall(r"```toml\n(.*?)```", README, re.DOTALL) if "[bus]" in code
    )
    rig = check_rig(tomllib.loads(text), "README.md")
    assert rig.servos(0.002).bus.interface == "slcan"
    assert rig.uncalibrated_screen().port == "/dev/ttyUSB0"


def test_every_change_of_a_scenario_that_the_readme_shows_is_accepted(
    snippet, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    fitted = tmp_path / "runs" / "identify-excite" / "parameters.toml"
    fitted.parent.mkdir(parents=True)
    fitted.write_text("[plant.friction]\nrolling_mm = 0.2\n", encoding="utf-8")
    changed = set()
    for line in re.findall(r"^uv run ballplate ((?:run|compare) .*)", README, re.MULTILINE):
        _, scenario, *options = shlex.split(line, comments=True)
        given = list(pairwise(options))
        fixed = [text for option, text in given if option == "--set"]
        varied = [text for option, text in given if option == "--vary"]
        if scenario.startswith("runs/") or scenario.endswith(".csv"):
            continue  # finished runs and logs
        for variant in variants(parsed(varied)):
            changes = [*map(setting, fixed), *variant.settings]
            check(*resolved(*read(scenario), changes))
        changed |= {text.partition("=")[0] for text in (*fixed, *varied)}
    assert changed == {
        "controller", "controller.ball", "controller.kind", "parameters",
        "plant.friction.rolling_mm",
    }  # fmt: skip


def test_the_readmes_list_names_every_table_law_observer_and_reference():
    rows = dict(re.findall(r"^\| (`\[.*?`) \| (.*) \|$", README, re.MULTILINE))
    tables = {name for names in rows for name in re.findall(r"\[(\w+)\]", names)}
    simple = {"title", "duration", "seed", "baseline"}
    assert tables == set(Scenario.model_fields) - simple
    for table in KINDS:
        named = set(re.findall(r"`(\w+)`", rows[f"`[{table}]`"]))
        assert named == set(choices(table)), table


def test_what_every_extra_costs_is_said():
    file = Path(__file__).parent.parent / "pyproject.toml"
    project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
    said = re.findall(r"^\| `ballplate(?:\[(\w+)\])?` \| \d+ \|", README, re.MULTILINE)
    assert said == ["", *sorted(project["optional-dependencies"])]
