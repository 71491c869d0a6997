"""Whether the drive called phi tilts the plate about phi: seen by a person, without a ball."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from math import radians
from threading import Thread

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.servos import AkdServos
from twin.doctor.check import Ask, CheckResult, failed, passed, warned
from twin.doctor.steps import enable, exchange, stopped_by, turn
from twin.errors import TwinError
from twin.hal.interface import Transmission

ROCK = radians(3.0)
"""How far the plate is rocked about phi, either way."""
TIMES = 2
EDGES = ("short", "long")
"""Edges that dip when the plate is tilted about phi, and about theta: x lies along the length."""


def swapped(servos: AkdServos, cams: Transmission, ask: Ask) -> Iterator[CheckResult]:
    """Rock the plate about phi alone and ask which edges dipped.

    A drive and its plate encoder change places together when two nodes are exchanged, and the cams
    are alike: no measurement without a ball tells phi from theta, but anybody who looks does.

    Args:
        servos: The drives, started, without torque.
        cams: Plate angles to motor angles.
        ask: Asked for ``watch`` before and ``edge`` after; the answer is one of ``EDGES``.
    """
    _answer(servos, ask, "watch")
    try:
        enable(servos)
    except TwinError as error:
        yield failed("which drive is phi", str(error), "reset the faults (--reset)")
        return
    level: Array = np.zeros((1, 2))
    servos.home(level, cams.motor(level))
    there: Array = np.array([[ROCK, 0.0]])
    for start, end in pairwise([level, *(there, -there) * TIMES, level]):
        if not turn(servos, cams.motor(start), cams.motor(end)):
            why = stopped_by(servos) or "the drives went off"
            yield failed("which drive is phi", why, "see the fault")
            return
    servos.quick_stop()
    exchange(servos, 0.1)
    yield _judged(_answer(servos, ask, "edge"))


def _answer(servos: AkdServos, ask: Ask, word: str) -> str:
    """What the person says, empty if there is nobody to ask; takes as long as they do.

    The drives are kept company meanwhile, or they would fault.
    """
    said: list[str] = []

    def asking() -> None:
        with suppress(Exception):  # of whatever kind: there is no answer
            said.append(ask(word))

    asked = Thread(target=asking, daemon=True)
    asked.start()
    while asked.is_alive():
        exchange(servos, servos.config.period)
    return said[0].strip().lower() if said else ""


def _judged(edge: str) -> CheckResult:
    what = "which drive is phi"
    if edge == EDGES[0]:
        return passed(what, "the short edges dipped when phi was moved")
    if edge == EDGES[1]:
        seen = "the long edges dipped when phi was moved: the drives are exchanged"
        return failed(what, seen, "exchange phi.node and theta.node in the rig file")
    return warned(what, "not answered with short or long", "watch the plate and answer")
