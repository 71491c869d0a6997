"""A law with a control period of its own: evaluated each k-th tick, its command held between."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Feedback, Law, Reference


class HeldCommand:
    """What is held in one run.

    Args:
        plan: The law's own.
        period: Of the law, s.
    """

    def __init__(self, plan: Any, period: float) -> None:
        self.plan = plan
        self.u: Array = np.zeros(2)
        """Plate accelerations in rad/s^2, shape (..., 2)."""
        self._period = period
        self._number = -1

    def due(self, t: float) -> bool:
        """Whether a time in s is the first asked for of one of the law's periods."""
        number = math.floor(t / self._period + 1e-6)
        before, self._number = self._number, number
        return number != before


class HeldLaw(Law):
    """Another law behind a zero-order hold of its command.

    It is evaluated at the first tick of each of its periods k T, which are counted from time 0, and
    plans for them. Observer and memory go on at every tick T.

    Args:
        law: The law.
        ticks: k, control periods of the rig in one of the law's.
    """

    law: Law
    ticks: int

    def __init__(self, law: Law, ticks: int) -> None:
        own = {each: getattr(law, each) for each in ("name", "memory", "needs", "model")}
        for name, value in {**own, "law": law, "ticks": ticks}.items():
            object.__setattr__(self, name, value)

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations of the law itself, not held, rad/s^2, shape (..., 2)."""
        return self.law.control(t, x, reference, q)

    def memory_rate(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Time derivative of the memory q, shape (..., memory)."""
        return self.law.memory_rate(t, x, reference, q)

    def start(self, x: Array, reference: Reference, period: float) -> HeldCommand:
        """The law's plan for its own period, and nothing held yet."""
        own = self.ticks * period
        return HeldCommand(self.law.start(x, reference, own), own)

    def command(self, now: Feedback) -> Array:
        """Plate accelerations in rad/s^2, shape (..., 2): new ones when it is time."""
        held: HeldCommand = now.plan
        if held.due(now.time):
            held.u = self.law.command(now._replace(plan=held.plan))
        return held.u

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a report should tell of the law, and that no analysis knows of its hold."""
        unheld = (
            f"The law is evaluated every {self.ticks} control periods and held between; poles, "
            "margins and warnings of the linear loop leave this hold out and take it at every one."
        )
        return (*self.law.remarks, unheld)
