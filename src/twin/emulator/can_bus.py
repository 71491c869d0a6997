"""An emulated CAN bus: drives, a seeded script of damage to their frames, and who steps it.

The bus itself has no clock. `direct_bus` lets its time pass as fast as the host can compute; the
``BusServer`` in real time, behind a serial-line CAN adapter (LAWICEL protocol) on a port.
"""

from __future__ import annotations

import heapq
import math
import os
import random
import select
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from enum import Flag, auto
from itertools import count
from pathlib import Path
from typing import Any, Protocol, Self

from twin.base.errors import RigError
from twin.devices.realtime import LatencyHistogram, Paused, never
from twin.emulator.drive_objects import Frame
from twin.emulator.node import EmulatedNode

Bytes = Callable[[bytes], bytes]
Ids = int | Iterable[int] | None


class Towards(Flag):
    """Direction of a frame."""

    HOST = auto()
    DRIVES = auto()
    BOTH = HOST | DRIVES


@dataclass(frozen=True)
class Rule:
    """One kind of damage to some frames for some time.

    Attributes:
        cob_ids: Which frames; None for every one.
        added: Bus time in s at which it was added.
        change: New bytes for the frame's, or None to lose the frame.
        delays: One copy per delay, in s after the frame; (0,) is the frame itself.
        after: When it begins, s from then.
        lasting: For how long, s.
        share: Probability with which each of these frames is hit.
        towards: Which way.
    """

    cob_ids: frozenset[int] | None
    added: float
    change: Bytes | None = bytes
    delays: tuple[float, ...] = (0.0,)
    after: float = 0.0
    lasting: float = math.inf
    share: float = 1.0
    towards: Towards = Towards.BOTH

    def hits(self, frame: Frame, towards: Towards, time: float) -> bool:
        """Whether a frame is one of those, chance aside."""
        known = self.cob_ids is None or frame.cob_id in self.cob_ids
        begins = self.added + self.after
        return known and bool(towards & self.towards) and begins <= time < begins + self.lasting


class BusFaults:
    """Damage that is in force now or later; every method adds to it, ``clear`` ends all.

    All take ``cob_id`` (one, several, or None for every frame), ``after`` and ``lasting`` in s from
    now, ``share`` (probability of each frame) and ``towards``. So
    ``faults.drop(0x181, lasting=0.05)`` loses TPDO1 of node 1 for 50 ms.

    Args:
        seed: Of everything random.
    """

    def __init__(self, seed: int = 0) -> None:
        self.time = 0.0
        """Bus time in s; the bus sets it."""
        self._random = random.Random(seed)
        self._rules: list[Rule] = []
        self.bus_off = self.error_passive = False
        """Whether the host's adapter is off the bus, so that nothing passes either way; whether it
        is error passive: frames still pass."""

    def clear(self) -> None:
        """End all damage."""
        self._rules.clear()
        self.bus_off = self.error_passive = False

    def drop(self, cob_id: Ids = None, **when: Any) -> None:
        """Lose frames."""
        self._add(cob_id, change=None, **when)

    def delay(self, cob_id: Ids, *, by: float, **when: Any) -> None:
        """Deliver frames later by a time in s."""
        self._add(cob_id, delays=(by,), **when)

    def duplicate(self, cob_id: Ids, **when: Any) -> None:
        """Deliver frames twice."""
        self._add(cob_id, delays=(0.0, 0.0), **when)

    def truncate(self, cob_id: Ids, *, to: int, **when: Any) -> None:
        """Cut frames to some bytes."""
        self._add(cob_id, change=lambda data: data[:to], **when)

    def overwrite(self, cob_id: Ids, *, at: int, data: bytes, **when: Any) -> None:
        """Put other bytes into a part of frames, from byte ``at`` on."""
        end = at + len(data)
        self._add(cob_id, change=lambda old: old[:at] + data + old[end:], **when)

    def flip(self, cob_id: Ids, *, at: int, bits: int, **when: Any) -> None:
        """Turn bits of the byte ``at`` of frames over; a frame without that byte is left alone."""

        def flipped(data: bytes) -> bytes:
            return bytes(byte ^ (bits if place == at else 0) for place, byte in enumerate(data))

        self._add(cob_id, change=flipped, **when)

    def silence(self, node: int, **when: Any) -> None:
        """Lose every frame of a node."""
        services = (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)
        when.setdefault("towards", Towards.HOST)
        self.drop([service + node for service in services], **when)

    def deliver(self, frame: Frame, towards: Towards) -> list[tuple[float, Frame]]:
        """Fate of a frame: delays in s, and the frames that are delivered then."""
        if self.bus_off:
            return []
        copies = [(0.0, frame)]
        for rule in self._rules:
            if rule.hits(frame, towards, self.time) and self._random.random() < rule.share:
                change = rule.change
                if change is None:
                    return []
                copies = [
                    (late + delay, each._replace(data=change(each.data)))
                    for late, each in copies
                    for delay in rule.delays
                ]
        return copies

    def _add(self, cob_id: Ids, **rule: Any) -> None:
        ids = [cob_id] if isinstance(cob_id, int) else cob_id
        chosen = None if ids is None else frozenset(ids)
        self._rules.append(Rule(chosen, self.time, **rule))


TIME_RESOLUTION_S = 1e-9
"""Time resolution of the bus, s."""


class EmulatedBus:
    """Carries frames at once, in order; arbitration and transmission times are not emulated.

    Args:
        drives: Who is on it; two with one node are allowed, as on a real bus.
    """

    def __init__(self, drives: Sequence[EmulatedNode]) -> None:
        self.drives = list(drives)
        self.bitrate = 1_000_000
        """Bit rate of the drives, bit/s; an adapter with a different one hears nothing."""
        self.faults = BusFaults()
        """The damage."""
        self.time = 0.0
        """Seconds that have been stepped."""
        self.moved: Callable[[float], None] = lambda _: None
        """Called after each step with its s, to move a plant: read ``drive.rate``, call
        ``drive.motor.sense``."""
        self.heard: Callable[[], None] = lambda: None
        """Called after each frame that the drives have taken in."""
        self.foreign_frames: list[tuple[Frame, float]] = []
        """Frames that a second master sends, and how often, in s."""
        self._order = count()
        self._later: list[tuple[float, int, Towards, Frame]] = []
        self._host: list[Frame] = []

    def from_host(self, frame: Frame) -> bool:
        """Take a frame from the host's adapter; whether anybody acknowledged it."""
        if self.faults.bus_off or not self.drives:
            return False
        self._carry(frame, Towards.DRIVES)
        return True

    def from_other(self, frame: Frame) -> None:
        """Take a frame of a third participant, as of a second master: host and drives hear it."""
        self._carry(frame, Towards.HOST)
        self._carry(frame, Towards.DRIVES)

    def to_host(self) -> list[Frame]:
        """Frames that have reached the host's adapter since the last call."""
        host, self._host = self._host, []
        return host

    def step(self, dt: float) -> None:
        """Let dt seconds pass for the drives and for delayed frames."""
        self.time += dt
        self.faults.time = self.time
        for drive in self.drives:
            for frame in drive.step(dt):
                self._carry(frame, Towards.HOST)
        while self._later and self._later[0][0] <= self.time:
            _, _, towards, frame = heapq.heappop(self._later)
            self._arrive(frame, towards)
        for frame, every in self.foreign_frames:
            if int(self.time / every + 1e-9) > int((self.time - dt) / every + 1e-9):
                self.from_other(frame)
        self.moved(dt)

    def _carry(self, frame: Frame, towards: Towards) -> None:
        for delay, each in self.faults.deliver(frame, towards):
            if delay > 0:
                entry = (self.time + delay, next(self._order), towards, each)
                heapq.heappush(self._later, entry)
            else:
                self._arrive(each, towards)

    def _arrive(self, frame: Frame, towards: Towards) -> None:
        if towards is Towards.HOST:
            self._host.append(frame)
            return
        for drive in self.drives:
            for answer in drive.receive(frame):
                self._carry(answer, Towards.HOST)
        self.heard()


class PseudoTerminal:
    """A port that a program can open, and the end from which it is served; context manager.

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
BITRATE_COMMANDS = {b"S%d" % code: 1000 * rate for code, rate in enumerate(_KBIT_PER_S)}
"""Bit rates by the commands that set them."""

Passing = Callable[[float], None]


def nothing(_: float) -> None:
    """No time passes."""


_OK, _ERROR = b"\r", b"\a"
_SYNC_LINE = b"t0800\r"
_MAX_READ_BYTES = 1 << 16
"""Bytes that are taken at once."""
_WARNING, _PASSIVE, _BUS_ERROR = 0x04, 0x20, 0x80
_ADAPTER_FRAMES = 3
"""Frames the adapter takes that nobody acknowledges before it refuses more."""
_MAX_COMMAND_BYTES = 30


class SlcanAdapter:
    """The adapter's firmware: bytes in, bytes out.

    It answers each command with CR (transmissions with z CR) or, refused, with BELL. Not
    emulated: sending extended frames, filters and timestamps.

    Args:
        bus: The bus of the adapter.
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
            elif len(self._line) < _MAX_COMMAND_BYTES:
                self._line.append(byte)
        return answers

    def heard(self) -> bytes:
        """Frames from the bus as the computer gets them."""
        frames = self._bus.to_host()
        if not self.open or self.bitrate != self._bus.bitrate:
            return b""
        return b"".join(map(_line_of, frames))

    def _command(self, line: bytes) -> bytes:
        commands: dict[bytes, Callable[[bytes], bytes]] = {
            b"S": self._set_rate,
            b"O": self._start,
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
        if self.open or line not in BITRATE_COMMANDS:
            return _ERROR
        self.bitrate = BITRATE_COMMANDS[line]
        return _OK

    def _transmit(self, line: bytes) -> bytes:
        frame = _read(line)
        if frame is None or not self.open:
            return _ERROR
        if self.bitrate == self._bus.bitrate and self._bus.from_host(frame):
            self._unacknowledged = 0
            return b"z\r"
        self._unacknowledged += 1
        return b"z\r" if self._unacknowledged <= _ADAPTER_FRAMES else _ERROR

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
        bus: The bus of the adapter.

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
            passing: Called after each of the SYNCs that have waited, with the share of them so far.
        """
        if self.handle < 0:
            self._bus.to_host()
            return
        with suppress(OSError):
            data = b""
            while len(data) < _MAX_READ_BYTES and select.select([self.handle], [], [], 0)[0]:
                data += os.read(self.handle, 4096)
            *waited, newest = data.split(_SYNC_LINE)
            for number, part in enumerate(waited, start=1):
                self.write(self.adapter.feed(part + _SYNC_LINE))
                self.write(self.adapter.heard())
                passing(number / len(waited))
            self.write(self.adapter.feed(newest))
            self.write(self.adapter.heard())


def _line_of(frame: Frame) -> bytes:
    """The line of a frame: t, r for a remote request, in capitals with eight digits of identifier.

    A remote request asks for as many bytes as it states and has none.
    """
    kind = b"r" if frame.remote else b"t"
    digits = b"%08X" if frame.extended else b"%03X"
    data = b"" if frame.remote else frame.data.hex().upper().encode()
    head = (kind.upper() if frame.extended else kind) + digits % frame.cob_id
    return b"%s%d%s\r" % (head, len(frame.data), data)


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


class Port(Protocol):
    """Where hosts reach an emulated bus."""

    def wait(self, seconds: float) -> None:
        """Wait until a host sends something, at most for a time in s."""

    def pump(self, passing: Passing = nothing) -> None:
        """Pass on what has arrived either way; never waits.

        Args:
            passing: Called after each of the SYNCs that have waited, with the share of them so far.
        """


class BusServer:
    """Pumps a port and steps its bus in real time.

    Time that the computer took away is stepped later in whole steps, at most ``BACKLOG`` of it;
    for the time that ``paused`` returns, the bus's time stands still.

    Args:
        bus: What is emulated.
        port: Where hosts reach it.
        step: Step in s.
    """

    BACKLOG = 0.1
    """Longest lag in s that is made up for."""

    def __init__(self, bus: EmulatedBus, port: Port, *, step: float = 0.0005) -> None:
        self.bus = bus
        self.port = port
        self.lock = threading.Lock()
        """Hold it to look at, or meddle with, several things at one time."""
        self.lag = LatencyHistogram()
        """How late the bus's time was at each round: an emulator that starves answers late."""
        self.paused: Paused = never
        self.second_port: Passing = nothing
        """Called in every round with the time in s: a second port that is served."""
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
                self.second_port(now)

    def stop(self) -> None:
        """End ``run``, from a second thread."""
        self._stop.set()
