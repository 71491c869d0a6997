import importlib
import re
import shlex
import tomllib
from importlib.metadata import EntryPoint
from itertools import pairwise
from pathlib import Path

import pytest

import ballplate
import controllers
from controllers import catalog as catalog_module
from controllers.catalog import catalog
from controllers.interfaces import Law
from twin.run.finished import run
from twin.scenario.load import check, parsed, read, resolved, setting, variants
from twin.scenario.rig import check_rig
from twin.scenario.schema import KINDS, Scenario, choices

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
RUN, LAW, WIRE, INSTALLATION = (
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("run", "law", "wire", "installation")
)
SHOWING = (
    "README",
    *(f"docs/{name}" for name in ("run", "see", "own-rig", "law", "wire", "thesis")),
)
"""The pages whose commands change scenarios."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture
def snippet(tmp_path, monkeypatch):
    """The control law of docs/law.md, dropped into the package as a user would."""
    (code,) = re.findall(r"```python\n(.*?)```", LAW, re.DOTALL)
    (tmp_path / "cascade.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(controllers, "__path__", [*controllers.__path__, str(tmp_path)])
    catalog_module.forget()
    yield code
    catalog_module.forget()


def test_the_law_of_the_page_is_found_and_drives_the_ball_around_the_circle(snippet, scenario):
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


def test_the_settings_of_the_pages_law_are_checked_like_all_others(snippet, scenario):
    with pytest.raises(ValueError, match=r"controller\.bal: unknown key; did you mean 'ball'"):
        scenario("controller.kind=cascade", "controller.bal=[1,1]")


def test_an_outside_package_contributes_by_an_entry_point(tmp_path, monkeypatch):
    (tmp_path / "outside_laws.py").write_text(
        "from controllers.classical import LQR\nclass Outside(LQR):\n    name = 'outside'\n",
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


def test_the_rig_file_of_the_page_is_one():
    (text,) = (
        code for code in re.findall(r"```toml\n(.*?)```", WIRE, re.DOTALL) if "[bus]" in code
    )
    rig = check_rig(tomllib.loads(text), "wire.md")
    assert rig.servos(0.002).bus.interface == "slcan"
    assert rig.uncalibrated_screen().port == "/dev/ttyUSB0"


def test_every_change_of_a_scenario_that_a_page_shows_is_accepted(snippet, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fitted = tmp_path / "runs" / "identify-excite" / "parameters.toml"
    fitted.parent.mkdir(parents=True)
    fitted.write_text("[plant.friction]\nrolling_mm = 0.2\n", encoding="utf-8")
    changed = set()
    shown = "\n".join((ROOT / f"{name}.md").read_text(encoding="utf-8") for name in SHOWING)
    for line in re.findall(r"^uv run ballplate ((?:run|compare) .*)", shown, re.MULTILINE):
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


def test_the_list_of_tables_names_every_table_law_observer_and_reference():
    rows = dict(re.findall(r"^\| (`\[.*?`) \| (.*) \|$", RUN, re.MULTILINE))
    tables = {name for names in rows for name in re.findall(r"\[(\w+)\]", names)}
    simple = {"title", "duration", "seed", "baseline"}
    assert tables == set(Scenario.model_fields) - simple
    for table in KINDS:
        named = set(re.findall(r"`(\w+)`", rows[f"`[{table}]`"]))
        assert named == set(choices(table)), table


def test_what_every_extra_costs_is_said():
    said = re.findall(r"^\| `ballplate(?:\[(\w+)\])?` \| \d+ \|", INSTALLATION, re.MULTILINE)
    assert said == ["", *sorted(PROJECT["optional-dependencies"])]
    (plain,) = re.findall(r"^\| `ballplate` \| (\d+) \|", INSTALLATION, re.MULTILINE)
    assert f"about {int(plain) / 1000:.1f} GB installed]" in README


def test_the_readme_fits_a_screen_and_a_half():
    assert len(README.splitlines()) <= 150
    assert len(README.encode()) <= 8000


def test_the_citation_is_of_this_version():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    said = dict(re.findall(r"^([\w-]+): (.+)$", text, re.MULTILINE))
    assert (said["version"], said["license"]) == (PROJECT["version"], PROJECT["license"])
    assert said["cff-version"] == "1.2.0"
    assert {"message", "title"} <= set(said)
    assert f"Version {PROJECT['version']}" in README


@pytest.mark.long
def test_the_numbers_of_the_readme_are_those_of_its_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = re.findall(r"^\| \*\*(.*?)\*\*.* \| ([\d.]+) % \|$", README, re.MULTILINE)
    alt = re.findall(r"([\d.]+) %", README.partition("](docs/circle.webp)")[0])
    assert [number for _, number in table] == alt[-3:]
    done = ballplate.run("circle", beside=["cure"])
    runs = {**done.shown, "clean model": done.baseline}
    for name, number in table:
        error = runs[name].metrics["tracking_error_percent"]
        assert number == f"{error:.3g}", name
