"""The twin of a run: how good it is, when reality left it, and why.

A recorded run is looked at as a whole. Of a run in progress the rows of late are looked at every
few seconds as a whole log would be, and what lies far enough from their end is kept. Its scores
differ from those of the whole log by what only that tells: the noise of the screen, estimated from
the rows so far, at most those of the last minute.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from controllers.arrays import Array, Mask
from twin.base.errors import LogError
from twin.hal.interface import AXIS_NAMES
from twin.identify.logs import LOG_COLUMN_UNITS, Log, of_columns
from twin.identify.prepare import PreparedLog
from twin.identify.windows import Windows
from twin.run.logs import NEEDED_COLUMNS
from twin.scenario.schema import Scenario
from twin.shadow.alarms import CHANGE_TEST, SequentialTests, baseline, onset, resolution
from twin.shadow.belief import Belief
from twin.shadow.causes import Alarm, weigh
from twin.shadow.evidence import (
    NO_EVIDENCE,
    Evidence,
    ball_evidence,
    ball_windows,
    gaps,
    noise_evidence,
)
from twin.shadow.horizon import HORIZON_S, FrictionMap, Replays, replays
from twin.shadow.learning import (
    LEARNING_S,
    MAX_REFERENCE_SCORE,
    Difference,
    HealthyTwin,
    beginning,
    compare_with_reference,
    learn,
    prepare_for,
    taught,
)
from twin.shadow.plate import plate_evidence

LEAST_TOLD = 5.0
"""Minimum motion in s for a verdict on the rig's health."""
STRIDE_S = 5.0
"""Seconds of a run after which its twin is asked again."""
ADVISED_STEP_S = 5.0
"""Step in s of the lengths of a log that are advised."""
PENDING_S = 1.0
"""Seconds at the end of the recorded rows that are not evaluated yet."""
LEAD_IN = 4.0
"""Seconds before what is evaluated again: filters of the plate's angle have settled by then."""
MAX_LOOKBACK_S = 10.0
"""Longest look back in s for a window in which the ball moves."""
NOISE_HISTORY_S = 60.0
"""Seconds of rows from which noise is estimated."""
DIAGNOSIS_WINDOWS = 2 * CHANGE_TEST.lookback_windows[-1]
"""Windows of the ball that are kept for a diagnosis."""
DIAGNOSIS_S = 15.0
"""Seconds after an alarm that are looked at for its cause."""
CHANGE_UNCERTAINTY_S = 2.0
"""Uncertainty in s of the most likely time of a change; windows in it are left out."""
MIN_WINDOWS_AFTER = 2
"""Windows after a change that are enough to leave the uncertain ones out."""


@dataclass
class Shadow:
    """Report of the twin on a run, up to now.

    Attributes:
        tests: The sequential tests.
        replays: None if the log is long enough for none.
        alarms: In the order of time; the causes of the last of a run in progress may not be
            settled yet.
        moved_s: Seconds in which the ball moved.
        source: What the log is called.
        length: Usable seconds of what was looked at last.
        taught: What the twin learned before it evaluated the log, in a sentence.
        differences: Of its beginning from the reference; empty without one, or with one that its
            twin does not explain.
        reference_score: Median score of the twin's replays of the reference log; None without one.
        notes: What had to be left out of it, in words.
        wall_note: The one of them on the time at walls; empty without any.
        gaps: Begin and end in s of what is missing or late in it, shape (G, 2).
    """

    tests: SequentialTests
    replays: Replays | None = None
    alarms: list[Alarm] = field(default_factory=list)
    moved_s: float = 0.0
    source: str = ""
    length: float = 0.0
    taught: str = ""
    differences: tuple[Difference, ...] = ()
    reference_score: float | None = None
    notes: tuple[str, ...] = ()
    wall_note: str = ""
    gaps: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def verdict(self) -> str:
        """``alarm``, ``differs`` (from the reference), ``healthy`` or ``cannot tell``."""
        if self.foreign:
            return "cannot tell"
        if self.alarms:
            return "alarm"
        if self.differs:
            return "differs"
        return "healthy" if self.moved_s >= LEAST_TOLD else "cannot tell"

    @property
    def foreign(self) -> bool:
        """Whether the twin does not even follow the reference log: it is of a different rig."""
        return self.reference_score is not None and self.reference_score > MAX_REFERENCE_SCORE

    @property
    def differs(self) -> bool:
        """Whether the log differs from the reference since its first row."""
        return any(each.significant for each in self.differences)

    @property
    def score_median(self) -> float | None:
        """Median score; 1 is as good as predicted. None if the ball never moved."""
        return _median(self.replays, lambda each: each.score)

    @property
    def inside_band(self) -> float | None:
        """Percentage of the replays that end in their 95 % band."""
        if self.replays is None or not self.replays.counted.any():
            return None
        return float(100 * self.replays.inside[self.replays.counted].mean())

    @property
    def error_1s(self) -> float | None:
        """Median distance in m of replay and measured ball after 1 s."""
        return _median(self.replays, lambda each: each.distance)

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        error = self.error_1s
        return {
            "log": self.source,
            "verdict": self.verdict,
            "score_median": self.score_median,
            "inside_band_percent": self.inside_band,
            "replay_error_1s_mm": None if error is None else 1000 * error,
            "alarms": [each.as_dict() for each in self.alarms],
            "smallest_seen": resolution(self.tests),
            "told_seconds": self.moved_s,
            "gaps": self.gaps.tolist(),
            "taught": self.taught,
            "reference_score_median": self.reference_score,
            "differences": [each.as_dict() for each in self.differences],
            "notes": list(self.notes),
        }


def shadow(
    log: Log,
    belief: Belief,
    *,
    learning: bool = False,
    replaying: bool = True,
    reference: HealthyTwin | None = None,
) -> Shadow:
    """Run the twin on a log.

    Args:
        log: What was recorded.
        belief: The twin.
        learning: Whether it was identified from a log, so that it learns from the beginning of
            this one what that left open; the verdict is on the remainder.
        replaying: Whether replays are made. They show how far the twin strays; alarms need none.
        reference: The twin learned from the reference log; where the twin learns, the beginning of
            the log is compared with it.

    Raises:
        LogError: If the log is broken, too short, or does not say what was commanded.
    """
    follower = Follower(belief, learning=learning, replaying=replaying, reference=reference)
    follower.judge(log, whole=True)
    result = follower.result
    if not len(result.tests.soft) and not len(result.gaps):
        raise LogError(f"{log.source}: too short: {result.length:.1f} s; 3 s in a row are needed")
    return result


def median_score(log: PreparedLog, belief: Belief, missing: Array) -> float:
    """Median score of a twin's replays of a log; 1, as predicted, where the ball never moves.

    Args:
        log: The usable part of a log.
        belief: The twin.
        missing: Begin and end in s of what is missing in it, shape (G, 2).
    """
    screen = FrictionMap(belief)
    found = replays(log, belief, missing, HORIZON_S, -np.inf, np.inf, screen)
    score = _median(found, lambda each: each.score)
    return 1.0 if score is None else score


def describe_recording(needed_s: float) -> str:
    """How long to record, in words: more than a time, in whole ``ADVISED_STEP_S``.

    More, as a log ends a dead time after the last position of the ball.

    Args:
        needed_s: Time that the verdict needs, s.
    """
    whole = ADVISED_STEP_S * (math.floor(needed_s / ADVISED_STEP_S) + 1)
    return f"Record at least {whole:g} s (a run: --set duration={whole:g})"


class Follower:
    """Judges a log, whole or as it grows.

    Args:
        belief: The twin.
        learning: Whether it learns at first what an identification left open.
        replaying: Whether replays are made, which alarms do not need.
        reference: The twin learned from the reference log, with which the beginning of a log that
            is learned from is compared; None for no comparison.
    """

    def __init__(
        self,
        belief: Belief,
        *,
        learning: bool = False,
        replaying: bool = True,
        reference: HealthyTwin | None = None,
    ) -> None:
        self.result = Shadow(SequentialTests(belief))
        self._belief, self._learning, self._replaying = belief, learning, replaying
        self._reference = reference
        self._windows: Windows | None = None
        self._screen: FrictionMap | None = None
        self._ball = self._other = NO_EVIDENCE
        self._unsettled: dict[int, int] = {}
        begin = -np.inf
        self._since = {"replays": begin, "ball": begin, "plate": begin, "screen": begin}

    def judge(self, log: Log, *, whole: bool) -> list[Alarm]:
        """Update the findings on a log up to now: the alarms with their causes.

        An alarm is in ``result`` as soon as it is raised, without causes until enough has been
        seen.

        Args:
            log: Its last rows, or all of it.
            whole: Whether no further row comes.

        Raises:
            LogError: If there is too little yet, or the ball is off the screen.
        """
        now = float(log.time[-1])
        usable = self._of_late(prepare_for(log, self._belief), now)
        until = np.inf if whole else now - PENDING_S
        result = self.result
        result.source, result.length = usable.source, usable.length
        result.notes, result.wall_note = usable.notes, usable.wall_note
        result.gaps = gaps(log, usable.period)
        if self._learning:
            self._learn(usable, now)
        if self._replaying:
            self._replay(usable, until)
        first = self._add(usable, until)
        return self._alarms(first, now, whole=whole)

    def _learn(self, log: PreparedLog, now: float) -> None:
        """Have the twin learn from the beginning, which is not evaluated."""
        until = float(log.segments[0].time[0]) + LEARNING_S
        if now < until + PENDING_S:
            raise LogError(
                f"{log.source}: is {now - until + LEARNING_S:.3g} s long, but the twin learns from "
                f"the first {LEARNING_S:g} s, and the ball must move for {LEAST_TOLD:g} s after "
                f"them; {describe_recording(LEARNING_S + LEAST_TOLD).lower()}"
            )
        first = beginning(log)
        if self._reference is not None:
            self.result.reference_score = self._reference.score
            if not self.result.foreign:
                found = compare_with_reference(first, self._reference, self.result.gaps)
                self.result.differences = found
        before, self._belief = self._belief, learn(first, self._belief, self.result.gaps)
        self.result.taught = taught(before, self._belief)
        self.result.tests = SequentialTests(self._belief)
        self._add(first, np.inf)
        self.result.tests.forget()
        self.result.moved_s, self._learning = 0.0, False
        self._since["replays"] = until

    def _of_late(self, log: PreparedLog, now: float) -> PreparedLog:
        """The part of the log that has not been looked at yet, and what leads to it."""
        used = [at for name, at in self._since.items() if self._replaying or name != "replays"]
        if max(used) == -np.inf:
            return log
        since = max(min(used), now - MAX_LOOKBACK_S - STRIDE_S)
        parts = [each.between(since - LEAD_IN, np.inf) for each in log.segments]
        parts = [each for each in parts if len(each.sampled) > 20 and each.length > LEAD_IN / 2]
        if not parts:
            raise LogError(f"{log.source}: no usable rows in the last seconds")
        return replace(log, segments=tuple(parts))

    def _replay(self, log: PreparedLog, until: float) -> None:
        result, since = self.result, self._since["replays"]
        self._screen = self._screen or FrictionMap(self._belief)
        found = replays(log, self._belief, result.gaps, HORIZON_S, since, until, self._screen)
        if found is not None:
            self._since["replays"] = float(found.time[-1]) + HORIZON_S
            result.replays = (
                found if result.replays is None else Replays.join([result.replays, found])
            )

    def _add(self, log: PreparedLog, until: float) -> int:
        """Add the evidence of new windows; return how many there were before."""
        result, belief = self.result, self._belief
        other = [
            plate_evidence(log, belief, result.gaps, self._since["plate"]),
            noise_evidence(log, belief, result.gaps, self._since["screen"]),
        ]
        done = [each.take(each.end <= until) for each in other]
        for name, part in zip(("plate", "screen"), done, strict=True):
            if len(part):
                self._since[name] = float(part.end[-1])
        # new windows come after the old, also if one ends before an old one: none is reported twice
        new = Evidence.join([self._moving(log, until), *done])
        self._other = Evidence.concatenate([self._other, Evidence.join(done)])
        count = len(result.tests.ratio)
        if len(new):
            result.tests.add(new)
        return count

    def _moving(self, log: PreparedLog, until: float) -> Evidence:
        """Evidence of new windows in which the ball moves."""
        windows, ends = ball_windows(log, self._belief, self.result.gaps, self._since["ball"])
        finished = np.asarray(ends <= until)
        self._since["ball"] = max(
            float(ends[finished].max(initial=self._since["ball"])),
            float(log.segments[-1].time[-1]) - MAX_LOOKBACK_S,
        )
        if windows is None or not finished.any():
            return NO_EVIDENCE
        windows = windows.take(finished)
        ball = ball_evidence(windows, self._belief)
        self.result.moved_s += float((ball.end - ball.begin).sum())
        if self._windows is None:
            self._ball, self._windows = ball, windows
        else:
            chosen = np.arange(len(self._ball)) >= len(self._ball) - DIAGNOSIS_WINDOWS
            self._ball = Evidence.join([self._ball.take(chosen), ball])
            self._windows = Windows.join([self._windows.take(chosen), windows])
        return ball.tempered(ball.dispersion)

    def _alarms(self, first: int, now: float, *, whole: bool) -> list[Alarm]:
        result = self.result
        if not len(self._other):
            return []
        for window in result.tests.crossings:
            if window >= first:
                end = float(result.tests.soft.end[window])
                self._unsettled[window] = len(result.alarms)
                result.alarms.append(Alarm(end, end, result.tests.crossed(window), ()))
        explained = []
        for window, place in list(self._unsettled.items()):
            if whole or now - PENDING_S >= result.alarms[place].time + DIAGNOSIS_S:
                result.alarms[place] = self._alarm(window)
                explained.append(result.alarms[place])
                del self._unsettled[window]
        return explained

    def _alarm(self, crossing: int) -> Alarm:
        """The alarm after a window: since when, and why."""
        tests, belief = self.result.tests, self._belief
        soft = tests.soft
        end = float(soft.end[crossing]) + DIAGNOSIS_S
        last = int(np.searchsorted(soft.end, end, side="right")) - 1
        since = onset(soft, belief, crossing, last, tests.change)
        begin = float(soft.begin[since])

        def between(part: Evidence) -> Mask:
            return np.asarray((part.begin >= begin - 1e-9) & (part.end <= end))

        chosen = between(self._ball)
        # a window in which the change may lie speaks for neither before nor after
        clear = chosen & (self._ball.begin >= begin + CHANGE_UNCERTAINTY_S)
        chosen = clear if clear.sum() >= MIN_WINDOWS_AFTER else chosen
        causes = weigh(
            self._ball.take(chosen),
            self._windows.take(chosen) if self._windows is not None and chosen.any() else None,
            self._other.take(between(self._other)),
            baseline(soft, belief, since, tests.change),
            replace(belief, changing=belief.changing * tests.factors[since]),
        )
        return Alarm(float(soft.end[crossing]), begin, tests.crossed(crossing), tuple(causes))


class LiveFollower(Follower):
    """Takes the rows of a run as they come.

    Args:
        scenario: What is run; the twin assumes it, except for the changes that it contains.
        source: What the run is called.
        learning: Whether the twin learns at first what is not known of the rig.
    """

    def __init__(self, scenario: Scenario, source: str, *, learning: bool = False) -> None:
        self._metadata = {"scenario": scenario.model_dump(mode="json")}
        self._source = source
        self.period = scenario.rig.period
        """Control period in s."""
        self._rows: dict[str, Array] = {}
        self._rate: Array = np.zeros(2)
        self._judged = 0.0
        nothing = dict.fromkeys(NEEDED_COLUMNS, np.zeros(0))
        belief = Belief.of(scenario, of_columns(nothing, self._metadata, source))
        super().__init__(belief, learning=learning)

    def take(self, rows: Mapping[str, Array]) -> bool:
        """Take in rows; return whether it is time to ask the twin again.

        Args:
            rows: Columns of the record, shape (K,) each.
        """
        time = rows["time"]
        if not len(time):
            return False
        # a log's acceleration is summed from its first row; here from the first row of the run
        new = {name: rows[name] for name in LOG_COLUMN_UNITS if name in rows}
        for axis, name in enumerate(AXIS_NAMES):
            if (acceleration := new.pop(f"applied_{name}_acc", None)) is None:
                continue  # a rig of one axis has no theta
            steps = self.period * np.nan_to_num(acceleration)
            rate = self._rate[axis] + np.cumsum(steps)
            new[f"applied_{name}_rate"], self._rate[axis] = rate, rate[-1]
        old = self._rows or {name: np.zeros(0) for name in new}
        keep = old["time"] > time[-1] - NOISE_HISTORY_S - STRIDE_S
        self._rows = {name: np.concatenate((old[name][keep], new[name])) for name in new}
        return float(time[-1]) >= self._judged + STRIDE_S

    def ask(self, *, whole: bool = False) -> list[Alarm]:
        """The result of ``judge`` for the rows taken in; nothing where there is none.

        Args:
            whole: Whether no further row comes.
        """
        if not self._rows:
            return []
        self._judged = float(self._rows["time"][-1])
        try:
            return self.judge(of_columns(self._rows, self._metadata, self._source), whole=whole)
        except LogError:
            return []


def _median(found: Replays | None, of: Callable[[Replays], Array]) -> float | None:
    if found is None or not found.counted.any():
        return None
    return float(np.median(of(found)[found.counted]))
