"""An emulated CAN bus: drives, a seeded script of damage to their frames, and who steps it.

The bus itself has no clock. ``DirectBus`` lets its time pass as fast as the host can compute; the
``BusServer`` of ``can_slcan`` lets it pass in real time.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Flag, auto
from itertools import count
from typing import Any

import can
from can.exceptions import CanOperationError

from twin.emulator.drive import EmulatedDrive
from twin.emulator.drive_objects import Frame

Bytes = Callable[[bytes], bytes]
Ids = int | Iterable[int] | None


class Towards(Flag):
    """Which way a frame goes."""

    HOST = auto()
    DRIVES = auto()
    BOTH = HOST | DRIVES


@dataclass(frozen=True)
class Rule:
    """One kind of damage to some frames for some time.

    Attributes:
        cob_ids: Which frames; None for every one.
        change: New bytes for the frame's, or None to lose the frame.
        delays: One copy per delay, in s after the frame; (0,) is the frame itself.
        added: Bus time in s at which it was added.
        after: When it begins, s from then.
        lasting: For how long, s.
        share: Probability with which each of these frames is hit.
        towards: Which way.
    """

    cob_ids: frozenset[int] | None
    change: Bytes | None
    delays: tuple[float, ...]
    added: float
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

    All take the same keywords: ``cob_id`` (one, several, or None for every frame), ``after`` and
    ``lasting`` in s from now, ``share`` (probability of each frame), ``towards``. So
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
        self._add(cob_id, None, **when)

    def delay(self, cob_id: Ids = None, *, by: float, **when: Any) -> None:
        """Deliver frames later by a time in s."""
        self._add(cob_id, delays=(by,), **when)

    def duplicate(self, cob_id: Ids = None, *, apart: float = 0.0, **when: Any) -> None:
        """Deliver frames twice, a time in s apart."""
        self._add(cob_id, delays=(0.0, apart), **when)

    def truncate(self, cob_id: Ids = None, *, to: int, **when: Any) -> None:
        """Cut frames to some bytes."""
        self._add(cob_id, lambda data: data[:to], **when)

    def overwrite(self, cob_id: Ids, *, at: int, data: bytes, **when: Any) -> None:
        """Put other bytes into a part of frames, from byte ``at`` on."""
        end = at + len(data)
        self._add(cob_id, lambda old: old[:at] + data + old[end:], **when)

    def silence(self, node: int, **when: Any) -> None:
        """Lose everything a node says."""
        services = (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)
        when.setdefault("towards", Towards.HOST)
        self.drop([service + node for service in services], **when)

    def deliver(self, frame: Frame, towards: Towards) -> list[tuple[float, Frame]]:
        """What becomes of a frame: delays in s, and the frames that come then."""
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

    def _add(
        self,
        cob_id: Ids,
        change: Bytes | None = bytes,
        delays: tuple[float, ...] = (0.0,),
        **when: Any,
    ) -> None:
        ids = [cob_id] if isinstance(cob_id, int) else cob_id
        chosen = None if ids is None else frozenset(ids)
        self._rules.append(Rule(chosen, change, delays, self.time, **when))


_REPORTS = ((0x040, bytes(8)), (0x004, bytes((0, 0x30, 0, 0, 0, 0, 0, 0))))
"""How SocketCAN's error frames say that an adapter is off the bus, and that it is error passive."""
_INSTANT = 1e-9
"""Seconds that count as no time."""


class EmulatedBus:
    """Carries frames at once, in order; arbitration and transmission times are not emulated.

    Args:
        drives: Who is on it; two with one node are allowed, as on a real bus.
    """

    def __init__(self, drives: Sequence[EmulatedDrive]) -> None:
        self.drives = list(drives)
        self.bitrate = 1_000_000
        """What the drives are set to, bit/s; another adapter hears nothing."""
        self.faults = BusFaults()
        """The damage."""
        self.time = 0.0
        """Seconds that have been stepped."""
        self.moved: Callable[[float], None] = lambda _: None
        """Called after each step with its s, to move a plant: read ``drive.rate``, call
        ``drive.motor.sense``."""
        self.heard: Callable[[], None] = lambda: None
        """Called after each frame that the drives have taken in."""
        self.beside: list[tuple[Frame, float]] = []
        """Frames that another master sends, and how often, in s."""
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
        """Take a frame of a third participant, as of another master: drives and host hear it."""
        self._carry(frame, Towards.DRIVES)
        self._carry(frame, Towards.HOST)

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
        for frame, every in self.beside:
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


class DirectBus(can.BusABC):
    """What a host opens to be on an emulated bus without real time; for tests and fault tables.

    Waiting for a frame lets the bus's time pass in steps. Give the host ``now`` and ``sleep`` of
    this object as its clock.

    Args:
        bus: What is emulated.
        step: Longest step in s.
    """

    def __init__(self, bus: EmulatedBus, step: float = 0.0005) -> None:
        super().__init__(channel="emulated")
        self.plugged = True
        """False: the adapter is gone."""
        self.unreadable_lines = 0
        """Lines of text that are no frame, as of an adapter on a serial port."""
        self._bus = bus
        self._step = step
        self._inbox: deque[can.Message] = deque()
        self._told = (False, False)

    def now(self) -> float:
        """Bus time in s."""
        return self._bus.time

    def sleep(self, seconds: float) -> None:
        """Let the bus's time pass."""
        self._wait(seconds, lambda: False)

    def _wait(self, seconds: float, done: Callable[[], object]) -> None:
        end = self._bus.time + seconds
        while not done() and (left := end - self._bus.time) > 0:
            # A step too small to count would let whoever waits for a deadline wait for ever.
            self._bus.step(max(_INSTANT, min(self._step, left)))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Put a frame on the bus at once; ``timeout`` is not needed.

        Raises:
            CanOperationError: The adapter is gone.
        """
        self._check()
        self._bus.from_host(Frame(msg.arbitration_id, bytes(msg.data), msg.is_remote_frame))

    def send_queued(self) -> None:
        """Every frame has been sent already."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after a timeout in s of bus time.

        The library's own would count the timeout in real time.

        Raises:
            CanOperationError: The adapter is gone.
        """
        self._check()
        self._wait(timeout or 0.0, self._collected)
        return self._inbox.popleft() if self._inbox else None

    def _collected(self) -> bool:
        """Whether anything is there, now that it has been looked for."""
        faults, before = self._bus.faults, self._told
        self._told = (faults.bus_off, faults.error_passive)
        for (identifier, data), now, then in zip(_REPORTS, self._told, before, strict=True):
            if now and not then:
                self._inbox.append(message(identifier, data, error=True))
        self._inbox.extend(message(each.cob_id, each.data) for each in self._bus.to_host())
        return bool(self._inbox)

    def _check(self) -> None:
        if not self.plugged:
            raise CanOperationError("the adapter is gone")


def message(identifier: int, data: bytes, *, error: bool = False) -> can.Message:
    """A frame as python-can has it."""
    return can.Message(
        arbitration_id=identifier, data=data, is_extended_id=error, is_error_frame=error
    )
