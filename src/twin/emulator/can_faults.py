"""CAN frames, and what happens to them between drives and adapter: a seeded script of damage."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Flag, auto
from typing import NamedTuple, TypedDict, Unpack

Bytes = Callable[[bytes, random.Random], bytes]
Ids = int | Iterable[int] | None


class Frame(NamedTuple):
    """A classic CAN frame with an 11-bit identifier and up to eight bytes.

    Attributes:
        cob_id: Identifier.
        data: Its bytes.
        remote: Whether it is a remote request.
    """

    cob_id: int
    data: bytes = b""
    remote: bool = False


class Towards(Flag):
    """Which way a frame goes."""

    HOST = auto()
    DRIVES = auto()
    BOTH = HOST | DRIVES


class When(TypedDict, total=False):
    """Which of the frames are hit, see ``BusFaults``."""

    after: float
    lasting: float
    share: float
    towards: Towards


def _same(data: bytes, _: random.Random) -> bytes:
    return data


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
        self._off_until = self._passive_until = -math.inf

    @property
    def bus_off(self) -> bool:
        """Whether the host's adapter is off the bus."""
        return self.time < self._off_until

    @property
    def error_passive(self) -> bool:
        """Whether the host's adapter is error passive."""
        return self.time < self._passive_until

    def take_off_bus(self, lasting: float = math.inf) -> None:
        """Let the adapter go bus-off: nothing passes either way."""
        self._off_until = self.time + lasting

    def make_passive(self, lasting: float = math.inf) -> None:
        """Let the adapter be error passive: frames still pass."""
        self._passive_until = self.time + lasting

    def clear(self) -> None:
        """End all damage."""
        self._rules.clear()
        self._off_until = self._passive_until = -math.inf

    def drop(self, cob_id: Ids = None, **when: Unpack[When]) -> None:
        """Lose frames."""
        self._add(cob_id, None, **when)

    def delay(self, cob_id: Ids = None, *, by: float, **when: Unpack[When]) -> None:
        """Deliver frames later by a time in s."""
        self._add(cob_id, delays=(by,), **when)

    def duplicate(self, cob_id: Ids = None, *, apart: float = 0.0, **when: Unpack[When]) -> None:
        """Deliver frames twice, a time in s apart."""
        self._add(cob_id, delays=(0.0, apart), **when)

    def truncate(self, cob_id: Ids = None, *, to: int, **when: Unpack[When]) -> None:
        """Cut frames to some bytes."""
        self._add(cob_id, lambda data, _: data[:to], **when)

    def overwrite(self, cob_id: Ids, *, at: int, data: bytes, **when: Unpack[When]) -> None:
        """Put other bytes into a part of frames, from byte ``at`` on."""
        end = at + len(data)
        self._add(cob_id, lambda old, _: old[:at] + data + old[end:], **when)

    def silence(self, node: int, **when: Unpack[When]) -> None:
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
                    (late + delay, each._replace(data=change(each.data, self._random)))
                    for late, each in copies
                    for delay in rule.delays
                ]
        return copies

    def _add(
        self,
        cob_id: Ids,
        change: Bytes | None = _same,
        delays: tuple[float, ...] = (0.0,),
        **when: Unpack[When],
    ) -> None:
        ids = [cob_id] if isinstance(cob_id, int) else cob_id
        chosen = None if ids is None else frozenset(ids)
        self._rules.append(Rule(chosen, change, delays, self.time, **when))
