"""Gain, phase, delay and disk margin of a loop where it is cut."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.analysis.loops import Loop


class Margins(NamedTuple):
    """How far a stable loop is from instability at one cut; None where nothing destabilises it.

    Attributes:
        gain_down: The loop gain may fall to this factor, below 1.
        gain_up: The loop gain may rise to this factor.
        phase: Phase in deg that may be lost or won.
        disk: alpha of the symmetric disk: gain and phase may change together by any factor
            (1 + d/2) / (1 - d/2) with |d| < alpha.
        delay: Additional dead time in s.
        crossover: Highest frequency of gain 1 in rad/s.
    """

    gain_down: float | None
    gain_up: float | None
    phase: float | None
    disk: float
    delay: float | None
    crossover: float | None


def margins(loop: Loop, cut: str, *, points: int = 300) -> Margins | None:
    """Margins of a loop at one of its cuts, the other ones closed.

    Args:
        loop: The closed loop.
        cut: One of its cuts.
        points: Frequencies to evaluate, from 0.01 rad/s to the sampling limit or 1000 rad/s.

    Returns:
        The margins, or None if the closed loop is not stable.
    """
    import control  # noqa: PLC0415  heavy: loaded when needed

    if loop.poles()[0].real >= 0:
        return None
    highest = 0.999 * math.pi / loop.period if loop.period else 1e3
    omega = np.geomspace(0.01, highest, points)
    S = loop.sensitivity(cut, omega)
    gains, phases, _, _, crossovers, _ = control.stability_margins(
        control.FRD(1 / S - 1, omega), returnall=True
    )
    return Margins(
        gain_down=max((float(g) for g in gains if g < 1), default=None),
        gain_up=min((float(g) for g in gains if g > 1), default=None),
        phase=min((abs(float(p)) for p in phases), default=None),
        disk=float(1 / np.abs(S - 0.5).max()),
        # A dead time only turns the loop clockwise: a margin of -30 deg is one of 330 deg to it.
        delay=min(
            (float(math.radians(p % 360) / w) for p, w in zip(phases, crossovers, strict=True)),
            default=None,
        ),
        crossover=max((float(w) for w in crossovers), default=None),
    )
