import importlib
import re
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

import controllers
from controllers import catalog as catalog_module
from controllers.catalog import catalog
from controllers.interfaces import Law
from twin.cli import COMMANDS
from twin.run.execute import run
from twin.scenario.rig import check_rig

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def snippet(tmp_path, monkeypatch):
    """The README's control law, dropped into the package as a user would."""
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (tmp_path / "cascade.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(controllers, "__path__", [*controllers.__path__, str(tmp_path)])
    catalog_module._modules.cache_clear()
    yield code
    catalog_module._modules.cache_clear()


def test_the_readmes_law_has_at_most_forty_lines(snippet):
    assert len(snippet.splitlines()) <= 40


def test_the_readmes_law_is_found_and_drives_the_ball_around_the_circle(snippet, scenario):
    assert "cascade" in catalog(Law)
    done = run(
        scenario(
            "controller.kind=cascade",
            "reference.kind=circle",
            "reference.amplitude=0.1",
            "duration=16",
            "metrics.start=10",
            "plant.friction.rolling_mm=0",
        )
    )
    assert done.outcome.ending == "finished"
    assert done.metrics.tracking_error_percent < 15


def test_the_readmes_laws_settings_are_checked_like_all_others(snippet, scenario):
    with pytest.raises(ValueError, match=r"controller\.bal: unknown key; did you mean 'ball'"):
        scenario("controller.kind=cascade", "controller.bal=[1,1]")


def test_an_outside_package_contributes_by_an_entry_point(tmp_path, monkeypatch):
    (tmp_path / "outside_laws.py").write_text(
        "from controllers.state_feedback import LQR\nclass Outside(LQR):\n    name = 'outside'\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    entry = EntryPoint("outside", "outside_laws", catalog_module.GROUP)
    monkeypatch.setattr(catalog_module, "entry_points", lambda group: [entry])
    catalog_module._modules.cache_clear()
    try:
        assert "outside" in catalog(Law)
    finally:
        catalog_module._modules.cache_clear()


def test_the_readmes_rig_file_is_one():
    (text,) = (
        code for code in re.findall(r"```toml\n(.*?)```", README, re.DOTALL) if "[bus]" in code
    )
    rig = check_rig(tomllib.loads(text), "README.md")
    assert rig.servos(0.002).bus.interface == "slcan"
    assert rig.screen().port == "/dev/ttyUSB0"


def test_every_command_the_readme_shows_exists():
    assert set(re.findall(r"uv run ballplate (\w+)", README)) <= set(COMMANDS)


def test_every_scenario_key_the_readme_changes_exists(scenario):
    keys = set(re.findall(r"--set '?([\w.]+)=", README)) | set(
        re.findall(r"--vary '([\w.]+)=", README)
    )
    tables = scenario().model_dump()
    for key in keys:
        first, *rest = key.split(".")
        if first in {"controller", "observer", "reference", "parameters"}:
            continue
        node = tables[first]
        for name in rest:
            node = node[name]
