"""The twin beside a run in progress: what is said of a log, said while it is written.

Every few seconds the rows of late are looked at as a whole log would be, and what lies far enough
from their end is kept. Scores differ from those of the whole log by what only that tells: the
noise of the screen, estimated from the rows so far, at most those of the last minute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.arrays import Array
from twin.errors import LogError
from twin.identify.log import COLUMNS, Log, of_columns
from twin.identify.prepare import PreparedLog, prepare
from twin.identify.windows import Windows
from twin.scenario.schema import Scenario
from twin.shadow.alarms import SETTLING, Alarm, Findings, raised
from twin.shadow.ball import Expansion, ball_evidence, ball_windows
from twin.shadow.belief import Belief
from twin.shadow.dead_time import delayed, limited, standing
from twin.shadow.evidence import Evidence
from twin.shadow.friction_map import FrictionMap
from twin.shadow.gaps import gaps
from twin.shadow.horizon import Replays, replays
from twin.shadow.learned import scatter
from twin.shadow.monitor import LOOKBACKS, bounded, statistic
from twin.shadow.plate import plate_evidence
from twin.shadow.screen import noise_evidence

STRIDE = 5.0
"""Seconds of a run after which its twin is asked again."""
MARGIN = 1.0
"""Seconds at the end of what has been recorded that are not judged yet."""
LEAD_IN = 4.0
"""Seconds before what is judged anew: filters of the plate's angle have settled by then."""
OLDEST = 10.0
"""Seconds that are gone back at most for a window in which the ball moves."""
KEPT = 60.0
"""Seconds of rows from which noise is estimated."""
LAST = 2 * LOOKBACKS[-1]
"""Windows of the ball that are kept for a diagnosis."""


@dataclass
class Said:
    """What was said of a run so far.

    Attributes:
        replays: At the horizon of one second; None before the first.
        soft: Windows of all kinds, as the sequential test takes them; None before the first.
        ratio: The statistic of the sequential test after each.
        delayed: That of the test for the dead time alone.
        alarms: In the order of time; the causes of the last one may not be settled yet.
    """

    replays: Replays | None = None
    soft: Evidence | None = None
    ratio: Array = field(default_factory=lambda: np.zeros(0))
    delayed: Array = field(default_factory=lambda: np.zeros(0))
    alarms: list[Alarm] = field(default_factory=list)


class Follower:
    """Takes the rows of a run as they come.

    Args:
        scenario: What is run; the twin believes it, but for what it says will change.
        source: What the run is called.
        horizon: Seconds ahead and from one start to the next.
    """

    def __init__(self, scenario: Scenario, source: str, horizon: float = 1.0) -> None:
        self.said = Said()
        self._horizon = horizon
        self._metadata = {"scenario": scenario.model_dump(mode="json")}
        self._source = source
        self.period = scenario.rig.period
        """Control period in s."""
        self._rows: dict[str, Array] = {}
        self._rate: Array = np.zeros(2)
        self._scenario = scenario
        self._belief: Belief | None = None
        self._screen: FrictionMap | None = None
        self._ball: Evidence | None = None
        self._windows: Windows | None = None
        self._other: Evidence | None = None
        self._every: Evidence | None = None
        self._soft: Evidence | None = None
        self._factors: Array = np.zeros((0, 0))
        self._limited: Evidence | None = None
        self._late: Array = np.zeros(0)
        self._unsettled: dict[int, int] = {}
        self._judged = 0.0
        begin = -np.inf
        self._since = {"replays": begin, "ball": begin, "plate": begin, "screen": begin}

    def take(self, rows: Mapping[str, Array]) -> bool:
        """Take in rows; return whether it is time to ask the twin again.

        Args:
            rows: Columns of the record, shape (K,) each.
        """
        time = rows["time"]
        if not len(time):
            return False
        # a log's acceleration is added up from its first row on; here from that of the run on
        new = {name: rows[name] for name in COLUMNS if name in rows}
        for axis, name in enumerate(("phi", "theta")):
            steps = self.period * np.nan_to_num(new.pop(f"applied_{name}_acc"))
            rate = self._rate[axis] + np.cumsum(steps)
            new[f"applied_{name}_rate"], self._rate[axis] = rate, rate[-1]
        old = self._rows or {name: np.zeros(0) for name in new}
        keep = old["time"] > time[-1] - KEPT - STRIDE
        self._rows = {name: np.concatenate((old[name][keep], new[name])) for name in new}
        return float(time[-1]) >= self._judged + STRIDE

    def ask(self, *, whole: bool = False) -> list[Alarm]:
        """What the twin says of the rows taken in: alarms whose causes are told.

        An alarm is in ``said`` as soon as it is raised, without causes until enough has been seen.

        Args:
            whole: Whether no further row comes.
        """
        if not self._rows:
            return []
        now = float(self._rows["time"][-1])
        self._judged = now
        log = of_columns(self._rows, self._metadata, self._source)
        if self._belief is None:
            self._belief = Belief.of(self._scenario, log)
        try:
            usable = self._of_late(log, now)
        except LogError:  # too little yet, or the ball is off the screen
            return []
        until = np.inf if whole else now - MARGIN
        holes = gaps(log, self.period)
        self._replay(usable, self._belief, holes, until)
        first = self._judge(usable, self._belief, holes, until)
        return self._alarms(self._belief, first, now, whole=whole)

    def _of_late(self, log: Log, now: float) -> PreparedLog:
        """The part of the log that has to be looked at."""
        assert self._belief is not None
        usable = prepare(replace(log, model=self._belief.model))
        since = max(min(self._since.values()), now - OLDEST - STRIDE)
        parts = [each.between(since - LEAD_IN, np.inf) for each in usable.segments]
        parts = [each for each in parts if len(each.sampled) > 20 and each.length > LEAD_IN / 2]
        if not parts:
            raise LogError(f"{log.source}: nothing usable of late")
        return replace(usable, segments=tuple(parts))

    def _replay(self, log: PreparedLog, belief: Belief, holes: Array, until: float) -> None:
        ahead = self._horizon
        if self._screen is None:
            self._screen = FrictionMap(belief)
        since, maps = self._since["replays"], [self._screen]
        (found,) = replays([(log, belief, holes)], ahead, ahead, since, until, maps)
        if found is None:
            return
        self._since["replays"] = float(found.time[-1]) + self._horizon
        said = self.said
        said.replays = found if said.replays is None else Replays.join([said.replays, found])

    def _judge(self, log: PreparedLog, belief: Belief, holes: Array, until: float) -> int:
        """Add the evidence of new windows; return how many there were before."""
        other = [
            plate_evidence(log, belief, holes, self._since["plate"]),
            noise_evidence(log, belief, holes, self._since["screen"]),
        ]
        done = [None if each is None else each.take(each.end <= until) for each in other]
        for name, part in zip(("plate", "screen"), done, strict=True):
            if part is not None and len(part):
                self._since[name] = float(part.end[-1])
        calm = self._moving(log, belief, holes, until)
        plain = [each for each in done if each is not None and len(each)]
        if plain:
            self._other = _joined(self._other, Evidence.join(plain))
        new = [*plain, *([] if calm is None else [calm])]
        said = self.said
        count = 0 if said.soft is None else len(said.soft)
        if new:
            self._every = _joined(self._every, Evidence.join(new))
            self._factors = scatter(self._every, belief)
            late = self._every.take(np.arange(len(self._every)) >= count)
            soft = late.softened(belief.changing, self._factors[count:])
            self._soft = _joined(self._soft, soft)
            said.soft = _joined(said.soft, bounded(self._soft, belief, after=count))
            ratio = statistic(said.soft, belief, after=count)
            said.ratio = np.concatenate((said.ratio, ratio[count:]))
            known = 0 if self._limited is None else len(self._limited)
            self._limited = _joined(self._limited, limited(self._every, belief, after=count))
            again = delayed(self._limited, belief, after=known)
            self._late = np.concatenate((self._late, again[known:]))
            at_end = standing(self._limited, self._late, said.soft.end[count:])
            said.delayed = np.concatenate((said.delayed, at_end))
        return count

    def _moving(
        self, log: PreparedLog, belief: Belief, holes: Array, until: float
    ) -> Evidence | None:
        """Evidence of new windows in which the ball moves."""
        windows, ends = ball_windows(log, belief, holes, self._since["ball"])
        finished = np.asarray(ends <= until)
        self._since["ball"] = max(
            float(ends[finished].max(initial=self._since["ball"])),
            float(log.segments[-1].time[-1]) - OLDEST,
        )
        if windows is None or not finished.any():
            return None
        windows = windows.take(finished)
        (ball,) = ball_evidence([Expansion(windows, belief)])
        if self._ball is None or self._windows is None:
            self._ball, self._windows = ball, windows
        else:
            chosen = np.arange(len(self._ball)) >= len(self._ball) - LAST
            self._ball = Evidence.join([self._ball.take(chosen), ball])
            self._windows = Windows.join([self._windows.take(chosen), windows])
        return ball.tempered(ball.dispersion)

    def _alarms(self, belief: Belief, first: int, now: float, *, whole: bool) -> list[Alarm]:
        said = self.said
        if said.soft is None or self._other is None:
            return []
        shown = (self._ball, self._windows, self._other)
        findings = Findings(said.soft, self._factors, said.ratio, said.delayed, *shown)
        for window in findings.crossings:
            if window >= first:
                end = float(said.soft.end[window])
                self._unsettled[window] = len(said.alarms)
                said.alarms.append(Alarm(end, end, findings.crossed(window), ()))
        told = []
        for window, place in list(self._unsettled.items()):
            if whole or now - MARGIN >= said.alarms[place].time + SETTLING:
                (said.alarms[place],) = raised([(findings, window, belief)])
                told.append(said.alarms[place])
                del self._unsettled[window]
        return told


def _joined(before: Evidence | None, new: Evidence) -> Evidence:
    """The new windows after the old, also if one ends before an old one: none is told twice."""
    return new if before is None else Evidence.beside([before, new])
