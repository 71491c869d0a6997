import json
import stat
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from twin.cli.rig import doctor
from twin.data_file import packaged
from twin.doctor import computer
from twin.errors import TwinError

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture
def found(unlocked):
    """What it says, by what was looked at."""

    def look():
        done = CliRunner().invoke(doctor, ["--install", "--json"], standalone_mode=False)
        assert done.return_value == 0
        return {each["what"]: each for each in json.loads(done.stdout)}

    return look


def test_every_extra_of_the_project_is_looked_at_and_is_here(found):
    extras = PROJECT["project"]["optional-dependencies"]
    assert packaged("twin.doctor", "extras.toml").keys() == extras.keys()
    seen = [each for what, each in found().items() if what.startswith("extra ")]
    assert [each["verdict"] for each in seen] == ["pass"] * len(extras)


def test_what_is_missing_is_told_with_what_it_is_for_and_how_to_get_it(monkeypatch, found):
    def none():
        raise TwinError("the viewer is missing")

    monkeypatch.setattr(computer, "_is_here", lambda name: name != "optuna")
    monkeypatch.setattr(computer, "program", none)
    port = type("Port", (), {"device": "/dev/ttyNONE"})
    monkeypatch.setattr(computer.list_ports, "comports", lambda: [port])
    seen = found()
    tune = seen["extra tune (tune with a search by Optuna)"]
    assert (tune["verdict"], tune["seen"]) == ("warn", "optuna missing")
    assert tune["advice"] == "pip install 'ballplate[tune]'"
    assert seen["viewer"]["verdict"] == seen["serial ports"]["verdict"] == "warn"
    assert "not permitted" in seen["serial ports"]["seen"]
    assert seen["packages"]["verdict"] == "pass"


def test_a_port_that_may_be_used_is_named(monkeypatch, found, tmp_path):
    port = tmp_path / "ttyACM0"
    port.touch(stat.S_IRUSR | stat.S_IWUSR)
    device = type("Port", (), {"device": str(port)})
    monkeypatch.setattr(computer.list_ports, "comports", lambda: [device])
    assert found()["serial ports"] == {
        "what": "serial ports",
        "verdict": "pass",
        "seen": str(port),
        "advice": "",
    }
