"""The drives: bus, state, heartbeat; with permission to move: limits, direction, scale, axes.

Measurements for a rig's files: cam table, lost motion, touch calibration.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import degrees, radians
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.base.errors import RigError
from twin.base.jobs import wait_until
from twin.devices.akd.conditions import INTERNAL_LIMIT, RUNAWAY, DriveError
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.protocol import DriveState, StatusBit, fault_words
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.conditions import TWO_CONTACTS
from twin.devices.lumio.config import (
    Calibration,
    CalibrationError,
    CalibrationFit,
    LumioConfig,
    PlausibilityLimits,
    fit,
)
from twin.devices.lumio.screen import LumioScreen, Sample, TouchState
from twin.doctor.check import (
    Ask,
    CheckResult,
    CheckStatus,
    fail_check,
    note_check,
    pass_check,
    warn_check,
)
from twin.hal.cams import CamTable
from twin.hal.interface import AXIS_NAMES, SCREEN_SIZE_M, Severity, Transmission
from twin.identify.plate_motion import LostMotion, as_plate, lost_motion, triangle

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


@dataclass(frozen=True, kw_only=True)
class CamSweep:
    """How the cams are measured.

    Attributes:
        rate_rad_s: Mean rate of the plate from point to point, rad/s; the largest is pi / 2 times
            that, as the motion is half a cosine.
        min_move_s: Shortest duration in s of a move.
        settle_s: Time in s for which the plate rests before its angles are read.
        read_periods: Periods over which they are averaged, against counts and noise of the
            encoder.
        degree: Degree of the polynomial for the deviation of the rig from the table.
    """

    rate_rad_s: float = radians(10.0)
    min_move_s: float = 0.2
    settle_s: float = 0.1
    read_periods: int = 25
    degree: int = 3


CAM_SWEEP = CamSweep()


def measure_cams(
    servos: AkdServos,
    known: CamTable | None = None,
    *,
    reach: float,
    lines: int,
    progress: Callable[[float], None] = lambda _: None,
    sweep: CamSweep = CAM_SWEEP,
) -> CamTable:
    """Measure the cams with the ball off the plate, which is level at the beginning.

    Args:
        servos: The drives, not started.
        known: Table by which the points are approached; the model's by default.
        reach: Largest plate angle either way, rad.
        lines: Points along each axis.
        progress: Called with the number of points done.
        sweep: Constants of the measurement.

    Returns:
        The table; its provenance has the number of points, the largest difference of plate angles
        to the known table and the root mean square that this one leaves, both in deg.

    Raises:
        RigError: The drives lost their torque during the measurement.
        DriveError: They cannot be brought up.
    """
    known = known or CamTable.packaged()
    servos.start()
    try:
        motor, plate = _read_points(servos, known, _path(reach, lines), progress, sweep)
    finally:
        servos.stop()
    off = motor - known.motor(plate)
    basis = _powers(plate, sweep.degree)
    weights = np.linalg.lstsq(basis, off, rcond=None)[0]
    left = (off - basis @ weights) / known.ratio
    nodes = np.stack(np.meshgrid(known.grid, known.grid, indexing="ij"), axis=-1)
    # beyond the reached angles the difference keeps its value at their edge
    angles = known.angles + _powers(np.clip(nodes, -reach, reach), sweep.degree) @ weights
    provenance: dict[str, Any] = {
        "made": "measured on a rig",
        "date": time.strftime("%Y-%m-%d"),
        "points": len(plate),
        "reach_deg": round(degrees(reach), 3),
        "before_deg": round(float(np.degrees(np.abs(off).max() / known.ratio)), 5),
        "rms_deg": round(float(np.degrees(np.sqrt(np.mean(left**2)))), 5),
    }
    return CamTable(known.grid, angles, provenance)


def _read_points(
    servos: AkdServos,
    known: CamTable,
    points: list[Array],
    progress: Callable[[float], None],
    sweep: CamSweep,
) -> tuple[Array, Array]:
    """Motor and plate angles at points and at the level plate, shape (points + 1, 2) each."""
    here = level = hold_level(servos, known)
    motor: list[Array] = []
    plate: list[Array] = []
    for goal in (*points, level):
        distance = 2 * float(np.abs(goal - here).max())
        seconds = max(sweep.min_move_s, distance / sweep.rate_rad_s)
        if not turn(servos, known.motor(here), known.motor(goal), seconds):
            raise RigError(f"measuring the cams was stopped: {stopped_by(servos) or 'drives off'}")
        exchange(servos, sweep.settle_s)
        read: Array = np.zeros((2, 2))
        for _ in range(sweep.read_periods):
            exchange(servos, servos.config.period)
            read = read + np.concatenate((servos.motor(), servos.plate())) / sweep.read_periods
        motor.append(read[0])
        plate.append(read[1])
        here = goal
        progress(len(plate))
    return np.array(motor), np.array(plate)


def _path(reach: float, lines: int) -> list[Array]:
    """Points line by line, there and back, so that each move is short."""
    steps = np.linspace(-reach, reach, lines)
    return [
        np.array([[phi, theta]])
        for index, phi in enumerate(steps)
        for theta in (steps if index % 2 == 0 else steps[::-1])
    ]


def _powers(plate: Array, degree: int) -> Array:
    """The monomials of both plate angles up to a degree, shape (..., monomials)."""
    phi, theta = plate[..., 0], plate[..., 1]
    return np.stack(
        [phi**i * theta**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1
    )


PROGRESS_STEPS = 100
"""Calls of ``progress`` for each axis, about."""


def measure_lost_motion(
    servos: AkdServos,
    known: CamTable,
    *,
    amplitude: float,
    rate: float = radians(1.0),
    cycles: int = 3,
    progress: Callable[[float], None] = lambda _: None,
) -> list[LostMotion]:
    """Lost motion of both axes with the ball off the plate, which is level at the beginning.

    Args:
        servos: The drives, not started.
        known: The cam table.
        amplitude: Plate angle of the triangle, rad.
        rate: Plate rate, rad/s.
        cycles: Whole cycles of each axis, 2 or more, after a quarter.
        progress: Called with the share done, 0 to 1.

    Raises:
        RigError: The drives lost their torque during it, or the plate did not move.
        DriveError: They cannot be brought up.
    """
    path = triangle(amplitude, rate, cycles, servos.config.period)
    paths = np.zeros((len(AXIS_NAMES), len(path), 1, 2))
    for axis in range(len(AXIS_NAMES)):
        paths[axis, :, 0, axis] = path
    goals, level = known.motor(paths), known.motor(np.zeros((1, 2)))
    read = []
    servos.start()
    try:
        hold_level(servos, known)
        for axis, goal in enumerate(goals):
            read.append(_record_motion(servos, goal, axis, progress))
            if not turn(servos, servos.motor(), level):
                raise _stopped_error(servos)
    finally:
        servos.stop()
    # not before: what computes does not keep the drives' heartbeat
    return [
        lost_motion(name, as_plate(known, motor, axis), plate, cycles)
        for axis, (name, (motor, plate)) in enumerate(zip(AXIS_NAMES, read, strict=True))
    ]


def _record_motion(
    servos: AkdServos, goals: Array, axis: int, progress: Callable[[float], None]
) -> tuple[Array, Array]:
    """Angles of one axis's motor and plate, rad, once a period, shape (K,) each."""
    count, period = len(goals) - 1, servos.config.period
    motor, plate = np.empty(count), np.empty(count)
    for k in range(count):
        if not servos.enabled:
            raise _stopped_error(servos)
        ahead = (goals[k + 1] - goals[k]) / period
        servos.command(ahead + FOLLOWING_GAIN_PER_S * (goals[k] - servos.motor()))
        exchange(servos, period)
        motor[k], plate[k] = servos.motor()[0, axis], servos.plate()[0, axis]
        if k % max(1, count // PROGRESS_STEPS) == 0:
            progress((axis + k / count) / len(AXIS_NAMES))
    servos.command(np.zeros((1, 2)))
    return motor, plate


def _stopped_error(servos: AkdServos) -> RigError:
    return RigError(f"the triangle was stopped: {stopped_by(servos) or 'drives off'}")


@dataclass(frozen=True, kw_only=True)
class TouchMeasurement:
    """How the calibration of a touch screen is measured.

    Attributes:
        point_span: Share of the screen's sides that the usual points span.
        reports: Number of consecutive reports that are averaged for a point, a third of a second.
        max_spread: Spread of these, in sides of the screen, above which the touch is still settling
            or moving.
        max_mark_error_m: Largest distance in m by which a finger or a ball misses a mark (assumed).
    """

    point_span: float = 0.8
    reports: int = 20
    max_spread: float = 0.003
    max_mark_error_m: float = 0.003


TOUCH_MEASUREMENT = TouchMeasurement()
SCREEN_UNITS = Calibration(((1.0, 0.0), (0.0, 1.0)), (0.0, 0.0))
"""The calibration that leaves positions in sides of the screen."""


def usual_points(measurement: TouchMeasurement = TOUCH_MEASUREMENT) -> list[tuple[float, float]]:
    """Nine points in rows over most of the screen, m in plate axes."""
    x, y = (round(measurement.point_span * side / 2, 3) for side in SCREEN_SIZE_M)
    return [(i * x, j * y) for j in (-1, 0, 1) for i in (-1, 0, 1)]


def measure_touch(
    config: LumioConfig,
    points: Sequence[tuple[float, float]],
    ask: Ask,
    patience: float,
    progress: Callable[[float], None] = lambda _: None,
    measurement: TouchMeasurement = TOUCH_MEASUREMENT,
) -> CalibrationFit:
    """Request touches of points in turn and fit the calibration to what the screen reports.

    Args:
        config: The screen's settings; its calibration is not used.
        points: Where to touch, m in plate axes.
        ask: Requests a touch, ``touch X Y`` in mm, and its end, ``lift``.
        patience: Longest time in s that each of these is waited for.
        progress: Called with the number of points done.
        measurement: Constants of the measurement.

    Raises:
        CalibrationError: Points were touched wrongly.
        RigError: The screen cannot be opened, or a point was not touched.
    """
    goals = np.array(points, float).reshape(-1, 2)
    gate = PlausibilityLimits()
    screen = LumioScreen(replace(config, calibration=SCREEN_UNITS, gate=gate))
    seen = []
    with screen:
        for index, goal in enumerate(goals):
            words = place(goal)
            ask(f"touch {1e3 * goal[0]:g} {1e3 * goal[1]:g}")
            seen.append(_measure_touch(screen, words, patience, measurement))
            ask("lift")
            if not wait_until(lambda: screen.state is TouchState.LOST, patience):
                raise RigError(f"calibration: {words} was not released within {patience:g} s")
            progress(index + 1)
    return fit_calibration(np.array(seen), goals, measurement)


def fit_calibration(
    seen: Array, points: Array, measurement: TouchMeasurement = TOUCH_MEASUREMENT
) -> CalibrationFit:
    """The calibration of touched points.

    Args:
        seen: Positions that the screen reported, screen units, shape (K, 2).
        points: The same points on the plate, m, shape (K, 2).
        measurement: Constants of the measurement.

    Raises:
        CalibrationError: They do not fit together; the one with the largest error is named.
    """
    found, largest = fit(seen, points), measurement.max_mark_error_m
    worst = int(found.distances.argmax())
    if found.distances[worst] > largest:
        raise CalibrationError(
            f"calibration: the points contradict one another: {worst + 1}, "
            f"{place(points[worst])}, is {1e3 * found.distances[worst]:.1f} mm off, at most "
            f"{1e3 * largest:g}; touch them in the order in which they are requested"
        )
    return found


def place(point: Array) -> str:
    """A point of the plate in words."""
    return f"x {1e3 * point[0]:+.0f}, y {1e3 * point[1]:+.0f} mm"


def _measure_touch(
    screen: LumioScreen, words: str, patience: float, measurement: TouchMeasurement
) -> tuple[float, float]:
    """The mean position of a steady touch, screen units."""
    before = screen.stream.tracker.sample
    kept: list[Sample] = []

    def steady() -> bool:
        sample, last = screen.stream.tracker.sample, kept[-1] if kept else before
        if any(fault.condition is TWO_CONTACTS for fault in screen.faults()):
            kept.clear()
        elif sample is not None and (last is None or sample.time > last.time):
            if kept and sample.time - kept[-1].time > screen.config.gate.lost:
                kept.clear()
            kept.append(sample)
            del kept[: -measurement.reports]
        if len(kept) < measurement.reports:
            return False
        spread = np.ptp([each.position for each in kept], axis=0).max()
        return bool(spread < measurement.max_spread)

    if not wait_until(steady, patience):
        hint = f"; {screen.hint}" if screen.hint and not kept else ""
        what = "touched steadily" if kept else "touched"
        raise RigError(f"calibration: {words} was not {what} within {patience:g} s{hint}")
    x, y = np.mean([each.position for each in kept], axis=0).tolist()
    return x, y
