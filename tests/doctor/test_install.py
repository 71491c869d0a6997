import json
import stat

import pytest
from click.testing import CliRunner

from twin.cli.rig import doctor
from twin.doctor import computer
from twin.errors import TwinError


@pytest.fixture
def found(unlocked):
    """What it says, by what was looked at."""

    def look():
        done = CliRunner().invoke(doctor, ["--install", "--json"], standalone_mode=False)
        assert done.return_value == 0
        return {each["what"]: each for each in json.loads(done.stdout)}

    return look


def test_a_missing_viewer_and_a_port_that_may_not_be_used_are_told(monkeypatch, found):
    def none():
        raise TwinError("the viewer is missing")

    monkeypatch.setattr(computer, "program", none)
    port = type("Port", (), {"device": "/dev/ttyNONE"})
    monkeypatch.setattr(computer.list_ports, "comports", lambda: [port])
    seen = found()
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
