"""`twin.emulator`.

What the emulator may know: nothing of the host's reading of the protocol, and no one system."""

import ast
import multiprocessing
import sys
from pathlib import Path

import pytest

import twin.devices
import twin.emulator
from twin.base.errors import RigError
from twin.emulator.can_bus import EmulatedBus, PseudoTerminal, SlcanPort
from twin.emulator.serve import Emulator, PauseWatch, serve_rig

FILES = sorted(Path(twin.emulator.__file__).parent.glob("*.py"))
HOST_SIDE = {f"twin.devices.akd.{each}" for each in ("config", "servos", "recording")}
"""What the host runs on; the lockstep rig puts it on the emulated drives."""
POSIX = {"pty", "tty", "termios", "fcntl", "resource", "pwd", "grp"}


def imported(file, *, everywhere=True):
    """Modules that a file imports; without ``everywhere`` those that it imports when imported."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    nodes = ast.walk(tree) if everywhere else tree.body
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module
            yield from (f"{node.module}.{each.name}" for each in node.names)


@pytest.mark.parametrize("file", FILES, ids=[file.stem for file in FILES])
def test_the_emulated_drives_share_no_reading_of_the_protocol_with_the_host(file):
    known = {name for name in imported(file) if name.startswith("twin.devices.akd")}
    modules = {name for name in known if name.rpartition(".")[2].islower()}
    assert modules <= (HOST_SIDE if file.stem == "lockstep" else set())


def test_no_module_of_emulator_or_devices_needs_a_posix_system_to_be_imported():
    files = [*FILES, *Path(twin.devices.__file__).parent.rglob("*.py")]
    assert [each for each in files if POSIX & set(imported(each, everywhere=False))] == []


@pytest.mark.parametrize(
    "make",
    [lambda: SlcanPort(EmulatedBus([])), lambda: PseudoTerminal("lumio")],
    ids=["adapter", "screen"],
)
def test_a_port_that_this_system_cannot_have_is_said_so_in_one_line(make, monkeypatch):
    monkeypatch.setitem(sys.modules, "pty", None)
    with pytest.raises(RigError, match="Linux and macOS have them") as caught:
        make()
    assert sys.platform in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_rig_in_another_process_is_not_even_started_without_ports(scenario, monkeypatch):
    monkeypatch.setitem(sys.modules, "pty", None)
    monkeypatch.setattr("multiprocessing.get_context", lambda kind: pytest.fail("started"))
    with pytest.raises(RigError, match="pseudo-terminals"), serve_rig(scenario()):
        pass


def test_a_rig_whose_process_has_ended_says_so_in_a_line():
    ours, theirs = multiprocessing.Pipe()
    theirs.close()
    rig = Emulator(ours, {}, PauseWatch([0.0] * 6, 0))
    assert rig.lag() == "emulated rig: its process has ended; was it killed?"
    with pytest.raises(RigError, match="has ended"):
        rig.tell("lift")
