"""What a row of the fault matrix must keep, derived from what drives and host are set to.

Nothing here is measured but how the plate tilts and moves and where the ball rolls when the fault
begins: the time a stop takes follows from who has to stop the rig, the tilt and the way of the
ball follow from that time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.servos import SHUTDOWN
from twin.emulator.drive import COASTING, STOP_RAMP
from twin.hal.interface import SCREEN, Limits
from twin.hal.supervisor import Supervisor
from twin.safety.case import LEVEL, STILL, FaultCase, Stopper

RIG, BALL = Limits(), BallPlate()
ANGLE, RATE, ACCELERATION = float(RIG.angle), float(RIG.rate), float(RIG.acceleration)
BEYOND = ANGLE + Supervisor.ANGLE_SLACK
"""Largest plate angle in rad that the clamp and its slack for encoder and spring allow."""
RAMP = AkdConfig().rate_limit / STOP_RAMP
"""Time in s in which a drive brakes from its velocity limit with its quick stop ramp."""
LEAVING = 2 * SHUTDOWN + 0.05
"""Longest time in s from the end of a run to the host's last heartbeat: it waits for standstill,
then for no torque, then sends what is left."""

RAMPED = f"{1e3 * RAMP:g} ms of ramp from the velocity limit"


class Limit(NamedTuple):
    """A limit and where it comes from, in one line."""

    value: float
    why: str


@dataclass(frozen=True)
class AtFault:
    """The rig when a fault begins.

    Attributes:
        tilt: Larger plate angle, rad.
        rate: Larger plate rate, rad/s.
        ball: Distances from the centre along x and y, m, shape (2,).
        velocity: Speeds of the ball along x and y, m/s, shape (2,).
    """

    tilt: float
    rate: float
    ball: Array
    velocity: Array


def standstill(case: FaultCase, detected: float, at: AtFault) -> Limit | None:
    """Longest time in s from the fault to standstill; None where nothing has to stop.

    Args:
        case: The row.
        detected: Longest time to its detection, s.
        at: The rig at the fault.
    """
    times = [STOPS[each](case, detected, at) for each in case.stoppers if each in STOPS]
    return max(times) if times else None


def _quick_stopped(case: FaultCase, detected: float, _: AtFault) -> Limit:
    time = detected + 2 * case.host.period + RAMP
    return Limit(time, f"detection, two periods to the drives, {RAMPED}")


def _watched(case: FaultCase, detected: float, at: AtFault) -> Limit:
    if case.zeroed:
        return _quick_stopped(case, detected, at)
    return _unwatched(case, detected)


def _unwatched(case: FaultCase, detected: float) -> Limit:
    """Until a drive has no torque that watches the host."""
    watch = case.host.silence + case.host.period + RAMP
    if not case.withheld:
        return Limit(watch, f"the silence that the drives allow, one period, {RAMPED}")
    if case.host.watch.stop > LEAVING:
        why = f"detection, leaving the bus, silence, three periods, {RAMPED}"
        return Limit(detected + LEAVING + 2 * case.host.period + watch, why)
    why = f"detection, patience with the quick stop, silence, three periods, {RAMPED}"
    return Limit(detected + case.host.watch.stop + 2 * case.host.period + watch, why)


def _stopped_itself(case: FaultCase, _: float, __: AtFault) -> Limit:
    return Limit(case.host.period + RAMP, f"one period, {RAMPED}")


def _run_out(case: FaultCase, _: float, at: AtFault) -> Limit:
    rate = at.rate + 2 * ACCELERATION * case.host.period
    time = 2 * case.host.period + COASTING * math.log(max(rate / STILL, 1.0))
    why = f"two periods, then down to 1/e every {COASTING:g} s without torque"
    return Limit(time, why)


def _levelled(case: FaultCase, detected: float, at: AtFault) -> Limit:
    """Brake, turn back at the rate limit, then at the root of acceleration times angle."""
    angle, rate = tilt(case, detected, 0.0, at).value, _fastest(case, detected, at)
    last = 10 * case.host.period  # time constant of the last piece, see `Clamp.towards_level`
    back = min(RATE, math.sqrt(ACCELERATION * angle))
    time = (rate + back) / ACCELERATION
    time += max(0.0, angle - back**2 / ACCELERATION) / RATE + 2 * back / ACCELERATION
    time += last * math.log(ACCELERATION * last / STILL) + Supervisor.DRIFT_TIME
    why = "detection, braking, the way back from the largest tilt, the time of a measured drift"
    return Limit(detected + case.slow * time, why)


STOPS: dict[Stopper, Callable[[FaultCase, float, AtFault], Limit]] = {
    Stopper.LEVELLING: _levelled,
    Stopper.QUICK_STOP: _quick_stopped,
    Stopper.HEARTBEAT: _watched,
    Stopper.STO: _run_out,
    Stopper.LOST_TORQUE: _run_out,
    Stopper.DRIVE: _stopped_itself,
}
"""Longest time to standstill by who has to stop an axis, from case, detection in s and fault."""


def torque_off(case: FaultCase, detected: float, stop: Limit | None) -> Limit | None:
    """Longest time in s to no torque; None where the plate is held, or nothing has to stop."""
    if stop is None or Stopper.LEVELLING in case.stoppers:
        return None
    if case.zeroed:
        stop = _unwatched(case, detected)
    return Limit(stop.value + 2 * case.host.period, "two periods from standstill")


def tilt(case: FaultCase, detected: float, stop: float | None, at: AtFault) -> Limit:
    """Largest plate angle in rad after the fault.

    Args:
        case: The row.
        detected: Longest time to its detection, s.
        stop: Longest time to standstill, s; None where nothing has to stop.
        at: The rig at the fault.
    """
    if case.refused:
        return Limit(LEVEL, "nothing may move")
    if stop is None:
        return Limit(BEYOND, "the rig runs on: what the clamp allows")
    rate = _fastest(case, detected, at)
    if case.shoved:
        largest = at.tilt + case.speed * case.shoved + RATE * detected
        return Limit(largest, "tilt at the fault, the whole push, fastest rate until detection")
    if Stopper.LEVELLING in case.stoppers:
        way = rate * detected + rate**2 / (2 * ACCELERATION)
        why = "tilt at the fault, fastest rate until detection and braking; never past the clamp"
        return Limit(min(at.tilt + case.slow * way, BEYOND), why)
    largest = at.tilt + rate * stop
    if case.speed:
        return Limit(largest, "tilt at the fault, the fault's own rate until standstill")
    why = "tilt at the fault, fastest rate until standstill; never past the clamp"
    return Limit(min(largest, BEYOND), why)


def _fastest(case: FaultCase, detected: float, at: AtFault) -> float:
    """Fastest plate rate in rad/s that a controller reaches until the fault is detected."""
    return max(min(at.rate + ACCELERATION * detected, RATE), case.speed)


def ball(
    case: FaultCase, detected: float, stop: float | None, at: AtFault
) -> tuple[tuple[float, float], str]:
    """Farthest the ball may be from the centre along x and y until the plate stands, m, and why.

    Args:
        case: The row.
        detected: Longest time to its detection, s.
        stop: Longest time to standstill, s; None where nothing has to stop.
        at: The rig at the fault.
    """
    if stop is None:
        x, y = np.asarray(RIG.area, float).tolist()
        return (x, y), "the operating area"
    slope = BALL.k1 * math.sin(tilt(case, detected, stop, at).value)
    # A change of the plate's rate carries the ball along by c2 times it, (5.1).
    carried = 2 * BALL.c2 * _fastest(case, detected, at)
    way = at.ball + (at.velocity + carried) * stop + slope * stop**2 / 2
    if case.goes:
        x, y = way.tolist()
        return (x, y), "place and speed at the fault, slope of the largest tilt until standstill"
    x, y = np.minimum(way, np.array(SCREEN) / 2).tolist()
    why = "place and speed at the fault, slope of the largest tilt until standstill; on the plate"
    return (x, y), why
