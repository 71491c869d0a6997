"""How a run ended, and its performance indicators, each named for its quantity.

The thesis (Appendix C) judges single axes on x; so do the indicators below that say "on x".
Its "average tracking error" is a root mean square (rms_error here), not the mean of (C.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.hal.supervisor import State
from twin.run.indicators import LOST_ENDINGS, MOTION_INDICATORS
from twin.run.record import Recorder


class Ending(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    FELL = "fell"
    LOST = "lost"
    FAULT = "fault"
    ABORTED = "aborted"
    DIVERGED = "diverged"


INTERRUPTED_REASON = "interrupted"
"""The reason of a run that Ctrl-C ended."""
KILLED_REASON = "killed before its end; the record goes as far as it was written"
"""The reason of a run if its process or computer ended without writing one."""
RAN_AWAY = "the simulation's numbers ran away"
"""The reason of a run that diverged."""


@dataclass(frozen=True)
class Outcome:
    """How one rig's run ended, at what time in s, and why in words."""

    ending: Ending
    time: float
    reason: str = ""

    @property
    def interrupted(self) -> bool:
        """Whether a person ended the run."""
        return self.reason == INTERRUPTED_REASON


LEAST_WAY = 1e-3
"""Way to a goal in m from which overshoot and settling are shares of it: below, of the noise."""
STILL_SPEED_M_S = 1e-4
"""Speed in m/s below which a ball lies still: less than the screen can tell within a second."""
MAX_TURNING_TIME_S = 0.1
"""Time in s that no ball takes to turn: it passes through rest in some milliseconds."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Motion of a run: K instants of one rig.

    Attributes:
        time: Seconds, shape (K,).
        ball: True ball position in plate axes, m, shape (K, 2); of a real rig, where nobody knows
            it, the estimated one.
        plate: Plate angles (phi, theta) in rad, shape (K, 2).
        u: Applied plate accelerations in rad/s^2, shape (K, 2).
        reference: Desired ball position in m, shape (K, 2).
        held: Where friction held the ball at rest, shape (K,); None where nobody knows.
        lateness: By how much the applied command was late, s, shape (K,); None of a law that takes
            no time.
        board: Of a controller that is a program: its instructions, and the largest difference of
            its requested plate rates from those of Python, rad/s, shape (K, 2); else None.
    """

    time: Array
    ball: Array
    plate: Array
    u: Array
    reference: Array
    held: Mask | None = None
    lateness: Array | None = None
    board: Array | None = None

    @classmethod
    def of(
        cls,
        record: Recorder,
        desired: Array,
        rig: int = 0,
        *,
        friction: bool = False,
        seen: bool = False,
    ) -> Motion:
        """Motion of one rig of a record, given its reference positions, (K, 2).

        Args:
            record: The record.
            desired: Reference positions in m, shape (K, 2).
            rig: Which rig, from 0.
            friction: Whether its ball, if the truth is recorded, rolls with friction.
            seen: As the rig's computer sees it: ball as estimated, plate by its encoders.
        """
        # of many rigs a copy, as those of one lie far apart
        known = "state" in record.data and not seen
        state = record["state" if known else "estimate"][:, rig].copy()
        return cls(
            time=record.time,
            ball=state[:, 0::4],
            plate=record["measured"][:, rig, 1::2].copy() if seen else state[:, 2::4],
            u=record["applied"][:, rig].copy(),
            reference=desired,
            held=find_rest(record.time, state[:, 1::4]) if known and friction else None,
            lateness=record["computing"][:, rig, 1] if "computing" in record.data else None,
            board=None
            if "board" not in record.data
            else against_python(
                record["board"][:, rig],
                record["requested"][:, rig],
                record["supervisor"][:, rig, 0],
                record.period,
            ),
        )

    @property
    def error(self) -> Array:
        """Reference minus ball in m, shape (K, 2), (C.5) and (C.6)."""
        return self.reference - self.ball

    def until(self, end: float) -> Motion:
        """The motion up to a time in s."""
        count = int(np.searchsorted(self.time, end + 1e-9, side="right"))
        if count == len(self.time):
            return self
        cut: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self)}
        cut = {name: None if values is None else values[:count] for name, values in cut.items()}
        return Motion(**cut)


def against_python(board: Array, requested: Array, supervisor: Array, period: float) -> Array:
    """Instructions of a program, and the largest difference of its commands, shape (K, 2).

    Both controllers add a period of their acceleration to the same rate, so that the requested
    rates differ by a period of the difference. While the supervisor levels the plate, which the
    program is not informed of, there is none: NaN.

    Args:
        board: The channel ``board``, shape (K, 3).
        requested: Accelerations that the program requested, rad/s^2, shape (K, 2).
        supervisor: Its state, shape (K,).
        period: Control period in s.
    """
    difference = period * np.abs(requested - board[:, 1:]).max(axis=1)
    found = np.where(supervisor == State.RUNNING, difference, np.nan)
    return np.stack([board[:, 0], found], axis=1)


def measure(
    motion: Motion,
    outcome: Outcome,
    *,
    start: float = 0.0,
    band_percent: float = 5.0,
    axes: int = 2,
) -> dict[str, Any]:
    """Judge one rig's motion, of a run that was stopped up to then.

    Args:
        motion: What the run did.
        outcome: How it ended.
        start: Time in s from which steady tracking is evaluated.
        band_percent: Settling band in % of the distance to a constant goal.
        axes: Number of axes of the rig; of 1 nothing is indicated of the second.

    Returns:
        The indicators by name, as of ``unjudged``. Of the whole run, on x: ``rms_error``,
        ``mean_error`` (C.4). From ``start`` on: ``tracking_error_percent``, e_tt of (C.7) in %, and
        ``rms_distance``, of both axes; ``max_steady_error`` on x, None where that is the beginning.
        For a constant goal, on x: ``overshoot_percent`` of the way to it, ``settling_time`` from
        which on the ball stays in the band, ``steady_error`` at the end. Of the plate: its largest
        angles, also after a stop, its largest applied accelerations ``u1_max`` and ``u2_max``, and
        their RMS. Of a controller that is a program, besides, ``BOARD_INDICATORS``.
    """
    ending = outcome_only(outcome)
    if len(motion.time) == 0:
        return ending
    found: dict[str, Any] = {
        "phi_max_deg": float(np.degrees(np.abs(motion.plate[:, 0]).max())),
        "theta_max_deg": float(np.degrees(np.abs(motion.plate[:, 1]).max())),
    }
    second = dict.fromkeys(("theta_max_deg", "u2_max")) if axes == 1 else {}
    motion = motion.until(outcome.time)  # what a stopped rig does then is no tracking
    if len(motion.time) == 0:
        return ending | _finite(found) | second
    error = motion.error
    steady = motion.time >= start - 1e-9
    found |= {
        "u1_max": float(np.abs(motion.u[:, 0]).max()),
        "u2_max": float(np.abs(motion.u[:, 1]).max()),
        "u_rms": _rms(motion.u[:, :axes]),
    }
    if motion.lateness is not None:
        found["late_percent"] = 100 * float((motion.lateness > 0).mean())
    if motion.board is not None:
        counted = motion.board[np.isfinite(motion.board[:, 0]), 0]
        found["command_difference"] = float(np.fmax.reduce(motion.board[:, 1]))
        if len(counted):
            found["instructions_median"] = round(float(np.median(counted)))
            found["instructions_max"] = round(float(counted.max()))
    if outcome.ending.value in LOST_ENDINGS:
        return ending | _finite(found) | second
    along = error[:, 0]
    found |= {"rms_error": _rms(along), "mean_error": float(np.abs(along).mean())}
    if steady.any():
        found["tracking_error_percent"] = tracking_error(error[steady], motion.reference[steady])
        if start > 0:  # from the beginning on, it would be of the transient
            found["max_steady_error"] = float(np.abs(error[steady, 0]).max())
        found["rms_distance"] = float(np.sqrt((error[steady] ** 2).sum(axis=-1).mean()))
    found |= _approach(motion, band_percent)
    return ending | _finite(found) | second


def outcome_only(outcome: Outcome) -> dict[str, Any]:
    """How a run ended, when in s, and why in words; all its indicators None: they do not apply."""
    ended = {"outcome": outcome.ending.value, "outcome_time": float(outcome.time)}
    return ended | {"reason": outcome.reason} | dict.fromkeys(MOTION_INDICATORS)


def _finite(found: dict[str, Any]) -> dict[str, Any]:
    """Numbers, and None for one that is not finite."""
    return {name: value for name, value in found.items() if value is None or math.isfinite(value)}


def find_rest(time: Array, velocity: Array) -> Mask:
    """Where a ball with friction lay still for more than a turning point, shape (K,).

    Args:
        time: Seconds, rising, shape (K,).
        velocity: True velocity of the ball in m/s, shape (K, 2).
    """
    still = np.hypot(*velocity.T) < STILL_SPEED_M_S
    edges = np.flatnonzero(np.diff(still, prepend=False, append=False))
    found = np.zeros(len(time), bool)
    for first, end in edges.reshape(-1, 2):
        found[first:end] = time[end - 1] - time[first] >= MAX_TURNING_TIME_S
    return found


def tracking_error(error: Array, reference: Array) -> float | None:
    """Trajectory tracking error e_tt of (C.7) in %; None for a reference that rests at 0."""
    scale = float((reference**2).sum())
    return 100 * float(np.sqrt((error**2).sum() / scale)) if scale > 0 else None


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _approach(motion: Motion, band_percent: float) -> dict[str, float | None]:
    """Overshoot, settling time and steady error on x, if the goal on x is constant in the end."""
    goal = motion.reference[-1, 0]
    changes = np.flatnonzero(motion.reference[:, 0] != goal)
    since = int(changes[-1]) + 1 if len(changes) else 0
    constant = len(motion.time) - since > 0.2 * len(motion.time)
    if not constant:
        return {}
    x = motion.ball[since:, 0]
    way = goal - x[0]
    found: dict[str, float | None] = {"steady_error": float(abs(goal - x[-1]))}
    if abs(way) > LEAST_WAY:
        found["overshoot_percent"] = max(0.0, float(100 * ((x - goal) / way).max()))
        outside = np.flatnonzero(np.abs(x - goal) > band_percent / 100 * abs(way))
        last = int(outside[-1]) + 1 if len(outside) else 0
        settled = last < len(x)
        found["settling_time"] = (
            float(motion.time[since + last] - motion.time[since]) if settled else None
        )
    return found
