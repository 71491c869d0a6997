"""Faults on demand: lines of text that do something to emulated drives and their bus, and answers.

A line comes from a terminal or over a socket of this machine, to which only its owner has access.
"""

from __future__ import annotations

import json
import os
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from twin.base.errors import RigError, TwinError
from twin.base.writing import why
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.fault_lines import CONTROL_COMMANDS
from twin.emulator.load import InertiaLoad
from twin.emulator.node import EmulatedNode

_USAGE_TEXTS = {each.split()[0]: f"how: {each}" for each in CONTROL_COMMANDS}
"""How a line is written, by its first word."""

_LARGEST_LINE_BYTES = 200


class ControlError(TwinError):
    """A line that cannot be obeyed; the message has the reason."""


class UnknownLineError(ControlError):
    """A line that begins with no known word."""


class BusControl:
    """Obeys lines about emulated drives and their bus.

    Args:
        bus: The bus.
    """

    def __init__(self, bus: EmulatedBus) -> None:
        self._bus = bus

    def obey(self, line: str) -> str:
        """Carry out a line; return what was done or seen.

        Raises:
            ControlError: The line is none of ``CONTROL_COMMANDS``, or a number in it is not
                allowed.
        """
        words = line.split()
        match words:
            case ["state"]:
                return json.dumps([_state(drive) for drive in self._bus.drives])
            case ["clear"]:
                self._bus.faults.clear()
                return "frames pass as sent"
            case [("drop" | "delay" | "repeat" | "cut") as what, identifier, *numbers]:
                return self._damage(what, _identifier(identifier), numbers)
            case [word, node, *_] if word in _USAGE_TEXTS:
                return self._drive(node, words)
            case [word, *_] if word in _USAGE_TEXTS:
                raise ControlError(_USAGE_TEXTS[word])
        raise UnknownLineError(f"known: {'; '.join(CONTROL_COMMANDS)}")

    def _damage(self, what: str, identifier: int | None, numbers: list[str]) -> str:
        faults = self._bus.faults
        match what, numbers:
            case "drop", [seconds]:
                faults.drop(identifier, lasting=_real(seconds))
            case "delay", [by, seconds]:
                faults.delay(identifier, by=_real(by), lasting=_real(seconds))
            case "repeat", [seconds]:
                faults.duplicate(identifier, lasting=_real(seconds))
            case "cut", [size, seconds]:
                faults.truncate(identifier, to=_whole(size, 0, 8), lasting=_real(seconds))
            case _:
                raise ControlError(_USAGE_TEXTS[what])
        named = "all frames" if identifier is None else f"frames {identifier:03X}h"
        return f"{named}: {what} {' '.join(numbers)} s"

    def _drive(self, number: str, words: list[str]) -> str:
        node = _whole(number, 1, 127)
        drive = next((each for each in self._bus.drives if each.node == node), None)
        if drive is None:
            known = ", ".join(str(each.node) for each in self._bus.drives)
            raise ControlError(f"node {node}: no such drive; there are {known}")
        match [words[0], *words[2:]]:
            case ["fault", fault, *rest] if rest in ([], ["lasting"]):
                drive.fail(_whole(fault, 1, 0xFFFF), lasting=bool(rest))
            case ["sto"]:
                drive.open_sto()
            case ["release"]:
                drive.power.sto_closed = True
            case ["voltage", ("off" | "on") as state]:
                drive.power.dc_link = state == "on"
            case ["reboot"]:
                drive.reboot()
            case ["power", seconds]:
                drive.lose_power(_real(seconds))
            case ["sdo", ("silent" | "answers") as state]:
                drive.sdo_silent = state == "silent"
            case ["abort", place, code]:
                index, _, sub = place.partition(":")
                key = _whole(index, 0x1000, 0xFFFF), _whole(sub or "0", 0, 255)
                drive.sdo_aborts[key] = _whole(code, 0, 0xFFFFFFFF)
            case ["restore"]:
                drive.restore()
            case _:
                self._turn(drive, words)
        return f"node {node}: {' '.join([words[0], *words[2:]])}"

    def _turn(self, drive: EmulatedNode, words: list[str]) -> None:
        """Do something to what a drive turns."""
        match [words[0], *words[2:]]:
            case ["jam"]:
                _load(drive).jammed = True
            case ["free"]:
                _load(drive).jammed = False
            case ["torque", torque]:
                _load(drive).external = _real(torque, -10.0, 10.0)
            case _:
                raise ControlError(_USAGE_TEXTS[words[0]])


def _state(drive: EmulatedNode) -> dict[str, object]:
    """State of a drive, as shown by ``state``."""
    return {
        "node": drive.node,
        "network": {127: "pre-operational", 5: "operational", 4: "stopped"}[drive.nmt],
        "state": drive.state.name.lower().replace("_", " "),
        "mode": drive.store.get(0x6061),
        "status": f"{drive.store.get(0x6041):04X}h",
        "rate_rad_s": round(drive.rate, 6),
        "faults": list(drive.power.faults),
    }


def _load(drive: EmulatedNode) -> InertiaLoad:
    """The inertia that a drive turns.

    Raises:
        ControlError: It turns a plate.
    """
    load = getattr(drive, "motor", None)
    if not isinstance(load, InertiaLoad):
        raise ControlError(f"node {drive.node}: turns a plate, not an inertia of its own")
    return load


def _whole(text: str, low: int, high: int) -> int:
    """A whole number within a range, both ends included.

    Raises:
        ControlError: It is none.
    """
    try:
        number = int(text, 0)
    except ValueError:
        number = None
    if number is None or not low <= number <= high:
        raise ControlError(f"{text[:20]!r}: must be a whole number, {low} to {high}")
    return number


def _real(text: str, low: float = 0.0, high: float = 86400.0) -> float:
    """A number within a range, both ends included.

    Raises:
        ControlError: It is none.
    """
    try:
        number = float(text)
    except ValueError:
        number = None
    if number is None or not low <= number <= high:
        raise ControlError(f"{text[:20]!r}: must be a number, {low:g} to {high:g}")
    return number


def place_of_touch(line: str) -> tuple[float, float]:
    """The place in m at which a line ``touch X Y``, in mm, touches the screen.

    Raises:
        ControlError: It has not two numbers of -1000 to 1000.
    """
    match line.split():
        case ["touch", x, y]:
            return _real(x, -1e3, 1e3) / 1e3, _real(y, -1e3, 1e3) / 1e3
    raise ControlError("how: touch X Y, in mm")


def _identifier(text: str) -> int | None:
    return None if text == "all" else _whole(text, 0, 0x7FF)


@contextmanager
def control_socket(path: Path, obey: Callable[[str], str]) -> Iterator[None]:
    """Obey lines that come over a Unix socket; each is answered by a line, ``ok: `` or ``error: ``.

    Args:
        path: The socket's file, which must not exist; it is removed at the end.
        obey: What a line does; a `ControlError` is the answer.

    Raises:
        RigError: The socket cannot be made.
    """
    server_class = getattr(socketserver, "ThreadingUnixStreamServer", None)
    if server_class is None:
        raise RigError(f"--control {path}: this system has no Unix sockets in Python")

    class Handler(socketserver.StreamRequestHandler):
        """Answers the lines of one connection."""

        def handle(self) -> None:
            """Answer each line until the other end closes, or sends a line that is too long."""
            with suppress(ConnectionError):  # it has closed without waiting for the answer
                while line := self.rfile.readline(_LARGEST_LINE_BYTES + 1):
                    if len(line) > _LARGEST_LINE_BYTES:
                        longest = f"error: a line has at most {_LARGEST_LINE_BYTES} bytes\n"
                        self.wfile.write(longest.encode())
                        return  # the end of it is no line of its own
                    try:
                        answer = f"ok: {obey(line.decode(errors='replace').strip())}"
                    except ControlError as error:
                        answer = f"error: {error}"
                    self.wfile.write(f"{answer}\n".encode())

    mask = os.umask(0o177)  # for its owner alone
    try:
        server = server_class(str(path), Handler)
    except OSError as error:
        hint = "; remove it if no emulator serves it" if path.exists() else ""
        raise RigError(f"--control {path}: cannot be made: {why(error)}{hint}") from error
    finally:
        os.umask(mask)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
        path.unlink(missing_ok=True)
