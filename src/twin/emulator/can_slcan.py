"""Ports of the virtual rig: a serial-line CAN adapter (LAWICEL protocol), served in real time."""

from __future__ import annotations

import os
import select
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Self

from twin.devices.realtime import LatencyHistogram, Paused, never
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.drive_objects import Frame
from twin.errors import RigError


class PseudoTerminal:
    """A port that another program can open, and the end from which it is served; context manager.

    It is for one thread at a time.

    Args:
        name: What the port is called, in a temporary folder.

    Raises:
        RigError: This system has no pseudo-terminals.
    """

    def __init__(self, name: str) -> None:
        check_pseudo_terminals()
        self._folder = tempfile.TemporaryDirectory(prefix=f"{name}-")
        self.path = Path(self._folder.name) / name
        """The port to open; stays the same when unplugged and plugged in again."""
        self.handle = -1
        """File descriptor to read from and write to, which never blocks; -1 while unplugged."""
        self._plugged = ExitStack()

    def plug(self) -> None:
        """Bring the port up, freshly."""
        import pty  # noqa: PLC0415  not on every system
        import tty  # noqa: PLC0415

        self.unplug()
        self.handle, port = pty.openpty()
        for each in (self.handle, port):
            self._plugged.callback(os.close, each)
        tty.setraw(port)
        os.set_blocking(self.handle, False)
        self.path.symlink_to(os.ttyname(port))

    def unplug(self) -> None:
        """Take the port away, as when the cable is pulled."""
        self.path.unlink(missing_ok=True)
        self.handle = -1
        self._plugged.close()

    def write(self, data: bytes) -> int:
        """Write what there is room for; how many bytes that was, none while unplugged."""
        with suppress(OSError):
            return os.write(self.handle, data) if self.handle >= 0 else 0
        return 0

    def close(self) -> None:
        """Take the port away for good."""
        self.unplug()
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def check_pseudo_terminals() -> None:
    """Make sure that this system has pseudo-terminals.

    Raises:
        RigError: It has none.
    """
    try:
        import pty  # noqa: F401, PLC0415
        import tty  # noqa: F401, PLC0415
    except ImportError:
        raise RigError(
            f"emulated rig: its ports are pseudo-terminals, which {sys.platform} does not have; "
            "Linux and macOS have them"
        ) from None


_KBIT_PER_S = (10, 20, 50, 100, 125, 250, 500, 800, 1000)
BITRATES = {b"S%d" % code: 1000 * rate for code, rate in enumerate(_KBIT_PER_S)}
"""Bit rates by the commands that set them."""

Passing = Callable[[float], None]


def nothing(_: float) -> None:
    """No time passes."""


_OK, _ERROR = b"\r", b"\a"
_SYNC = b"t0800\r"
_MOST = 1 << 16
"""Bytes that are taken at once."""
_WARNING, _PASSIVE, _BUS_ERROR = 0x04, 0x20, 0x80
_ROOM = 3
"""Frames the adapter takes that nobody acknowledges before it refuses more."""
_LONGEST = 30


class SlcanAdapter:
    """The adapter's firmware: bytes in, bytes out.

    It answers each command with CR (transmissions with z CR) or, refused, with BELL. Not
    emulated: extended frames, filters and timestamps.

    Args:
        bus: What it is on.
    """

    def __init__(self, bus: EmulatedBus) -> None:
        self.bitrate: int | None = None
        self.open = False
        self._bus = bus
        self._line = bytearray()
        self._unacknowledged = 0

    def feed(self, data: bytes) -> bytes:
        """Take in bytes from the computer, any bytes; the answers."""
        answers = b""
        for byte in data:
            if byte == _OK[0]:
                answers += self._command(bytes(self._line))
                self._line.clear()
            elif len(self._line) < _LONGEST:
                self._line.append(byte)
        return answers

    def heard(self) -> bytes:
        """Frames from the bus as the computer gets them."""
        frames = self._bus.to_host()
        if not self.open or self.bitrate != self._bus.bitrate:
            return b""
        return b"".join(_written(frame) for frame in frames)

    def _command(self, line: bytes) -> bytes:
        commands: dict[bytes, Callable[[bytes], bytes]] = {
            b"S": self._set_rate,
            b"O": self._start,
            b"L": self._start,
            b"C": self._close,
            b"t": self._transmit,
            b"r": self._transmit,
            b"F": self._flags,
            b"V": lambda _: b"V1013\r",
            b"N": lambda _: b"NEMUL\r",
            b"": lambda _: _OK,
        }
        command = commands.get(line[:1])
        return _ERROR if command is None else command(line)

    def _start(self, _: bytes) -> bytes:
        ready = self.bitrate is not None and not self.open
        self.open = self.open or ready
        return _OK if ready else _ERROR

    def _close(self, _: bytes) -> bytes:
        was, self.open, self._unacknowledged = self.open, False, 0
        return _OK if was else _ERROR

    def _set_rate(self, line: bytes) -> bytes:
        if self.open or line not in BITRATES:
            return _ERROR
        self.bitrate = BITRATES[line]
        return _OK

    def _transmit(self, line: bytes) -> bytes:
        frame = _read(line)
        if frame is None or not self.open:
            return _ERROR
        if self.bitrate == self._bus.bitrate and self._bus.from_host(frame):
            self._unacknowledged = 0
            return b"z\r"
        self._unacknowledged += 1
        return b"z\r" if self._unacknowledged <= _ROOM else _ERROR

    def _flags(self, _: bytes) -> bytes:
        flags = 0
        if self._bus.faults.error_passive:
            flags |= _WARNING | _PASSIVE
        if self._unacknowledged or self._bus.faults.bus_off:
            flags |= _WARNING | _PASSIVE | _BUS_ERROR
        return b"F%02X\r" % flags if self.open else _ERROR


class SlcanPort(PseudoTerminal):
    """The adapter on a pseudo-terminal; nothing it does waits.

    Args:
        bus: What it is on.

    Raises:
        RigError: This system has no pseudo-terminals.
    """

    def __init__(self, bus: EmulatedBus) -> None:
        super().__init__("slcan")
        self._bus = bus
        self.plug()

    def plug(self) -> None:
        """Bring the port up with a fresh adapter."""
        self.adapter = SlcanAdapter(self._bus)
        super().plug()

    def wait(self, seconds: float) -> None:
        """Wait until the computer sends something, at most for a time in s."""
        with suppress(OSError, ValueError):
            ports = [] if self.handle < 0 else [self.handle]
            select.select(ports, [], [], seconds)

    def pump(self, passing: Passing = nothing) -> None:
        """Pass on what has arrived either way; never waits.

        Args:
            passing: Is told after each SYNC of those that have waited which share of them that was.
        """
        if self.handle < 0:
            self._bus.to_host()
            return
        with suppress(OSError):
            data = b""
            while len(data) < _MOST and select.select([self.handle], [], [], 0)[0]:
                data += os.read(self.handle, 4096)
            *waited, newest = data.split(_SYNC)
            for number, part in enumerate(waited, start=1):
                self.write(self.adapter.feed(part + _SYNC))
                self.write(self.adapter.heard())
                passing(number / len(waited))
            self.write(self.adapter.feed(newest))
            self.write(self.adapter.heard())


def _written(frame: Frame) -> bytes:
    return b"t%03X%d%s\r" % (frame.cob_id, len(frame.data), frame.data.hex().upper().encode())


def _read(line: bytes) -> Frame | None:
    try:
        cob_id, length = int(line[1:4], 16), int(line[4:5])
        data = bytes.fromhex(line[5:].decode("ascii"))
    except ValueError:
        return None
    remote = line[:1] == b"r"
    if cob_id > 0x7FF or length > 8 or len(data) != (0 if remote else length):
        return None
    return Frame(cob_id, data, remote)


class BusServer:
    """Pumps a port and steps its bus in real time.

    Time that the computer took away is stepped later in whole steps, at most ``BACKLOG`` of it;
    for what ``paused`` says of it the bus's time stands still.

    Args:
        bus: What is emulated.
        port: Where the host's adapter is.
        step: Step in s.
    """

    BACKLOG = 0.1
    """Longest lag in s that is made up for."""

    def __init__(self, bus: EmulatedBus, port: SlcanPort, *, step: float = 0.0005) -> None:
        self.bus = bus
        self.port = port
        self.lock = threading.Lock()
        """Hold it to look at, or meddle with, several things at one time."""
        self.lag = LatencyHistogram()
        """How late the bus's time was at each round: an emulator that starves answers late."""
        self.paused: Paused = never
        self.beside: Passing = nothing
        """Is called in every round with the time in s: another port that is served."""
        self._step = step
        self._stop = threading.Event()

    def run(self) -> None:
        """Serve until ``stop`` is called."""
        stepped = before = time.monotonic()
        while not self._stop.is_set():
            self.port.wait(max(0.0, stepped + self._step - time.monotonic()))
            with self.lock:
                now = time.monotonic()
                stepped += self.paused(before, now)
                before = now
                self.lag.add(max(0.0, now - stepped - self._step))
                begin = stepped = max(stepped, now - self.BACKLOG)

                def passing(share: float, begin: float = begin, now: float = now) -> None:
                    nonlocal stepped
                    while stepped + self._step <= begin + share * (now - begin):
                        stepped += self._step
                        self.bus.step(self._step)

                # of SYNCs that have waited each has its own time; who comes meanwhile waits, too
                self.port.pump(passing)
                passing(1.0)
                self.beside(now)

    def stop(self) -> None:
        """End ``run``, from another thread."""
        self._stop.set()
