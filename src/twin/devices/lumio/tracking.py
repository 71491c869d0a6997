"""Which of the reported contacts is the ball, and whether it can be where it is reported.

Times are arrival times on any clock, in s; positions are in m in plate axes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.conditions import (
    DROPOUT,
    FROZEN,
    JUMP,
    RELOCATED,
    SWAPPED_AXES,
    TWO_CONTACTS,
)
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.lumio.decoder import Contact, Report
from twin.hal.interface import Condition

ReportFault = Callable[[Condition, str], None]
"""Takes a condition detected and what was seen, in words and numbers."""


class Sample(NamedTuple):
    """The newest accepted position.

    Attributes:
        time: When it arrived.
        position: Where, m in plate axes.
        lifted: Whether a lift-off has been reported since.
        since: Since when the position has not changed at all.
    """

    time: float
    position: tuple[float, float]
    lifted: bool
    since: float


class Tracker:
    """Follows one ball through the reports.

    Args:
        limits: What is plausible.
        calibration: Screen units to plate axes.
        report_fault: Called with each condition detected.
    """

    WINDOW = 0.05
    """Seconds over which the speed of a ball is judged."""

    def __init__(
        self, limits: PlausibilityLimits, calibration: Calibration, report_fault: ReportFault
    ) -> None:
        self._limits = limits
        self.calibration = calibration
        """Screen units to plate axes."""
        self._report_fault = report_fault
        self.forget()

    def forget(self) -> None:
        """Start again, as before the first touch."""
        self.sample: Sample | None = None
        self._id = 0
        self._live: dict[int, float] = {}
        self._crowd = 0
        self._waiting: list[tuple[float, tuple[float, float]]] = []
        self._path: list[tuple[float, tuple[float, float]]] = []
        self._same = 0
        self._swapped = False

    def take(self, time: float, report: Report) -> None:
        """Take in a report that arrived at a time."""
        down = [contact for contact in report if contact.down]
        for contact in report:
            if contact.down:
                self._live[contact.id] = time
            else:
                self._live.pop(contact.id, None)
                self._lift(contact.id)
        self._live = {
            name: seen for name, seen in self._live.items() if time - seen <= self._limits.stale
        }
        self._count(len(self._live), bool(down))
        if down:
            self._follow(time, down)

    def _lift(self, name: int) -> None:
        if self.sample is not None and name == self._id:
            self.sample = self.sample._replace(lifted=True)

    def _count(self, contacts: int, touching: bool) -> None:
        """Report several contacts once they stay."""
        if contacts < 2:
            self._crowd = 0
        elif touching:
            self._crowd += 1
            if self._crowd == 2:
                self._report_fault(TWO_CONTACTS, f"{contacts} contacts")

    def _follow(self, time: float, down: list[Contact]) -> None:
        last = self.sample
        if last is not None and time - last.time > self._limits.lost:
            last = None
        if last is None and self._swapped:
            return
        contact = self._nearest(last, down)
        if contact is None:
            return
        point = self.calibration.plate(contact.x, contact.y)
        if last is not None and self._continues(time, point, last):
            self._accept(time, contact.id, point, last)
        elif self._wait(time, point, last) and not self._leaves(time, contact, last):
            self._accept(time, contact.id, point, None)

    def _nearest(self, last: Sample | None, down: list[Contact]) -> Contact | None:
        """The contact that is the ball; None if these are others, the ball being touched too."""
        if last is None:
            return min(down, key=lambda contact: contact.id)
        here = last.position
        if self._id in self._live and all(contact.id != self._id for contact in down):
            return None
        return min(down, key=lambda one: math.dist(self.calibration.plate(one.x, one.y), here))

    def _continues(self, time: float, point: tuple[float, float], last: Sample) -> bool:
        """Whether a position goes on from the last one, not from the refused ones since."""
        if self._waiting:
            away = math.dist(point, last.position)
            if math.dist(point, self._waiting[-1][1]) < away:
                return False
        return self._reaches(time - last.time, last.position, point)

    def _wait(self, time: float, point: tuple[float, float], last: Sample | None) -> bool:
        """Keep a position that cannot be the ball yet; return whether it is confirmed by others."""
        if self._waiting:
            before, there = self._waiting[-1]
            gap = time - before
            if gap > self._limits.stale or not self._reaches(gap, there, point):
                self._waiting.clear()
        elif last is not None:
            self._report_fault(JUMP, f"from {_place(last.position)} to {_place(point)}")
        self._waiting.append((time, point))
        return len(self._waiting) >= self._limits.confirm

    def _leaves(self, time: float, contact: Contact, last: Sample | None) -> bool:
        """Report a confirmed jump; return whether its positions are to be refused."""
        if last is None:
            return False
        point = self.calibration.plate(contact.x, contact.y)
        turned = self.calibration.plate(contact.y, contact.x)
        words = f"from {_place(last.position)} to {_place(point)}"
        way, turned_way = math.dist(point, last.position), math.dist(turned, last.position)
        if turned_way > way / 2 or not self._reaches(time - last.time, last.position, turned):
            self._report_fault(RELOCATED, words)
            return False
        if not self._swapped:
            self._report_fault(SWAPPED_AXES, words)
        self._swapped = True
        return True

    def _accept(
        self, time: float, name: int, point: tuple[float, float], last: Sample | None
    ) -> None:
        since = time
        if last is None:
            self._path.clear()
            self._same = 0
        else:
            if time - last.time > self._limits.stale or last.lifted:
                self._report_fault(DROPOUT, f"no touch for {1000 * (time - last.time):.0f} ms")
            if point == last.position:
                since = last.since
        self._waiting.clear()
        self._swapped = False
        self._id = name
        self.sample = Sample(time, point, False, since)
        self._judge(time, point)

    def _judge(self, time: float, point: tuple[float, float]) -> None:
        """Report a ball that stops dead; its path ends where it was last seen to move."""
        if self._path and self._path[-1][1] == point:
            self._same += 1
            (first, begin), (end, stop) = self._path[0], self._path[-1]
            speed = math.dist(begin, stop) / (end - first) if end > first else 0.0
            if self._same == self._limits.still and speed > self._limits.halt:
                self._report_fault(FROZEN, f"stopped dead at {_place(point)} from {speed:.2f} m/s")
            return
        self._same = 0
        self._path = [entry for entry in self._path if time - entry[0] <= self.WINDOW]
        self._path.append((time, point))

    def _reaches(self, time: float, here: tuple[float, float], there: tuple[float, float]) -> bool:
        """Whether a ball can get from one place to another within a time in s."""
        return math.dist(here, there) <= self._limits.slack + self._limits.speed * time


def _place(point: tuple[float, float]) -> str:
    return f"({point[0]:.3f}, {point[1]:.3f}) m"
