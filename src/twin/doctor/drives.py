"""The drives: bus, state, heartbeat; with permission to move: limits, direction, scale, axes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import degrees, radians
from typing import TYPE_CHECKING

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.conditions import INTERNAL_LIMIT, RUNAWAY, DriveError
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.protocol import DriveState, StatusBit, fault_words
from twin.doctor.check import (
    CheckResult,
    CheckStatus,
    fail_check,
    note_check,
    pass_check,
    warn_check,
)
from twin.hal.interface import Severity, Transmission

if TYPE_CHECKING:
    from twin.devices.akd.servos import AkdServos

FOLLOWING_GAIN_PER_S = 20.0
"""Commanded rate of a shaft per error of its angle, 1/s, in every motion of the doctor."""
TURN_END_S = 0.3
"""Time in s after a motion in which the shafts reach its end."""


def turn(servos: AkdServos, start: Array, end: Array, seconds: float = 1.0) -> bool:
    """Turn the shafts from a start angle to an end angle, smoothly; whether they kept torque."""
    begin = servos.now()
    while servos.enabled and (passed_s := servos.now() - begin) < seconds + TURN_END_S:
        # half a cosine: from rest to rest
        share = (1 - np.cos(np.pi * min(1.0, passed_s / seconds))) / 2
        goal = start + share * (end - start)
        servos.command(FOLLOWING_GAIN_PER_S * (goal - servos.motor()))
        exchange(servos, servos.config.period)
    servos.command(np.zeros((1, 2)))
    exchange(servos, 0.05)
    return servos.enabled


def enable(servos: AkdServos) -> None:
    """Request torque, and exchange until both drives have it, at most for a second."""
    servos.enable()
    exchange(servos, 1.0, lambda: servos.enabled)


def hold_level(servos: AkdServos, cams: Transmission) -> Array:
    """Request torque, and take the plate as level; level plate angles in rad, shape (1, 2)."""
    enable(servos)
    level = np.zeros((1, 2))
    servos.home(level, cams.motor(level))
    return level


def stopped_by(servos: AkdServos) -> str:
    """The first fault that is more than a warning; empty if there is none."""
    return next((str(f) for f in servos.faults() if f.condition.severity != "warning"), "")


def exchange(servos: AkdServos, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
    """Exchange with the drives for a time in s, at least one period, or until ``done``."""
    period = servos.config.period
    for _ in range(max(1, round(seconds / period))):
        if done():
            return
        begin = servos.now()
        servos.receive()
        servos.send()
        servos.settle(period / 2)
        servos.sleep(max(0.0, begin + period - servos.now()))


POSITIVE_ANGLE_HELP = {
    "phi": "the end at larger x goes down",
    "theta": "the end at larger y goes up",
}
"""What a person sees at a positive angle. A drive and its encoder change places together, and the
cams are alike: no measurement without a ball tells phi from theta, but a person who looks does."""


@dataclass(frozen=True, kw_only=True)
class EncoderTest:
    """How the plate encoders are tested.

    Attributes:
        tilt_rad: Angle in rad by which each axis is tilted, for direction and scale.
        max_scale_error: Relative error of a scale that is allowed: play, cams of the model instead
            of the rig's.
        max_cross_motion_rad: Motion in rad of the other axis's encoder that is no coupling between
            the axes.
        max_cross_motion_factor: Motion of the other axis's encoder, as a multiple of the own one's,
            that is allowed beyond that.
    """

    tilt_rad: float = radians(1.0)
    max_scale_error: float = 0.2
    max_cross_motion_rad: float = radians(0.1)
    max_cross_motion_factor: float = 2.0


ENCODER_TEST = EncoderTest()


def bus(config: AkdConfig, servos: AkdServos) -> Iterator[CheckResult]:
    """Open the bus and bring the drives up; no torque. Leaves them started if all is well."""
    what = f"CAN bus {config.bus} at {config.bus.bitrate / 1e6:g} Mbit/s"
    try:
        servos.start()
    except DriveError as error:
        yield fail_check(what, str(error), error.fault.condition.recovery)
        return
    yield pass_check(what, "opened")
    exchange(servos, 0.1)
    trip = servos.round_trip
    if trip is not None:
        yield pass_check("bus round trip", f"{1e3 * trip:.2f} ms from SYNC to the last answer")
    for axis, found in zip(servos.axes, servos.found, strict=True):
        yield pass_check(f"{axis.config.where} units", found.units)
        yield pass_check(f"{axis.config.where} limits", found.limits)
        for name, seen, advice in found.preconditions:
            yield note_check(f"{axis.config.where} {name}", seen, advice)
        yield pass_check(
            axis.config.where,
            f"an AKD, configured and monitored; {axis.state.value}",
        )
        if axis.state is DriveState.FAULT:
            advice = "remove the cause, then run with --reset"
            words = fault_words(found.faults) or "in fault"
            yield fail_check(f"{axis.config.where} fault", words, advice)
        elif not (axis.status or 0) & StatusBit.VOLTAGE:
            advice = "switch the main supply on; close the STO circuit"
            yield fail_check(f"{axis.config.where} power", "no DC link", advice)
        else:
            yield pass_check(f"{axis.config.where} power", "DC link up, no fault")
    for fault in servos.faults():
        yield warn_check(fault.where, f"{fault.condition.name}: {fault.detail}", "")


def torque(servos: AkdServos) -> Iterator[CheckResult]:
    """Torque at standstill; then let the heartbeat end: the drives must stop by themselves."""
    enable(servos)
    if not servos.enabled:
        states = ", ".join(axis.state.value for axis in servos.axes)
        yield fail_check("torque", f"not within 1 s ({states})", "check STO, enable input, supply")
        return
    yield pass_check("torque", "both drives hold their position")
    servos.heartbeat = False
    begin = servos.now()
    silence = servos.config.silence
    exchange(servos, silence + 0.2, lambda: not servos.enabled)
    took = servos.now() - begin
    if servos.enabled:
        advice = "do not run: set the heartbeat consumer (1016h) and its fault reaction"
        yield fail_check("heartbeat", f"ignored for {took:.2f} s: the drives go on", advice)
    else:
        seen = f"the drives stopped by themselves {1e3 * took:.0f} ms after it ended"
        yield pass_check("heartbeat", f"{seen} (set: {1e3 * silence:.0f} ms)")
    servos.start(reset=True)
    exchange(servos, 0.2)
    servos.faults()


def motion(
    servos: AkdServos, cams: Transmission, test: EncoderTest = ENCODER_TEST
) -> Iterator[CheckResult]:
    """Tilt each axis by a degree and back; its plate encoder must follow."""
    level = hold_level(servos, cams)
    for index, axis in enumerate(servos.axes):
        tilted = level.copy()
        tilted[0, index] = test.tilt_rad
        before = servos.plate()[0]
        turned = turn(servos, cams.motor(level), cams.motor(tilted))
        moved = servos.plate()[0] - before
        allowed = max(test.max_cross_motion_rad, test.max_cross_motion_factor * abs(moved[index]))
        if abs(moved[1 - index]) > allowed:
            yield _check_crossing(servos, index, moved)
            return
        if not turned:
            seen = stopped_by(servos) or "the drives went off"
            yield fail_check(f"{axis.config.name} encoder", seen, "see the fault")
            return
        turn(servos, cams.motor(tilted), cams.motor(level))
        yield _check_scale(axis.config.name, float(moved[index]), test)
    servos.quick_stop()
    exchange(servos, 0.1)


def _check_crossing(servos: AkdServos, index: int, moved: Array) -> CheckResult:
    name, other = servos.axes[index].config.name, servos.axes[1 - index].config.name
    own, crossed = np.degrees((moved[index], moved[1 - index]))
    seen = f"moving {name} turned {other}'s encoder by {crossed:+.3f} deg, its own by {own:+.3f}"
    advice = "exchange the plugs of the two plate encoders at the drives"
    return fail_check(f"{name} encoder", seen, advice)


def _check_scale(name: str, seen: float, test: EncoderTest) -> CheckResult:
    text = f"plate turned {degrees(seen):+.3f} deg for {degrees(test.tilt_rad):+.3f} deg commanded"
    what = f"{name} encoder"
    if not seen >= 0:
        return fail_check(what, text, f"wrong way: change {name}.plate_sign or {name}.motor_sign")
    if not abs(seen / test.tilt_rad - 1) <= test.max_scale_error:
        advice = (
            f"check {name}.plate_counts, {name}.motor_counts, {name}.gear and the cam table; a "
            "little too far or too short may be lost motion (calibrate lost-motion)"
        )
        return fail_check(what, text, advice)
    look = (
        f"{POSITIVE_ANGLE_HELP[name]}, did it? if another end did, exchange phi.node and theta.node"
    )
    return pass_check(what, f"{text}: {look}")


@dataclass(frozen=True, kw_only=True)
class LimitTest:
    """How the drives' limits of rate and acceleration are tested, at the cam shafts.

    Attributes:
        rate_limit_rad_s: Limit of the rate that is set for the test, rad/s.
        ramp_rad_s2: Limit of the acceleration that is set for the test, rad/s^2.
        requested_rate_rad_s: Requested rate, rad/s: above the limit by less than what counts as
            not following.
        duration_s: Time in s of a request; with the limit in force, the plate tilts by little more
            than a degree.
        stop_s: Time in s in which the shaft stops after a request.
        max_rate_error: Relative difference of the rate held from the limit that is allowed.
        max_ramp_factor: Factor by which the ramp may differ: the drive's own speed loop has a part
            in it.
        max_answer_gap_s: Time in s between two answers above which no ramp is computed.
        min_ramp_s: Shortest duration in s that is assumed for a ramp.
        ramp_shares: Shares of the rate held between which the ramp is measured.
        jump_factor: Factor of the rate limit that no encoder can pass during the test; larger than
            in a run, as the limit that is set for the test is smaller.
        jump_slack_rad: Motion of motor and plate, rad, that is no jump of an encoder during the
            test.
    """

    rate_limit_rad_s: float = 1.2
    ramp_rad_s2: float = 50.0
    requested_rate_rad_s: float = 2.0
    duration_s: float = 0.1
    stop_s: float = 0.1
    max_rate_error: float = 0.25
    max_ramp_factor: float = 3.0
    max_answer_gap_s: float = 0.01
    min_ramp_s: float = 1e-3
    ramp_shares: tuple[float, float] = (0.1, 0.9)
    jump_factor: float = 10.0
    jump_slack_rad: tuple[float, float] = (0.1, 0.1)


LIMIT_TEST = LimitTest()


def limits(servos: AkdServos, test: LimitTest = LIMIT_TEST) -> Iterator[CheckResult]:
    """Request more of each drive than its limit; its answer shows what its counts mean.

    The drives are left started with the limits of their configuration, without torque.
    """
    usual = servos.config
    # a lower limit would narrow what counts as a plausible step of the encoder, too
    watch = replace(usual.watch, jump=test.jump_factor, slack=test.jump_slack_rad)
    servos.config = replace(
        usual, rate_limit=test.rate_limit_rad_s, ramp=test.ramp_rad_s2, watch=watch
    )
    try:
        servos.start()
        enable(servos)
        for index, axis in enumerate(servos.axes):
            times, rates = _measure_step_response(servos, index, test, direction=1.0)
            _measure_step_response(servos, index, test, direction=-1.0)
            faults = servos.faults()
            stops = (each for each in faults if each.condition.severity is Severity.STOP)
            stop = next(stops, None)
            if stop is None or stop.condition is RUNAWAY:
                shown = any(each.condition is INTERNAL_LIMIT for each in faults)
                result = _check_limit(axis.config.name, times, rates, test)
                bit = f"internal limit (bit 11) {'shown' if shown else 'not shown'}"
                result = result._replace(seen=f"{result.seen}; {bit}")
            else:
                result = fail_check(f"{axis.config.name} limits", str(stop), "see the fault")
            yield result
            if result.status is CheckStatus.FAIL:
                return
        servos.quick_stop()
        exchange(servos, 0.1)
    finally:
        servos.config = usual
        servos.stop()
    servos.start()


def _measure_step_response(
    servos: AkdServos, index: int, test: LimitTest, *, direction: float
) -> tuple[Array, Array]:
    """Times in s and rates in rad/s under a requested rate of one axis, which is then stopped.

    Args:
        servos: The drives, with torque.
        index: The axis.
        test: The requested rate, and its duration.
        direction: 1 or -1.
    """
    axis = servos.axes[index]
    samples: list[tuple[float, float]] = []
    rate = direction * test.requested_rate_rad_s
    for seconds, target in ((test.duration_s, rate), (test.stop_s, 0.0)):
        axis.target = target
        for _ in range(round(seconds / servos.config.period)):
            exchange(servos, servos.config.period)
            if target and (not samples or axis.plate.sampled > samples[-1][0]):
                samples.append((axis.plate.sampled, axis.rate))
    times, rates = np.array(samples).T
    return times, rates


def _check_limit(name: str, times: Array, rates: Array, test: LimitTest) -> CheckResult:
    what = f"{name} limits"
    if len(times) < 2 or np.diff(times).max() > test.max_answer_gap_s:
        apart = 1e3 * (np.diff(times).max() if len(times) > 1 else test.duration_s)
        seen = f"answers up to {apart:.0f} ms apart: too irregular to judge"
        return warn_check(what, seen, "close other programs, then repeat")
    held = float(np.median(rates[len(rates) // 2 :]))
    low, high = test.ramp_shares
    begin, end = (float(times[np.argmax(rates >= share * held)]) for share in (low, high))
    ramp = (high - low) * held / max(end - begin, test.min_ramp_s)
    text = (
        f"held {held:.2f} rad/s of {test.requested_rate_rad_s:g} requested, "
        f"limit {test.rate_limit_rad_s:g}; ramp {ramp:.0f} rad/s^2"
    )
    if abs(held / test.rate_limit_rad_s - 1) > test.max_rate_error:
        advice = f"do not run: set {name}.limit_unit to what a count of VL.LIMITP (3622h) means"
        return fail_check(what, text, advice)
    if not 1 / test.max_ramp_factor < ramp / test.ramp_rad_s2 < test.max_ramp_factor:
        advice = f"set {name}.acceleration_unit to what a count of 6083h means"
        return fail_check(what, f"{text}, set {test.ramp_rad_s2:g}", advice)
    return pass_check(what, text)
