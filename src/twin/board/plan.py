"""The motion that ``stable_inversion`` follows, in C: a part of its own, as no plan is a symbol.

A program on a board has no slices: in each period it samples the reference once, a preview ahead,
and sums the backward integral over it. Jumps and paths that need more than the plate gives, which
Python spreads and replaces, are refused; the distance of the ball from the path at the start is
spread in C too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.stable_inversion import StableInversion
from controllers.two_sided import inverse
from twin.base.errors import ScenarioError
from twin.board.control import Control


class Plan(NamedTuple):
    """Numbers of the motion's C code.

    Attributes:
        length: Control periods that are sampled in advance.
        slice_length: Control periods of a slice; the slowest speed ahead is found as it begins.
        zero: Z of ``TwoSided``, rad/s.
        decay: Its share that is left after a period.
        near: Weight of the nearer end of a line between two samples.
        far: Weight of its farther end.
        k1: Acceleration of the ball for a unit slope, m/s^2.
        smooth: Desired speed over which friction changes its sign, m/s.
        spread: Time in s over which a jump of ``jump_m`` is spread.
        jump_m: Length of a jump that is spread over that time, m.
        min_jump_m: Distance above which the ball at the start is off the path, m.
        dither: Amplitude of the dither, rad; 0 for none.
        dither_rate: Its rate, rad/s.
        dither_step: The same in rad per control period.
    """

    length: int
    slice_length: int
    zero: float
    decay: float
    near: float
    far: float
    k1: float
    smooth: float
    spread: float
    jump_m: float
    min_jump_m: float
    dither: float
    dither_rate: float
    dither_step: float

    @property
    def numbers(self) -> int:
        """Numbers that it keeps."""
        return 8 * self.length + 8


def plan_of(law: StableInversion, control: Control) -> Plan:
    """The numbers of a law's motion.

    Args:
        law: The law.
        control: The controller that it is part of.

    Raises:
        ScenarioError: If its preview is too short, or the reference is not followed as it is.
    """
    reference, period, x = control.reference, control.period, np.zeros(8)
    x[0::4] = reference(0.0)[0]
    plain = law.ahead(x, reference, period, feasible=False)
    if not plain.early:
        least = (law.slicing.periods + law.slicing.early_periods) * period
        raise ScenarioError(f"controller.preview: must be {least:g} s or more in C")
    times = period * np.arange(round(control.duration / period) + 2 * plain.length)
    apart = np.abs(plain.along(len(times)) - reference(times)[:3]).max(axis=(0, 2)) > 0
    if apart.any():
        raise ScenarioError(
            f"reference.kind: '{reference.name}' jumps at {times[apart.argmax()]:g} s, which "
            f"'{law.name}' has no form for in C"
        )
    x[0::4] = control.start
    path = law.ahead(x, reference, period, feasible=False).along(len(times))
    if not law.ahead(x, reference, period).able(path):
        raise ScenarioError(
            f"reference.kind: the path of '{reference.name}' from the ball's start needs more than "
            f"controller.slope or slope_rate, for which '{law.name}' has no form in C; begin on "
            "the path, or set both to 0 for no limit"
        )
    two_sided, jumps = inverse(law.model, plain, period), law.jumps
    return Plan(
        plain.length,
        plain.count,
        two_sided.Z,
        *two_sided.weights,
        law.model.k1,
        law.smooth,
        law.spread,
        jumps.reference_jump_m,
        jumps.min_jump_m,
        math.radians(law.dither_deg),
        2 * math.pi * law.dither_hz,
        2 * math.pi * law.dither_hz * period,
    )
