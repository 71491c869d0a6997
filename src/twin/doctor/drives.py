"""The drives: bus, identities, state, heartbeat; with leave to move, direction and scale."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.protocol import DriveState, StatusBit, fault_words
from twin.devices.akd.servos import AkdServos
from twin.doctor.check import CheckResult, failed, noted, passed, reported, warned
from twin.doctor.steps import enable, exchange, hold_level, stopped_by, turn, until
from twin.hal.interface import Transmission

TILT = radians(1.0)
"""How far an axis is tilted to see its encoder's direction and scale."""
SCALE = 0.2
"""Share by which a scale may be wrong: play, cams of the model instead of the rig's."""
OTHER = radians(0.1)
"""Motion of the other axis's encoder that is no coupling between the axes."""


def bus(config: AkdConfig, servos: AkdServos) -> Iterator[CheckResult]:
    """Open the bus and bring the drives up; no torque. Leaves them started if all is well."""
    what = f"CAN bus {config.bus} at {config.bus.bitrate / 1e6:g} Mbit/s"
    try:
        servos.start()
    except DriveError as error:
        yield failed(what, str(error), error.fault.condition.recovery)
        return
    yield passed(what, "opened")
    exchange(servos, 0.1)
    trip = servos.round_trip
    if trip is not None:
        yield passed("bus round trip", f"{1e3 * trip:.2f} ms from SYNC to the last answer")
    for axis, found in zip(servos.axes, servos.found, strict=True):
        yield passed(f"{axis.config.where} units", found.units)
        yield passed(f"{axis.config.where} limits", found.limits)
        for each in found.preconditions:
            yield noted(f"{axis.config.where} {each.name}", each.seen, each.advice)
        yield passed(
            axis.config.where,
            f"an AKD, configured and monitored; {axis.state.value}",
        )
        if axis.state is DriveState.FAULT:
            advice = "remove the cause, then run with --reset"
            words = fault_words(found.faults) or "in fault"
            yield failed(f"{axis.config.where} fault", words, advice)
        elif not (axis.status or 0) & StatusBit.VOLTAGE:
            advice = "switch the main supply on; close the STO circuit"
            yield failed(f"{axis.config.where} power", "no DC link", advice)
        else:
            yield passed(f"{axis.config.where} power", "DC link up, no fault")
    for fault in servos.faults():
        yield warned(fault.where, f"{fault.condition.name}: {fault.detail}", "")


@reported("torque", "close STO, reset the faults (--reset)")
def torque(servos: AkdServos) -> Iterator[CheckResult]:
    """Torque at standstill; then let the heartbeat end: the drives must stop by themselves."""
    enable(servos)
    if not servos.enabled:
        states = ", ".join(axis.state.value for axis in servos.axes)
        yield failed("torque", f"not within 1 s ({states})", "check STO, enable input, supply")
        return
    yield passed("torque", "both drives hold their position")
    servos.heartbeat = False
    begin = servos.now()
    silence = servos.config.silence
    until(servos, lambda: not servos.enabled, silence + 0.2)
    took = servos.now() - begin
    if servos.enabled:
        advice = "do not run: set the heartbeat consumer (1016h) and its fault reaction"
        yield failed("heartbeat", f"ignored for {took:.2f} s: the drives go on", advice)
    else:
        seen = f"the drives stopped by themselves {1e3 * took:.0f} ms after it ended"
        yield passed("heartbeat", f"{seen} (set: {1e3 * silence:.0f} ms)")
    servos.start(reset=True)
    exchange(servos, 0.2)
    servos.faults()


@reported("motion", "reset the faults (--reset)")
def motion(servos: AkdServos, cams: Transmission) -> Iterator[CheckResult]:
    """Tilt each axis by a degree and back; its plate encoder must follow."""
    level = hold_level(servos, cams)
    for index, axis in enumerate(servos.axes):
        tilted = level.copy()
        tilted[0, index] = TILT
        before = servos.plate()[0]
        turned = turn(servos, cams.motor(level), cams.motor(tilted))
        moved = servos.plate()[0] - before
        if abs(moved[1 - index]) > max(OTHER, 2 * abs(moved[index])):
            yield _crossed(servos, index, moved)
            return
        if not turned:
            seen = stopped_by(servos) or "the drives went off"
            yield failed(f"{axis.config.name} encoder", seen, "see the fault")
            return
        turn(servos, cams.motor(tilted), cams.motor(level))
        yield _judged(axis.config.name, float(moved[index]))
    servos.quick_stop()
    exchange(servos, 0.1)


def _crossed(servos: AkdServos, index: int, moved: Array) -> CheckResult:
    name, other = servos.axes[index].config.name, servos.axes[1 - index].config.name
    own, crossed = np.degrees((moved[index], moved[1 - index]))
    seen = f"moving {name} turned {other}'s encoder by {crossed:+.3f} deg, its own by {own:+.3f}"
    advice = "exchange the plugs of the two plate encoders at the drives"
    return failed(f"{name} encoder", seen, advice)


def _judged(name: str, seen: float) -> CheckResult:
    text = f"plate turned {degrees(seen):+.3f} deg for {degrees(TILT):+.3f} deg commanded"
    what = f"{name} encoder"
    if seen < 0:
        return failed(what, text, f"wrong way: change {name}.plate_sign or {name}.motor_sign")
    if abs(seen / TILT - 1) > SCALE:
        advice = (
            f"check {name}.plate_counts, {name}.motor_counts, {name}.gear and the cam table; a "
            "little too far or too short may be lost motion (calibrate lost-motion)"
        )
        return failed(what, text, advice)
    return passed(what, text)
