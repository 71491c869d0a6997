"""`twin.devices.kinds`: shipped kinds of devices, and those of installed packages."""

import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from twin.base.errors import ScenarioError
from twin.devices import kinds
from twin.devices.kinds import DEFAULT_KINDS, SHIPPED_KINDS, find_kind
from twin.run.connect import connect
from twin.scenario import load
from twin.scenario.rig import RigFile, check_rig, read_rig

SOURCE = """
from dataclasses import dataclass
from ballplate.hardware import ScreenKind, ServosKind

@dataclass(frozen=True, kw_only=True)
class Settings:
    port: str
    gain: float = 1.0
    relaxed: tuple[str, ...] = ()

class Half:
    def __init__(self, settings, around):
        self.settings, self.around = settings, around

def whole(settings, around):
    from twin.devices.own import OwnServos
    from twin.devices.own_config import OwnServosConfig
    from twin.devices.own_hardware import ServoHardware
    class Mine(ServoHardware):
        start = command = stop = lambda *_: None
    made = OwnServos(Mine(), OwnServosConfig(backend=""), around.limits, around.period)
    made.settings = settings
    return made

def raises(settings, around):
    raise OSError(f"no {settings.port}")

DRIVES = ServosKind(settings=Settings, build=whole)
HALF = ServosKind(settings=Settings, build=Half)
RAISES = ServosKind(settings=Settings, build=raises)
SCREEN = ScreenKind(settings=Settings, build=Half)
NUMBER = 3
"""
EXAMPLES = Path(__file__).parents[2] / "examples" / "own_rig"
TOUCH = {"port": "/dev/null"}


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package whose entry points are given, as an installer leaves it on the path."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(kinds, "entry_points", entry_points)  # not those found before
    monkeypatch.delitem(sys.modules, "feetech_ballplate", raising=False)
    (tmp_path / "feetech_ballplate.py").write_text(SOURCE)

    def installed(name="feetech-ballplate", **points):
        folder = tmp_path / f"{name.replace('-', '_')}-1.2.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
        lines = [f"{key.replace('__', '.')} = {value}" for key, value in points.items()]
        (folder / "entry_points.txt").write_text("\n".join(["[ballplate.devices]", *lines]))

    return installed


def rig(drives, **tables):
    return check_rig({"drives": drives, "touch": TOUCH, **tables}, "rig.toml")


def test_a_package_adds_drives_whose_settings_are_checked_and_given_to_them(install):
    install(drives__feetech="feetech_ballplate:DRIVES")
    file = rig({"kind": "feetech", "port": "/dev/x", "gain": 2.0})
    made = connect(load("hold"), file)
    assert (made.servos.settings.port, made.servos.settings.gain) == ("/dev/x", 2.0)
    with pytest.raises(ScenarioError, match=r"drives\.gian: unknown key; did you mean 'gain'"):
        rig({"kind": "feetech", "port": "/dev/x", "gian": 2.0})
    with pytest.raises(ScenarioError, match=r"drives\.port: missing"):
        rig({"kind": "feetech"})
    assert rig({"kind": "feetech", "port": "x", "relaxed": ["all"]}).relaxed(0.002) == ("all",)
    assert file.fingerprint != rig({"kind": "feetech", "port": "/dev/y", "gain": 2.0}).fingerprint


WRONG = {
    "unknown": ({}, "'feetech': no such kind (known: akd, own"),
    "near": ({"drives__feetec": "feetech_ballplate:DRIVES"}, "did you mean 'feetec'?"),
    "no module": ({"drives__feetech": "nowhere_at_all:X"}, "No module named 'nowhere_at_all'"),
    "no name": ({"drives__feetech": "feetech_ballplate:NONE"}, "has no attribute 'NONE'"),
    "no kind": ({"drives__feetech": "feetech_ballplate:NUMBER"}, "ServosKind, not int"),
    "other role": ({"drives__feetech": "feetech_ballplate:SCREEN"}, "ServosKind, not ScreenKind"),
    "lacks": ({"drives__feetech": "feetech_ballplate:HALF"}, "its device lacks age, command,"),
    "raises": ({"drives__feetech": "feetech_ballplate:RAISES"}, "OSError: no x"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_kind_that_cannot_be_had_is_one_line_with_the_package(case, install):
    points, words = WRONG[case]
    install(**points)
    with pytest.raises(ScenarioError) as caught:
        connect(load("hold"), rig({"kind": "feetech", "port": "x"}))
    text = str(caught.value)
    assert words in text
    assert "\n" not in text
    assert "drives.kind = 'feetech'" in text
    assert case in ("unknown", "near") or "feetech-ballplate 1.2" in text


def test_a_package_that_takes_a_shipped_name_is_refused_where_that_is_used(install):
    install(drives__akd="feetech_ballplate:DRIVES")
    with pytest.raises(ScenarioError, match="takes the name of a kind"):
        check_rig({"touch": TOUCH}, "rig.toml")
    assert find_kind("touch", "lumio").package == ""


def test_two_packages_of_one_name_are_refused(install):
    install(drives__feetech="feetech_ballplate:DRIVES")
    install("other", drives__feetech="feetech_ballplate:DRIVES")
    with pytest.raises(ScenarioError, match="both have that name"):
        rig({"kind": "feetech", "port": "x"})


def test_a_file_that_names_no_kind_has_akd_drives_and_a_lumio_screen():
    file = check_rig({"touch": TOUCH}, "rig.toml")
    assert type(file) is RigFile
    assert {role: each.name for role, each in file.kinds.items()} == DEFAULT_KINDS
    named = check_rig({"drives": {"kind": "akd"}, "touch": {"kind": "lumio", **TOUCH}}, "rig.toml")
    assert named.fingerprint == file.fingerprint == "81f590199d32a4ef"  # as before there were kinds
    own = check_rig({"backend": "no_file.py:A"}, "rig.toml")
    assert own.fingerprint == "cd4274d964deccce"
    slow = check_rig({"drives": {"shaft_lag": 0.1}, "touch": TOUCH}, "rig.toml")
    assert slow.fingerprint != file.fingerprint
    assert set(SHIPPED_KINDS) == {"drives", "touch"}


@pytest.mark.parametrize(
    ("name", "servos", "screen"),
    [
        ("servos_and_lumio", "OwnServos", "LumioScreen"),
        ("akd_and_camera", "AkdServos", "SeparateScreen"),
        ("servos_and_camera", "OwnServos", "SeparateScreen"),
        ("rig", "OwnServos", "OwnScreen"),
    ],
)
def test_an_example_rig_file_makes_the_devices_that_it_names(name, servos, screen):
    made = connect(load("hold"), read_rig(EXAMPLES / f"{name}.toml"))
    assert (type(made.servos).__name__, type(made.screen).__name__) == (servos, screen)


@pytest.mark.parametrize(
    ("role", "name", "words"),
    [
        ("drives", "camera.py:Camera", "derived from ballplate.hardware.ServoHardware"),
        ("touch", "servos.py:Servos", "derived from ballplate.hardware.ScreenHardware"),
        ("touch", "arduino.py:Arduino", "includes servos"),
    ],
)
def test_a_class_of_the_other_half_is_refused(role, name, words):
    table = {"kind": "own", "backend": str(EXAMPLES / name), "options": {"port": "x"}}
    file = check_rig({"touch": TOUCH, role: table}, "rig.toml")
    with pytest.raises(ScenarioError, match=words) as caught:
        connect(load("hold"), file)
    assert f"{role}.backend" in str(caught.value)


OWN = {"kind": "own", "backend": "a.py:B"}


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"drives": {"kind": "akdd"}}, "did you mean 'akd'? (known: akd, own"),
        ({"drives": {"kind": "own"}}, "drives.backend: missing"),
        ({"drives": {**OWN, "silence": 1}}, "drives.silence: unknown key"),
        ({"drives": OWN, "phi": {"node": 3}}, "phi: only drives of kind 'akd' have these"),
        ({"drives": OWN, "cams": "a.json"}, "cams: drives of kind 'own'"),
        ({"touch": {**OWN, "silent": 99}}, "touch.silent = 99.0: must be 0.01 to 5"),
        ({"touch": {**OWN, "port": "x"}}, "touch.port: unknown key"),
        ({"drives": OWN, "backend": "a.py:B"}, "drives.kind: a rig with a backend"),
    ],
    ids=str,
)
def test_what_does_not_belong_to_a_kind_is_refused(tables, words):
    with pytest.raises(ScenarioError) as caught:
        check_rig({"touch": TOUCH, **tables}, "rig.toml")
    assert words in str(caught.value)
