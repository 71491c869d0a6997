"""The twin beside a recorded run: how good it is, when reality left it, and why."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.errors import LogError
from twin.identify.log import Log
from twin.identify.log_checks import check_ranges
from twin.identify.prepare import PreparedLog, prepare
from twin.identify.windows import Windows
from twin.shadow.ball import ball_evidence, ball_windows
from twin.shadow.belief import Belief, check_commands
from twin.shadow.causes import Cause, in_words, likely
from twin.shadow.diagnosis import Suspicion, weigh
from twin.shadow.evidence import Evidence
from twin.shadow.horizon import BAND, Replays, replays
from twin.shadow.monitor import baseline, onset, statistic
from twin.shadow.plate import plate_evidence
from twin.shadow.screen import noise_evidence

THRESHOLD = 12.0
"""Log-likelihood ratio at which an alarm is raised."""
SETTLING = 15.0
"""Seconds after an alarm that are looked at for its cause."""
STRADDLING = 2.0
"""Seconds after the most likely time of a change in which it may still lie,"""
ENOUGH = 4
"""which are left out where at least so many windows come after."""
LEAST_TOLD = 5.0
"""Seconds of motion without which nothing is said of the rig's health."""
SAME_AS = 1.5
"""A gap in the rows longer than this many periods is shown."""


@dataclass(frozen=True)
class Alarm:
    """Reality has left the model.

    Attributes:
        time: When it was noticed, s.
        since: The most likely time of the change, s.
        ratio: Log-likelihood ratio of a change against none.
        causes: All hypotheses, the most probable first.
    """

    time: float
    since: float
    ratio: float
    causes: tuple[Cause, ...]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``: the causes that cannot be ruled out."""
        return {
            "time": self.time,
            "since": self.since,
            "log_likelihood_ratio": self.ratio,
            "causes": [each.as_dict() for each in likely(self.causes)],
        }

    @property
    def words(self) -> str:
        """One sentence."""
        return f"{self.time:.1f} s, since about {self.since:.1f} s: {in_words(self.causes)}"


@dataclass(frozen=True)
class Shadow:
    """What the twin says of a log.

    Attributes:
        log: The usable part of it.
        belief: The twin.
        replays: At the horizon asked for; None if no replay is long enough.
        one_second: The same 1 s ahead.
        time: When the statistic of the sequential test was worked out, s, shape (W,).
        ratio: The statistic, shape (W,).
        alarms: In the order of time.
        told: Seconds in which the ball moved.
        gaps: Begin and end in s of what is missing in the log, shape (G, 2).
    """

    log: PreparedLog
    belief: Belief
    replays: Replays | None
    one_second: Replays | None
    time: Array
    ratio: Array
    alarms: tuple[Alarm, ...]
    told: float
    gaps: Array

    @property
    def verdict(self) -> str:
        """``alarm``, ``healthy`` or ``cannot tell``."""
        if self.alarms:
            return "alarm"
        return "healthy" if self.told >= LEAST_TOLD else "cannot tell"

    @property
    def score_median(self) -> float | None:
        """Median score; 1 is as good as predicted. None if the ball never moved."""
        return _median(self.replays, lambda each: each.score)

    @property
    def inside_band(self) -> float | None:
        """Percentage of the replays that end in their 95 % band."""
        if self.replays is None or not self.replays.counted.any():
            return None
        return float(100 * (self.replays.square[self.replays.counted] <= BAND).mean())

    @property
    def error_1s(self) -> float | None:
        """Median distance in m of replay and measured ball after 1 s."""
        return _median(self.one_second, lambda each: np.hypot(*each.error.T))

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        error = self.error_1s
        return {
            "log": self.log.source,
            "verdict": self.verdict,
            "score_median": self.score_median,
            "inside_band_percent": self.inside_band,
            "replay_error_1s_mm": None if error is None else 1000 * error,
            "alarms": [each.as_dict() for each in self.alarms],
            "told_seconds": self.told,
            "gaps": self.gaps.tolist(),
            "notes": list(self.log.notes),
        }


def shadow(log: Log, belief: Belief, horizon: float = 1.0) -> Shadow:
    """Let the twin run beside a log.

    Args:
        log: What was recorded.
        belief: The twin.
        horizon: Seconds ahead and from one start to the next, of ``HORIZONS``.

    Raises:
        LogError: If the log is broken, too short, or does not say what was commanded.
    """
    check_ranges(log)
    check_commands(log)
    usable = prepare(replace(log, model=belief.model))
    windows = ball_windows(usable, belief)
    ball = None if windows is None else ball_evidence(windows, belief)[0]
    parts = (plate_evidence(usable, belief), noise_evidence(usable, belief))
    found = [part for part in parts if part is not None]
    if not found:
        raise LogError(f"{log.source}: too short: {usable.length:.1f} s; 3 s in a row are needed")
    other = Evidence.join(found)
    calm = None if ball is None else ball.tempered(ball.dispersion)
    every = other if calm is None else Evidence.join([calm, other])
    soft = every.softened(belief.changing)
    ratio = statistic(soft, belief)
    alarms = []
    for n in crossings(ratio):
        end = float(soft.end[n])
        last = int(np.searchsorted(soft.end, end + SETTLING, side="right")) - 1
        since = onset(soft, belief, n, last)
        begin = float(soft.begin[since])
        within = (ball, windows) if ball is not None and windows is not None else None
        suspected = _suspicion(within, other, begin, end + SETTLING)
        before = baseline(soft, belief, since)
        causes = tuple(weigh(suspected, before, belief))
        alarms.append(Alarm(end, begin, float(ratio[n]), causes))
    return Shadow(
        usable,
        belief,
        at := replays(usable, belief, horizon, horizon),
        at if horizon == 1.0 else replays(usable, belief, 1.0, horizon),
        soft.end,
        ratio,
        tuple(alarms),
        0.0 if ball is None else float((ball.end - ball.begin).sum()),
        _gaps(log, usable.period),
    )


def _suspicion(
    moving: tuple[Evidence, Windows] | None, other: Evidence, begin: float, end: float
) -> Suspicion:
    """What a log holds between two times in s."""

    def between(part: Evidence) -> Mask:
        return np.asarray((part.begin >= begin - 1e-9) & (part.end <= end))

    rest = other.take(between(other))
    if moving is None or not between(moving[0]).any():
        return Suspicion(None, None, rest)
    ball, windows = moving
    chosen = between(ball)
    # a window in which the change may lie speaks for neither before nor after
    clear = chosen & (ball.begin >= begin + STRADDLING)
    if clear.sum() >= ENOUGH:
        chosen = clear
    return Suspicion(windows.take(chosen), ball.take(chosen), rest)


def crossings(ratio: Array) -> list[int]:
    """Windows at which the statistic comes to exceed the threshold, having been far below it."""
    found, armed = [], True
    for window, value in enumerate(ratio):
        if armed and value > THRESHOLD:
            found.append(window)
        armed = value < THRESHOLD / 3 if not armed or value > THRESHOLD else armed
    return found


def _gaps(log: Log, period: float) -> Array:
    """Begin and end of what is missing, s, shape (G, 2)."""
    time = log.time[np.isfinite(log.time)]
    missing = np.flatnonzero(np.diff(time) > SAME_AS * period)
    return np.stack((time[missing], time[missing + 1]), axis=-1)


def _median(found: Replays | None, of: Any) -> float | None:
    if found is None or not found.counted.any():
        return None
    return float(np.median(of(found)[found.counted]))
