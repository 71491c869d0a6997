"""The twin beside a recorded run: how good it is, when reality left it, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.errors import LogError
from twin.identify.log import Log
from twin.identify.log_checks import check_ranges
from twin.identify.prepare import PreparedLog, prepare
from twin.identify.windows import Windows
from twin.shadow.alarms import Alarm, Findings, raised
from twin.shadow.ball import Expansion, ball_evidence, ball_windows
from twin.shadow.belief import Belief, check_commands
from twin.shadow.dead_time import delayed, limited, standing
from twin.shadow.evidence import Evidence
from twin.shadow.gaps import gaps
from twin.shadow.horizon import BAND, Replays, replays
from twin.shadow.learned import scatter
from twin.shadow.monitor import bounded, statistic
from twin.shadow.plate import plate_evidence
from twin.shadow.screen import noise_evidence
from twin.view.fingerprint import fingerprint

LEAST_TOLD = 5.0
"""Seconds of motion without which nothing is said of the rig's health."""


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
        delayed: That of the test for the dead time alone, shape (W,).
        alarms: In the order of time.
        told: Seconds in which the ball moved.
        gaps: Begin and end in s of what is missing or late in the log, shape (G, 2).
        record: Fingerprint of the log.
    """

    log: PreparedLog
    belief: Belief
    replays: Replays | None
    one_second: Replays | None
    time: Array
    ratio: Array
    delayed: Array
    alarms: tuple[Alarm, ...]
    told: float
    gaps: Array
    record: int

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
        horizon: Seconds ahead and from one start to the next: 0.5, 1 or 2.

    Raises:
        LogError: If the log is broken, too short, or does not say what was commanded.
    """
    return shadows([(log, belief)], horizon)[0]


def shadows(pairs: Sequence[tuple[Log, Belief]], horizon: float = 1.0) -> list[Shadow]:
    """Let twins run beside logs, all in one go, which costs less than one after the other.

    Args:
        pairs: What was recorded, and the twin, of each.
        horizon: Seconds ahead and from one start to the next: 0.5, 1 or 2.

    Raises:
        LogError: If a log is broken, too short, or does not say what was commanded.
    """
    usable: list[tuple[PreparedLog, Belief, Array]] = []
    for log, belief in pairs:
        check_ranges(log)
        check_commands(log)
        clean = prepare(replace(log, model=belief.model))
        usable.append((clean, belief, gaps(log, clean.period)))
    cut = [ball_windows(*each)[0] for each in usable]
    moving = [place for place, windows in enumerate(cut) if windows is not None]
    wanted = [Expansion(w, usable[place][1]) for place, w in enumerate(cut) if w is not None]
    ball = dict(zip(moving, ball_evidence(wanted), strict=True))
    findings = [_findings(*each, ball.get(place), cut[place]) for place, each in enumerate(usable)]
    found = [(place, each) for place, say in enumerate(findings) for each in say.crossings]
    alarms = raised([(findings[place], each, usable[place][1]) for place, each in found])
    at = replays(usable, horizon, horizon)
    one_second = at if horizon == 1.0 else replays(usable, 1.0, horizon)
    return [
        Shadow(
            log=clean,
            belief=belief,
            replays=at[place],
            one_second=one_second[place],
            time=findings[place].soft.end,
            ratio=findings[place].ratio,
            delayed=findings[place].delayed,
            alarms=tuple(a for (whose, _), a in zip(found, alarms, strict=True) if whose == place),
            told=float((ball[place].end - ball[place].begin).sum()) if place in ball else 0.0,
            gaps=holes,
            record=fingerprint(*pairs[place][0].ball.T),
        )
        for place, (clean, belief, holes) in enumerate(usable)
    ]


def _findings(
    log: PreparedLog, belief: Belief, holes: Array, ball: Evidence | None, windows: Windows | None
) -> Findings:
    """What the windows of a log say.

    Raises:
        LogError: If there are none.
    """
    parts = (plate_evidence(log, belief, holes), noise_evidence(log, belief, holes))
    found = [part for part in parts if part is not None]
    if not found:
        raise LogError(f"{log.source}: too short: {log.length:.1f} s; 3 s in a row are needed")
    other = Evidence.join(found)
    calm = None if ball is None else ball.tempered(ball.dispersion)
    every = other if calm is None else Evidence.join([calm, other])
    factors = scatter(every, belief)
    soft = bounded(every.softened(belief.changing, factors), belief)
    late = limited(every, belief)
    at_end = standing(late, delayed(late, belief), soft.end)
    return Findings(soft, factors, statistic(soft, belief), at_end, ball, windows, other)


def _median(found: Replays | None, of: Any) -> float | None:
    if found is None or not found.counted.any():
        return None
    return float(np.median(of(found)[found.counted]))
