"""The drives: bus, state, heartbeat; with leave to move: limits, direction, scale, axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from math import degrees, radians

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.conditions import INTERNAL_LIMIT, RUNAWAY, DriveError
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.protocol import DriveState, StatusBit, fault_words
from twin.devices.akd.servos import AkdServos
from twin.doctor.check import CheckResult, CheckStatus, failed, noted, passed, warned
from twin.hal.interface import Severity, Transmission


def turn(servos: AkdServos, start: Array, end: Array, seconds: float = 1.0) -> bool:
    """Turn the shafts from one angle to another, smoothly; whether the drives kept going."""
    begin = servos.now()
    while servos.enabled and (gone := servos.now() - begin) < seconds + 0.3:
        # half a cosine: from rest to rest
        share = (1 - np.cos(np.pi * min(1.0, gone / seconds))) / 2
        servos.command(20 * (start + share * (end - start) - servos.motor()))
        exchange(servos, servos.config.period)
    servos.command(np.zeros((1, 2)))
    exchange(servos, 0.05)
    return servos.enabled


def enable(servos: AkdServos) -> None:
    """Ask for torque, and exchange until both drives have it, at most for a second."""
    servos.enable()
    exchange(servos, 1.0, lambda: servos.enabled)


def hold_level(servos: AkdServos, cams: Transmission) -> Array:
    """Ask for torque, and take the plate as level; level plate angles in rad, shape (1, 2)."""
    enable(servos)
    level = np.zeros((1, 2))
    servos.home(level, cams.motor(level))
    return level


def stopped_by(servos: AkdServos) -> str:
    """The first fault that is more than a warning; empty if there is none."""
    return next((str(f) for f in servos.faults() if f.condition.severity != "warning"), "")


def exchange(servos: AkdServos, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
    """Go on in real time for a time in s, at least one period, or until something is done."""
    period = servos.config.period
    for _ in range(max(1, round(seconds / period))):
        if done():
            return
        begin = servos.now()
        servos.receive()
        servos.send()
        servos.settle(period / 2)
        servos.sleep(max(0.0, begin + period - servos.now()))


LOOKS = {"phi": "the end at larger x goes down", "theta": "the end at larger y goes up"}
"""What is to be seen of a positive angle. A drive and its encoder change places together, and the
cams are alike: no measurement without a ball tells phi from theta, but anybody who looks does."""
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
        for name, seen, advice in found.preconditions:
            yield noted(f"{axis.config.where} {name}", seen, advice)
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
    exchange(servos, silence + 0.2, lambda: not servos.enabled)
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
        yield _encoder(axis.config.name, float(moved[index]))
    servos.quick_stop()
    exchange(servos, 0.1)


def _crossed(servos: AkdServos, index: int, moved: Array) -> CheckResult:
    name, other = servos.axes[index].config.name, servos.axes[1 - index].config.name
    own, crossed = np.degrees((moved[index], moved[1 - index]))
    seen = f"moving {name} turned {other}'s encoder by {crossed:+.3f} deg, its own by {own:+.3f}"
    advice = "exchange the plugs of the two plate encoders at the drives"
    return failed(f"{name} encoder", seen, advice)


def _encoder(name: str, seen: float) -> CheckResult:
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
    look = f"{LOOKS[name]}, did it? if another end did, exchange phi.node and theta.node"
    return passed(what, f"{text}: {look}")


RATE, RAMP = 1.2, 50.0
"""Limits set for this, at the cam shafts in rad/s and rad/s^2."""
ASKED = 2.0
"""Rate asked for, rad/s: above the limit by less than what counts as not following."""
SECONDS = 0.1
"""Time in s; with the limit holding, the plate tilts by little more than a degree."""
SHARE = 0.25
"""Share by which the rate held may differ from the limit."""
FACTOR = 3.0
"""Factor by which the ramp may: the drive's own speed loop has a part in it."""
GAP = 0.01
"""Time in s between two answers above which nothing can be said of a ramp."""


def limits(servos: AkdServos) -> Iterator[CheckResult]:
    """Ask each drive for more than its limit; what it does tells what its counts mean.

    The drives are left started with the limits of their configuration, without torque.
    """
    usual = servos.config
    # A lower limit would narrow what counts as a plausible step of the encoder, too.
    watch = replace(usual.watch, jump=10.0, slack=(0.1, 0.1))
    servos.config = replace(usual, rate_limit=RATE, ramp=RAMP, watch=watch)
    try:
        servos.start()
        enable(servos)
        for index, axis in enumerate(servos.axes):
            times, rates = _asked(servos, index, ASKED)
            _asked(servos, index, -ASKED)
            faults = servos.faults()
            stops = (each for each in faults if each.condition.severity is Severity.STOP)
            stop = next(stops, None)
            if stop is None or stop.condition is RUNAWAY:
                shown = any(each.condition is INTERNAL_LIMIT for each in faults)
                result = _limit(axis.config.name, times, rates)
                bit = f"internal limit (bit 11) {'shown' if shown else 'not shown'}"
                result = result._replace(seen=f"{result.seen}; {bit}")
            else:
                result = failed(f"{axis.config.name} limits", str(stop), "see the fault")
            yield result
            if result.status is CheckStatus.FAIL:
                return
        servos.quick_stop()
        exchange(servos, 0.1)
    finally:
        servos.config = usual
        servos.stop()
    servos.start()


def _asked(servos: AkdServos, index: int, rate: float) -> tuple[Array, Array]:
    """Times in s and rates in rad/s while one axis is asked for a rate; then it stands again."""
    axis = servos.axes[index]
    samples: list[tuple[float, float]] = []
    for seconds, target in ((SECONDS, rate), (0.1, 0.0)):
        axis.target = target
        for _ in range(round(seconds / servos.config.period)):
            exchange(servos, servos.config.period)
            if target and (not samples or axis.plate.sampled > samples[-1][0]):
                samples.append((axis.plate.sampled, axis.rate))
    times, rates = np.array(samples).T
    return times, rates


def _limit(name: str, times: Array, rates: Array) -> CheckResult:
    what = f"{name} limits"
    if len(times) < 2 or np.diff(times).max() > GAP:
        apart = 1e3 * (np.diff(times).max() if len(times) > 1 else SECONDS)
        seen = f"answers up to {apart:.0f} ms apart: too irregular to judge"
        return warned(what, seen, "close other programs, then repeat")
    held = float(np.median(rates[len(rates) // 2 :]))
    begin, end = (float(times[np.argmax(rates >= share * held)]) for share in (0.1, 0.9))
    ramp = 0.8 * held / max(end - begin, 1e-3)
    text = f"held {held:.2f} rad/s of {ASKED:g} asked for, limit {RATE:g}; ramp {ramp:.0f} rad/s^2"
    if abs(held / RATE - 1) > SHARE:
        advice = f"do not run: set {name}.limit_unit to what a count of VL.LIMITP (3622h) means"
        return failed(what, text, advice)
    if not RAMP / FACTOR < ramp < RAMP * FACTOR:
        advice = f"set {name}.acceleration_unit to what a count of 6083h means"
        return failed(what, f"{text}, set {RAMP:g}", advice)
    return passed(what, text)
