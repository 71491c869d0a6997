"""The supervisor: a state machine per rig, one table of transitions, and limits of commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, Number, column, constant, every, finite, put, some
from twin.hal.interface import (
    LEVEL_REACTION,
    NOMINAL_PERIOD,
    Clamp,
    Condition,
    Fault,
    Limits,
    Severity,
)


class State(IntEnum):
    """State of a rig.

    OFF: drives without torque. INITIALISING: devices are brought up, nothing is commanded.
    READY: drives on, plate held, waiting for an explicit start. RUNNING: follows the controller.
    HOLDING: the plate is levelled, then held. FAULT: zero rate at once, drives stopped.
    """

    OFF = 0
    INITIALISING = 1
    READY = 2
    RUNNING = 3
    HOLDING = 4
    FAULT = 5


class Event(StrEnum):
    """Event that changes a rig's state: a request of the program, or the reaction to a condition.

    INITIALISE, START and SWITCH_OFF are explicit requests, POWERED reports that the drives hold the
    plate, LEVEL and STOP are the reactions to a condition of that severity.
    """

    INITIALISE = "initialise"
    POWERED = "powered"
    START = "start"
    LEVEL = "level"
    STOP = "stop"
    SWITCH_OFF = "switch off"


TRANSITIONS = MappingProxyType(
    {
        (State.OFF, Event.INITIALISE): State.INITIALISING,
        (State.INITIALISING, Event.POWERED): State.READY,
        (State.INITIALISING, Event.STOP): State.FAULT,
        (State.INITIALISING, Event.SWITCH_OFF): State.OFF,
        (State.READY, Event.START): State.RUNNING,
        (State.READY, Event.LEVEL): State.HOLDING,
        (State.READY, Event.STOP): State.FAULT,
        (State.READY, Event.SWITCH_OFF): State.OFF,
        (State.RUNNING, Event.LEVEL): State.HOLDING,
        (State.RUNNING, Event.STOP): State.FAULT,
        (State.RUNNING, Event.SWITCH_OFF): State.OFF,
        (State.HOLDING, Event.STOP): State.FAULT,
        (State.HOLDING, Event.SWITCH_OFF): State.OFF,
        (State.FAULT, Event.SWITCH_OFF): State.OFF,
    }
)
"""Every transition; an event that is not listed for a state changes nothing. The only way out of
HOLDING and FAULT is switching off: a new run is needed to continue."""


BALL_LOST_AFTER_S = 0.1
"""Time in s without touch after which the ball counts as lost."""
BALL_SPEED_WINDOW_S = 0.04
"""Time in s over which the speed of the ball is measured."""

_RUN_AGAIN_RECOVERY = "bring ball and plate back, then run again"

BALL_OUTSIDE = Condition(
    "ball outside", Severity.LEVEL, NOMINAL_PERIOD, LEVEL_REACTION, _RUN_AGAIN_RECOVERY
)
BALL_FAST = Condition(
    "ball too fast", Severity.LEVEL, 2 * BALL_SPEED_WINDOW_S, LEVEL_REACTION, _RUN_AGAIN_RECOVERY
)
BALL_LOST = Condition(
    "ball lost",
    Severity.LEVEL,
    BALL_LOST_AFTER_S + NOMINAL_PERIOD,
    LEVEL_REACTION,
    _RUN_AGAIN_RECOVERY,
)
PLATE_TILTED = Condition(
    "plate past its limit", Severity.LEVEL, NOMINAL_PERIOD, LEVEL_REACTION, _RUN_AGAIN_RECOVERY
)
BAD_REQUEST = Condition(
    "controller failed",
    Severity.LEVEL,
    NOMINAL_PERIOD,
    LEVEL_REACTION,
    "fix the controller, then run again",
)
NOT_LEVELLING = Condition(
    "plate does not level",
    Severity.STOP,
    0.5,
    "zero rate, then no torque",
    "check signs and scales of the plate encoders with `ballplate doctor --move`, then run again",
)
INJECTED_BEGIN = "virtual rig: "
"""How the text of an event begins that notes a fault of a virtual rig on demand."""

RIG_CONDITIONS = (
    BALL_OUTSIDE,
    BALL_FAST,
    BALL_LOST,
    PLATE_TILTED,
    BAD_REQUEST,
    NOT_LEVELLING,
)
"""Conditions that the supervisor itself detects, simulated or not."""


class Note(NamedTuple):
    """A detected condition of a rig.

    Attributes:
        rig: Index of the rig.
        condition: The condition.
        text: The observation, in words and numbers.
    """

    rig: int
    condition: Condition
    text: str


@overload
def correct_angle(angle: float, drift: float, share: float) -> float: ...
@overload
def correct_angle(angle: Array, drift: Array, share: Number) -> Array: ...
def correct_angle(angle: Number, drift: Number, share: Number) -> Number:
    """The commanded plate angle, corrected by a share of its drift from the measured one.

    Args:
        angle: Integral of the commanded rates, rad, shape (N, 2) or a number.
        drift: Measured angle less this one, rad, likewise.
        share: Control period over the time constant of the correction.

    Returns:
        Angle in rad, likewise.
    """
    return angle + share * drift


class Supervisor:
    """Guards N rigs: one state each, one set of limits.

    Args:
        limits: Limits of commands.
        period: Control period in s.
        rigs: Number of rigs.
        late: Longest time in s from a command to the motion of the plate.
        grown: Further tilt in rad, in addition to the tilt of braking, that is allowed while a
            plate is levelled.
    """

    MAX_FURTHER_TILT_RAD = float(np.radians(1.0))
    """Default of ``grown``."""

    RATE_WINDOW_S = 0.01
    """Time in s over which the rate of the plate is measured when levelling begins."""

    ANGLE_SLACK_RAD = np.radians(0.5)
    """Angle in rad by which a measured plate angle may exceed the limit (encoder, spring)."""

    DRIFT_TIME_S = 0.1
    """Time constant in s with which the plate angle is corrected by the measured one, while the
    plate is not levelled for longer."""

    def __init__(
        self,
        limits: Limits,
        period: float,
        rigs: int = 1,
        *,
        late: float = 0.25,
        grown: float = MAX_FURTHER_TILT_RAD,
    ) -> None:
        self.limits = limits
        self._late, self._grown = late, grown
        self.state = np.full(rigs, State.OFF)
        self.reason = [""] * rigs
        """Reason why each rig holds or has a fault."""
        self.by_device = np.zeros(rigs, bool)
        """Whether the reason is a fault of a device."""
        self.rate: Array = np.zeros((rigs, 2))
        """Plate rate commanded last, rad/s."""
        self.angle: Array = np.zeros((rigs, 2))
        """Plate angle: integral of the commanded rates, corrected by the measured angle, rad."""
        self.axes = 2
        """Number of axes of the rigs; of 1 theta and y are always 0."""
        self.all_running = False
        """Whether every rig follows its controller."""
        self.notes: list[Note] = []
        """Detected conditions that were not yet taken out, oldest first."""
        self._clamp = Clamp(limits, period)
        self._period = constant(period)
        self._bounds: Array = np.empty((rigs, 4))
        self._bounds[:, 0::2] = np.add(limits.area, column(limits.margin))
        self._bounds[:, 1::2] = column(limits.angle) + self.ANGLE_SLACK_RAD
        self._bounds_of_one = self._bounds[0].tolist()
        self.drift_time = self.DRIFT_TIME_S
        self._unseen: float | Array = 0.0
        self._paces = max(1, round(BALL_SPEED_WINDOW_S / period))
        self._way = column(limits.ball_speed) * self._paces * period
        self._pace = 0
        self._before = np.full((rigs, 2), np.nan)
        self._largest = np.full((rigs, 2), np.nan)
        """Plate angles in rad that levelling may not exceed; NaN where nothing is levelled."""
        self._plates: deque[Array] = deque(maxlen=max(2, round(self.RATE_WINDOW_S / period)))
        """Measured plate angles of the last periods, rad, shape (N, 2)."""

    @property
    def drift_time(self) -> float:
        """Time in s within which a measured drift is taken in now."""
        return self._drift_time

    @drift_time.setter
    def drift_time(self, time: float) -> None:
        self._drift_time = time
        self._drift_share = self._period / time
        self._drift_share_of_one = float(self._drift_share)

    def limit_rate(self, rate: float | None) -> None:
        """Limit plate rates to this one in rad/s; None for those of the limits."""
        largest = self.limits.rate if rate is None else np.minimum(self.limits.rate, rate)
        self._clamp = Clamp(replace(self.limits, rate=np.asarray(largest)), float(self._period))

    def handle(self, event: Event, which: Mask | None = None) -> Mask:
        """Apply an event to some rigs, all by default; return which of them it changed."""
        changed = np.zeros(len(self.state), bool)
        old = self.state.copy()
        for rig in range(len(old)) if which is None else np.flatnonzero(which):
            new = TRANSITIONS.get((State(old[rig]), event))
            if new is not None:
                self.state[rig], changed[rig] = new, True
                if event is Event.INITIALISE:
                    self.reason[rig], self.by_device[rig] = "", False
        self.all_running = bool((self.state == State.RUNNING).all())
        return changed

    def powered(self, plate: Array) -> None:
        """The drives hold the plate at its measured angles (N, 2): wait for the start."""
        fresh = self.handle(Event.POWERED)[:, None]
        self.angle = np.where(fresh, plate, self.angle)
        self.rate = np.where(fresh, 0.0, self.rate)
        self._unseen, self.drift_time = 0.0, self.DRIFT_TIME_S
        self._plates.clear()
        self._before[:] = np.nan

    def adopt(self, rigs: NDArray[np.integer], other: Supervisor) -> None:
        """Replace the states of some rigs by those of others with the same limits.

        Args:
            rigs: Their indices.
            other: The supervisor of as many rigs, just started.
        """
        self.state = put(self.state, rigs, other.state)
        self.all_running = bool((self.state == State.RUNNING).all())
        self.by_device[rigs] = other.by_device
        for rig, reason in zip(rigs.tolist(), other.reason, strict=True):
            self.reason[rig] = reason
        self.rate, self.angle = put(self.rate, rigs, other.rate), put(self.angle, rigs, other.angle)
        self._unseen = put(np.broadcast_to(self._unseen, self.state.shape), rigs, other._unseen)
        self._before = put(self._before, rigs, other._before)
        self._largest = put(self._largest, rigs, other._largest)
        self._plates.clear()

    def forget_ball(self) -> None:
        """Forget earlier positions of the ball, as it was placed elsewhere."""
        self._unseen = 0.0
        self._pace = 0
        self._before[:] = np.nan

    def report(self, fault: Fault, rig: int = 0) -> None:
        """React to a fault of a device."""
        which = np.arange(len(self.state)) == rig
        self._answer(fault.condition, which, str(fault), by_device=fault.condition.device)

    @property
    def lost(self) -> Mask:
        """Whether the screen has not detected a ball for too long, shape (N,)."""
        return np.broadcast_to(np.greater(self._unseen, BALL_LOST_AFTER_S), self.state.shape)

    def watch(self, y: Array, touched: Mask) -> None:
        """Level the running rigs with a measured ball or plate beyond a limit.

        NaN counts as beyond its limit, except for a ball that is not detected.

        Args:
            y: Measured x, phi, y, theta in m and rad, shape (N, 4).
            touched: Whether the screen detects the ball, shape (N,).
        """
        plate = y[:, 1::2].copy()
        if len(y) == 1 and self._watch_one(y[0].tolist(), touched):
            self._unseen = 0.0
        else:
            self._watch_all(y, plate, touched)
        self._pace += 1
        if self._pace == self._paces:
            self._pace = 0
            self._watch_speed(y[:, 0::2], touched)
        self._plates.append(plate)
        if not self.all_running:
            self._watch_levelling(np.abs(plate))

    def _watch_one(self, y: Sequence[float], touched: Mask) -> bool:
        """Take in a measurement of the only rig in plain numbers; not if there is more to judge.

        Args:
            y: Measured x, phi, y, theta in m and rad.
            touched: Whether the screen detects the ball, shape (1,).

        Returns:
            Whether ball and plate are within their limits and the ball is detected; else nothing
            has been taken in.
        """
        (x, phi, across, theta), (most_x, most_phi, most_y, most_theta) = y, self._bounds_of_one
        ball = -most_x <= x <= most_x and -most_y <= across <= most_y
        plate = -most_phi <= phi <= most_phi and -most_theta <= theta <= most_theta
        if not (ball and plate and touched[0]):
            return False
        (a, b), share = self.angle[0].tolist(), self._drift_share_of_one
        angles = correct_angle(a, phi - a, share), correct_angle(b, theta - b, share)
        self.angle = np.array([angles])
        return True

    def _watch_all(self, y: Array, plate: Array, touched: Mask) -> None:
        """Take in measurements and judge them."""
        drift = plate - self.angle
        # of what is within its bounds nothing is infinite or no number
        within = np.abs(y) <= self._bounds
        if not every(within):
            drift = np.where(np.isfinite(drift), drift, 0.0)
            beyond = ~within
            beyond[:, 0::2] &= touched[:, None] | ~np.isnan(y[:, 0::2])
            outside, tilted = beyond[:, 0::2].any(axis=1), beyond[:, 1::2].any(axis=1)
            where = f"ball at {self._of_axes('.3f')} m left the area"
            self._judge(BALL_OUTSIDE, outside, y[:, 0::2], where)
            where = f"plate at {self._of_axes('.2f')} deg past its limit of {{:.4g}} deg"
            limit = self._bounds[:, 1:2] - self.ANGLE_SLACK_RAD
            shown = np.degrees(np.hstack((plate[:, : self.axes], limit)))
            self._judge(PLATE_TILTED, tilted, shown, where)
        self.angle = correct_angle(self.angle, drift, self._drift_share)
        if not every(touched):
            self._unseen = np.where(touched, 0.0, self._unseen + self._period)
            self._before = np.where(touched[:, None], self._before, np.nan)
            self._judge(BALL_LOST, self.lost, y, "the ball is no longer detected")
        else:
            self._unseen = 0.0

    def _watch_levelling(self, tilt: Array) -> None:
        """Stop the rigs with a plate that tilts further and further though it is levelled.

        Commands that have not reached the drives yet, and braking, may tilt it a little further.

        Args:
            tilt: Sizes of the measured plate angles in rad, shape (N, 2).
        """
        holding = (self.state == State.HOLDING)[:, None]
        since = self._period * max(1, len(self._plates) - 1)
        turned = np.abs(self._plates[-1] - self._plates[0]) / since
        turned = np.minimum(np.where(np.isnan(turned), 0.0, turned), column(self.limits.rate))
        rate = np.maximum(np.abs(self.rate), turned)
        way = rate * self._late + rate**2 / (2 * column(self.limits.acceleration))
        fresh = np.isnan(self._largest)
        further = holding & ~fresh & ~(tilt <= self._largest)
        begun = np.where(np.isnan(tilt), np.abs(self.angle), tilt) + way + self._grown
        self._largest = np.where(holding, np.where(fresh, begun, self._largest), np.nan)
        if some(further):
            which = further.any(axis=1)
            degrees = np.degrees(tilt)
            now = f"{self._of_axes('.2f')} deg by now"
            text = f"plate tilts further though it is levelled, {now}"
            self._judge(NOT_LEVELLING, which, degrees, text, State.HOLDING)

    def _watch_speed(self, ball: Array, touched: Mask) -> None:
        moved = np.abs(ball - self._before)
        # NaN, where the ball was not detected all the time, is never too fast
        fast = (moved > self._way).any(axis=1)
        if some(fast):
            speed = moved / (self._paces * self._period)
            self._judge(BALL_FAST, fast, speed, f"ball at {self._of_axes('.2f')} m/s is too fast")
        self._before = np.where(touched[:, None], ball, np.nan)

    def clamp(self, rate: Array) -> Array:
        """The plate rates that may be commanded for the requested ones, both rad/s, (N, 2).

        The result is within the limits of rate and acceleration, and can be braked before the angle
        limit; in a fault it is zero at once.
        """
        if not finite(rate):
            bad = np.asarray(~np.isfinite(rate).all(axis=-1))
            self._judge(BAD_REQUEST, bad, rate, f"controller asked for {self._of_axes('')} rad/s")
            rate = np.where(bad[:, None], 0.0, rate)
        if self.all_running:
            rate = self._clamp(rate, self.rate, self.angle)
        else:
            rate = self._overrule(rate)
        self.rate = rate
        self.angle = self.angle + self._period * rate
        return rate

    def _overrule(self, rate: Array) -> Array:
        """Rates of rigs of which not all run: level, hold, or zero, by their states."""
        state = self.state[:, None]
        held = np.where(state == State.HOLDING, self._clamp.towards_level(self.angle), 0.0)
        requested = np.where(state == State.RUNNING, rate, held)
        dead = (state == State.FAULT) | (state == State.OFF) | (state == State.INITIALISING)
        return np.where(dead, 0.0, self._clamp(requested, self.rate, self.angle))

    def _of_axes(self, form: str) -> str:
        """Where a text has a number of each axis, or the number of the only one."""
        each = f"{{:{form}}}"
        return f"({each}, {each})" if self.axes == 2 else each

    def _judge(
        self,
        condition: Condition,
        which: Mask | np.bool_,
        values: Array,
        text: str,
        state: State = State.RUNNING,
    ) -> None:
        """React to a condition of some rigs in a state, running ones by default."""
        for rig in np.flatnonzero(which & (self.state == state)):
            self._answer(
                condition, np.arange(len(self.state)) == rig, text.format(*values[rig].tolist())
            )

    def _answer(
        self, condition: Condition, which: Mask, text: str, *, by_device: bool = False
    ) -> None:
        event = {Severity.LEVEL: Event.LEVEL, Severity.STOP: Event.STOP}.get(condition.severity)
        changed = self.handle(event, which) if event else np.zeros_like(which)
        for rig in np.flatnonzero(which):
            self.notes.append(Note(int(rig), condition, text))
            if changed[rig]:
                self.reason[rig], self.by_device[rig] = text, by_device
