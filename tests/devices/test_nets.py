"""`twin.devices`.

Safety nets of a rig file: absurd values are refused by name, relaxed ones are told."""

import math
import re
import tomllib
from dataclasses import fields
from pathlib import Path

import pytest

from twin.base.errors import ScenarioError
from twin.devices.akd.config import MonitorConfig
from twin.devices.common import RELAXED
from twin.devices.lumio.config import PlausibilityLimits
from twin.emulator.lockstep import LockstepRig
from twin.scenario.rig import check_rig

TOUCH = {"touch": {"port": "x"}}


def gate(**thresholds):
    return {"touch": {"port": "x", "gate": thresholds}}


def rig(**tables):
    whole = {**TOUCH, **tables}
    return check_rig({name: its for name, its in whole.items() if its is not None}, "rig.toml")


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"drives": {"silence": 2.0}}, "drives.silence = 2.0: must be 0.01 to 1"),
        ({"drives": {"silence": 0.0}}, "drives.silence"),
        ({"drives": {"watch": {"stale": 300}}}, "drives.watch.stale = 300: must be 2 to 250"),
        ({"drives": {"watch": {"lag": 50.0}}}, "drives.watch.lag = 50.0"),
        ({"drives": {"rate_limit": 2.0, "watch": {"lag": 2.0}}}, "counts as following"),
        ({"drives": {"rate_limit": 100.0}}, "drives.rate_limit = 100.0: must be 1 to 20"),
        ({"drives": {"torque_limit": 0.0}}, "drives.torque_limit = 0.0"),
        ({"drives": {"torque_limit": -1.0}}, "drives.torque_limit = -1.0"),
        ({"phi": {"node": 1, "limit_unit": 0.0}}, "phi.limit_unit = 0.0: must be"),
        ({"theta": {"node": 2, "gear": 0.0}}, "theta.gear = 0.0: must be"),
        ({"theta": {"node": 2, "plate_counts": 0}}, "theta.plate_counts = 0"),
        (gate(stale=1e9), "touch.gate.stale = 1000000000.0: must be 0.01 to 1"),
        (gate(lost=5.0), "touch.gate.lost = 5.0: must be 0.02 to 1"),
        (gate(confirm=0), "touch.gate.confirm = 0: must be 1 to 20"),
        ({"bus": {"bitrate": 800_000}}, "bus.bitrate: "),
        ({"phi": {"node": 1, "motor_sign": 0}}, "phi.motor_sign: "),
        ({"bus": {"bitrate": "fast"}}, "bus.bitrate: "),
        ({"drives": {"watch": {"stale": "soon"}}}, "drives.watch.stale"),
        ({"phi": {"node": 0}}, "phi.node = 0: must be 1 to 126"),
        ({"phi": {"node": 127}}, "phi.node = 127: must be 1 to 126"),
        ({"phi": {"node": 2}}, "rig.toml: phi.node, theta.node, drives.host: must differ"),
        ({"phi": {"plate_sign": 2}}, "phi.plate_sign: must be 1 or -1"),
        ({"touch": None}, "touch is missing"),
        ({"touch": {"port": "x", "protocl": "elo"}}, "did you mean 'protocol'"),
        ({"touch": {"port": "x", "protocol": "smart"}}, "auto, microtouch, elo"),
        ({"touch": {"port": "x", "baud": 0}}, "touch.baud = 0: must be 1 to 1e"),
        ({"touch": {"port": "x", "transport": "usb"}}, "touch.transport: "),
        ({"backend": "a.py:A"}, "has none of these"),
        ({"own": {"silent": 0.1}}, "it needs backend"),
        ({"touch": None, "backend": "a.py:A", "own": {"silent": 60.0}}, "own.silent = 60.0: must"),
        ({"touch": None, "backend": "a.py:A", "own": {"quiet": 1}}, "own.quiet"),
    ],
    ids=str,
)
def test_an_absurd_value_is_refused_by_name(tables, words):
    with pytest.raises(ScenarioError) as caught:
        rig(**tables)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "prefix", "name"),
    [
        (cls, prefix, each.name)
        for cls, prefix in ((MonitorConfig, "drives.watch"), (PlausibilityLimits, "touch.gate"))
        for each in fields(cls)
    ],
)
@pytest.mark.parametrize("value", [0, -1, 1e9, math.inf, math.nan])
def test_no_threshold_can_be_zero_negative_or_endless(settings, prefix, name, value):
    default = getattr(settings(), name)
    wrong = (value, value) if isinstance(default, tuple) else value
    with pytest.raises(ScenarioError, match=f"{prefix}.{name}"):
        settings(**{name: wrong})


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"drives": {"silence": 0.5}}, "drives.silence = 0.5 (default 0.06)"),
        ({"drives": {"shaft_lag": 0.019894367886}}, "drives.shaft_lag = 0.01989 (default 0.0)"),
        ({"drives": {"torque_limit": 6.0}}, "drives.torque_limit = 6.0 (default 4.5)"),
        ({"drives": {"watch": {"stale": 100}}}, "drives.watch.stale = 100 (default 10)"),
        ({"drives": {"watch": {"slack": (0.02, 0.01)}}}, "drives.watch.slack"),
        (gate(stale=0.5), "touch.gate.stale = 0.5 (default 0.06)"),
        (gate(confirm=2), "touch.gate.confirm = 2 (default 3)"),
        ({"late_periods": 100}, "late_periods = 100 (default 25)"),
        (
            {"touch": None, "backend": "a.py:A", "own": {"silent": 1.0}},
            "own.silent = 1.0 (default 0.25)",
        ),
        ({"limits": {"rate_deg": 60.0}}, "limits.rate_deg = 60.0 (default 35.0)"),
        ({"limits": {"area": (0.25, 0.2)}}, "limits.area"),
    ],
    ids=str,
)
def test_a_relaxed_net_is_told_with_its_default(tables, words):
    (found,) = rig(**tables).relaxed(0.002)
    assert words in found


def test_defaults_and_tighter_nets_relax_nothing():
    tighter = rig(
        drives={"silence": 0.05, "watch": {"stale": 5}},
        limits={"angle_deg": 5.0},
        **gate(lost=0.08, confirm=5),
    )
    assert rig().relaxed(0.002) == tighter.relaxed(0.002) == ()


ROOT = Path(__file__).parents[2]


def shipped_files():
    """Rig files that are shipped or printed for others to begin with, by where they stand."""
    page = (ROOT / "docs" / "your-rig.md").read_text(encoding="utf-8")
    printed = [
        block for block in re.findall(r"```toml\n(.*?)```", page, re.S) if "backend" in block
    ]
    found = {f"docs/your-rig.md {n}": tomllib.loads(text) for n, text in enumerate(printed)}
    for own in sorted((ROOT / "examples").glob("*/*.toml")):
        text = own.read_text(encoding="utf-8")
        if "backend" in text:
            found[str(own.relative_to(ROOT).as_posix())] = tomllib.loads(text)
    return found


def computes(name):
    """Whether a board computes: the plate does not follow the controller of the host."""
    return "computing" in name


@pytest.mark.parametrize("name", shipped_files())
def test_no_rig_file_that_others_begin_with_relaxes_what_doctor_says_to_take_out(name):
    expected = ("own.astray_deg = 20.0 (default 3.0)",) if computes(name) else ()
    found = check_rig(shipped_files()[name], name).relaxed(0.002)
    assert [each.rpartition("relaxed: ")[2] for each in found] == list(expected)


def test_every_run_is_warned_of_a_relaxed_net(scenario):
    words = rig(drives={"silence": 0.5}).relaxed(0.002)
    made = LockstepRig(scenario("plant.kind=lagrange"), relaxed=words)
    for _ in range(2):
        with made:
            made.read()
        told = [entry.note for entry in made.journal if entry.note.condition == RELAXED]
        made.journal.clear()
        assert [note.text for note in told] == [
            "rig file: safety net relaxed: drives.silence = 0.5 (default 0.06)"
        ]
