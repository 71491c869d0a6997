"""Tests of `twin.cli`."""

import importlib
import re
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import ballplate
from controllers import catalog as catalog_module
from controllers.catalog import catalog
from controllers.interfaces import Law
from twin.scenario.rig import check_rig
from twin.scenario.schema import CATALOG_TABLES, Scenario, choices

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
RUN, WIRE, INSTALLATION = (
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("run", "wire", "installation")
)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_an_outside_package_contributes_by_an_entry_point(tmp_path, monkeypatch):
    (tmp_path / "outside_laws.py").write_text(
        "from controllers.classical import LQR\nclass Outside(LQR):\n    name = 'outside'\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    entry = EntryPoint("outside", "outside_laws", catalog_module.CONTROLLER_ENTRY_POINTS)
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


def test_the_list_of_tables_names_every_table_law_observer_and_reference():
    rows = dict(re.findall(r"^\| (`\[.*?`) \| (.*) \|$", RUN, re.MULTILINE))
    tables = {name for names in rows for name in re.findall(r"\[(\w+)\]", names)}
    simple = {"title", "duration", "seed", "baseline", "rehearsed"}
    assert tables == set(Scenario.model_fields) - simple
    for table in CATALOG_TABLES:
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
