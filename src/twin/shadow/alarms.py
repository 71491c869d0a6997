"""When reality has left the model: a sequential test over windows of evidence.

A CUSUM over windows in the form for changes of unknown size (Lai and Xing): after each window the
log-likelihood ratio of every cause against no change, its size integrated over its prior, is
maximised over the time of the change. What crosses a threshold is an alarm. How far the twin was
off before the change is learned from the windows before it: a rig with much that its twin leaves
out (uneven screen, play, a slow screen clock) scatters more than the twin expects.

The dead time has a test alone. A screen that answers 5 ms later moves the ball's samples by less
than a millimetre, now here, now there, but does so in every window: many small signs. The test of
all causes has to leave much room for what differs from window to window where the ball stops;
little of the dead time is left to see there. Here the room is smaller, and no window adds more than
a bound, which bounds the outliers of stopping balls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from controllers.arrays import Array
from twin.shadow.belief import (
    CAUSE_SIZES,
    ROLLING_SCATTER_STD,
    STOPPING_SCATTER_STD,
    WATCHED_PARAMETERS,
    Belief,
)
from twin.shadow.evidence import NO_EVIDENCE, Evidence, log_evidence, posterior
from twin.shadow.possible import limits_of, log_possible


@dataclass(frozen=True, kw_only=True)
class ScatterEstimate:
    """How the scatter of a rig's parameters from window to window is estimated.

    Attributes:
        excluded_s: Seconds before a window that are not used, as a change may have begun in them.
        prior_windows: Weight of the prior scatter, in windows.
        prior_factor: Prior scatter of a parameter of the motion, as a factor on the expected one.
        prior_noise_factor: The same of the screen's noise.
        max_factor: Largest factor; a rig that is far from its twin does not scatter.
    """

    excluded_s: float = 8.0
    prior_windows: float = 4.0
    prior_factor: float = 1.5
    prior_noise_factor: float = 1.0
    max_factor: float = 10.0

    @property
    def prior(self) -> Array:
        """Prior factor of each watched parameter, shape (P,)."""
        names = np.array(WATCHED_PARAMETERS)
        return np.where(names == "noise", self.prior_noise_factor, self.prior_factor)


@dataclass(frozen=True, kw_only=True)
class ChangeTest:
    """The sequential test of all causes, a CUSUM over windows.

    Attributes:
        threshold_llr: Log-likelihood ratio of any cause at which an alarm is raised.
        max_llr_per_window: Largest ratio of one window; an outlier alone raises no alarm.
        max_weakenings: Steps in which a window is weakened to that.
        lookback_windows: Windows since the change that are tried.
        learning_windows: Windows before the change that show how far the twin was off.
        block_windows: Windows that are calculated at a time.
    """

    threshold_llr: float = 12.0
    max_llr_per_window: float = 5.0
    max_weakenings: int = 8
    lookback_windows: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
    learning_windows: int = 120
    block_windows: int = 100


@dataclass(frozen=True, kw_only=True)
class DeadTimeTest:
    """The sequential test of the dead time alone.

    Attributes:
        windows_per_hour: Windows that show the dead time in an hour of ``excite``.
        suspected_llr: Log-likelihood ratio above which a different dead time is reported as
            possible, below an alarm. Healthy rigs with even screens exceeded it twice in 1.2 hours.
        max_llr_per_window: Largest ratio that one window may contribute alone.
        max_llr_increment: Largest ratio that a window may add to the sum of those before it.
        stopping_variability: Share of what else is expected to differ between windows in which the
            ball stops.
    """

    windows_per_hour: int = 2100
    suspected_llr: float = 6.0
    max_llr_per_window: float = 5.0
    max_llr_increment: float = 5.0
    stopping_variability: float = 0.2

    @property
    def threshold_llr(self) -> float:
        """Log-likelihood ratio of an alarm: at most one false alarm in 24 hours.

        Without a change a likelihood ratio with its size integrated over its prior exceeds exp(h)
        after one given time of change with a probability of at most exp(-h) (Ville's inequality),
        and every window may be one. The bounds of a window lower the ratio, and so only lower this
        probability.
        """
        return float(np.log(24 * self.windows_per_hour))


SCATTER_ESTIMATE = ScatterEstimate()
CHANGE_TEST = ChangeTest()
DEAD_TIME_TEST = DeadTimeTest()


def scatter(
    evidence: Evidence, belief: Belief, estimate: ScatterEstimate = SCATTER_ESTIMATE
) -> Array:
    """Factors on what the belief expects parameters to change by, shape (W, P).

    With d the deviation that a window alone would give a parameter, 1/a its variance and Q that
    which is expected from window to window, E (d - mean)^2 = 1/a + f^2 Q; windows count by how well
    they show Q.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
        estimate: Its constants.
    """
    expected = belief.changing[evidence.stopping.astype(int)] ** 2
    a = np.diagonal(evidence.information, axis1=-2, axis2=-1)
    shows = a > 0
    own = 1 / np.where(shows, a, 1.0)
    sd = np.sqrt(own + expected)
    weight = np.where(shows, expected / sd**4, 0.0)
    d = evidence.score * own
    # what is far off all along does not scatter: of an outlier counts how far it is from the others
    usual = np.cumsum(weight * d, axis=0) / np.maximum(np.cumsum(weight, axis=0), 1e-300)
    d = np.clip(d, usual - estimate.max_factor * sd, usual + estimate.max_factor * sd)
    sums = [
        np.concatenate((np.zeros((1, a.shape[1])), np.cumsum(weight * each, axis=0)))
        for each in (np.ones_like(d), d, d**2 - own, expected)
    ]
    until = np.searchsorted(evidence.end, evidence.begin - estimate.excluded_s)
    count, first, second, share = (each[until] for each in sums)
    spread = second - first**2 / np.maximum(count, 1e-300)
    weight_before = estimate.prior_windows
    squared = (weight_before * estimate.prior**2 + spread) / (weight_before + share)
    return np.asarray(np.sqrt(np.clip(squared, 1.0, estimate.max_factor**2)))


class _Sums:
    """Sums of evidence up to each window, in numbers of one size.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change; its uncertainty is the unit of every parameter.
        causes: What may have changed.
        learning_windows: Windows before the change that show how far the twin was off.
    """

    def __init__(
        self,
        evidence: Evidence,
        belief: Belief,
        causes: Sequence[str] = tuple(CAUSE_SIZES),
        learning_windows: int = CHANGE_TEST.learning_windows,
    ) -> None:
        self._learning_windows = learning_windows
        unit = belief.constant
        none = np.zeros((1, *evidence.information.shape[1:]))
        information = np.concatenate((none, np.cumsum(evidence.information, axis=0)))
        self._A = information * unit * unit[:, None]
        self._b = np.concatenate((none[:, 0], np.cumsum(evidence.score, axis=0))) * unit
        chosen = [list(CAUSE_SIZES).index(name) for name in causes]
        moved = belief.changes[chosen] / unit / unit[:, None]
        self._alternatives = np.concatenate((np.zeros((1, *moved.shape[1:])), moved))
        self._limits = {
            1 + causes.index(name): limit._replace(weights=limit.weights * unit)
            for name, limit in limits_of(belief).items()
            if name in causes
        }
        self._eye = np.eye(len(unit))
        self._drift = np.diag((belief.drift / unit) ** 2)

    def ratio(
        self, begin: NDArray[np.int_], last: NDArray[np.int_], weaker: Array | float = 1.0
    ) -> Array:
        """Log-likelihood ratio of a change before windows ``begin`` up to ``last``, shape (...).

        Of what a cause may change, the impossible part is left out.

        Args:
            begin: First window after the change, shape (...).
            last: One past the last window that is counted, shape (...).
            weaker: By how much less the windows from the change on count, shape (...).
        """
        first = np.maximum(begin - self._learning_windows, 0)
        A, b = self._A, self._b  # noqa: N806
        mean, covariance = posterior(A[begin] - A[first], b[begin] - b[first], self._eye)
        A = (A[last] - A[begin]) / np.expand_dims(weaker, (-2, -1))  # noqa: N806
        b = (b[last] - b[begin]) / np.expand_dims(weaker, -1)
        priors = (covariance + self._drift)[..., None, :, :] + self._alternatives
        logs = log_evidence(A[..., None, :, :], b[..., None, :], priors, mean[..., None, :])
        for place, limit in self._limits.items():
            logs[..., place] += log_possible(A, b, priors[..., place, :, :], mean, limit)
        return np.asarray((logs[..., 1:] - logs[..., :1]).max(axis=-1))

    def misfit(self) -> Array:
        """Factor on the variance of each window's noise, at least 1, shape (W,).

        r' C^-1 r / chi2_0.95, with r the part of a window's score that the windows before it do not
        predict, and C its covariance under the cause that explains most of it.
        """
        at = np.arange(len(self._A) - 1)
        first = np.maximum(at - self._learning_windows, 0)
        A, b = self._A, self._b  # noqa: N806
        mean, covariance = posterior(A[at] - A[first], b[at] - b[first], self._eye)
        A, b = np.diff(A, axis=0), np.diff(b, axis=0)  # noqa: N806
        off = (b - (A @ mean[..., None])[..., 0])[:, None, :, None]
        prior = covariance[:, None] + self._alternatives[1:]
        values, vectors = np.linalg.eigh(A[:, None] + A[:, None] @ prior @ A[:, None])
        shown = values > SHOWN_SHARE * values[..., -1:]
        along = (np.swapaxes(vectors, -1, -2) @ off)[..., 0]
        squares = (along**2 / np.where(shown, values, np.inf)).sum(axis=-1)
        usual = chdtri(np.maximum(shown.sum(axis=-1), 1), UNUSUAL_SHARE)
        return np.maximum((squares / usual).min(axis=-1), 1.0)


UNUSUAL_SHARE = 0.05
"""Share of windows, without a change, with a misfit that counts as too large."""
SHOWN_SHARE = 1e-10
"""Share of the variance of the score's largest part below which a part is rounding."""


def bound_evidence(
    evidence: Evidence,
    belief: Belief,
    after: int = 0,
    causes: Sequence[str] = tuple(CAUSE_SIZES),
    test: ChangeTest = CHANGE_TEST,
) -> Evidence:
    """The windows, each of them weakened to what one may say for a change.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        after: Windows that are left out.
        causes: What may have changed.
        test: Its constants.
    """
    begin = np.arange(after, len(evidence))
    sums = _Sums(evidence, belief, causes, test.learning_windows)
    weaker = np.ones(len(begin))
    for _ in range(test.max_weakenings):
        # the ratio falls less than in proportion, as a rig may have drifted
        ratio = sums.ratio(begin, begin + 1, weaker)
        weaker *= np.maximum(ratio / test.max_llr_per_window, 1.0)
    return evidence.take(begin).tempered(weaker)


def statistic(
    evidence: Evidence, belief: Belief, after: int = 0, test: ChangeTest = CHANGE_TEST
) -> Array:
    """After each window the largest log-likelihood ratio of a change so far, shape (W,).

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        after: Windows for which it is not worked out, but left at zero.
        test: Its constants.
    """
    sums = _Sums(evidence, belief, learning_windows=test.learning_windows)
    largest = np.zeros(len(evidence))
    for first in range(after, len(evidence), test.block_windows):
        last = 1 + np.arange(first, min(first + test.block_windows, len(evidence)))
        begin = np.maximum(last[:, None] - np.array(test.lookback_windows), 0)
        ratio = sums.ratio(begin, np.broadcast_to(last[:, None], begin.shape))
        largest[last - 1] = ratio.max(axis=1)
    return largest


def added_up(
    evidence: Evidence,
    belief: Belief,
    after: int,
    causes: Sequence[str],
    max_increment: float,
    test: ChangeTest = CHANGE_TEST,
) -> Array:
    """After each window the largest sum of what those before it add for a change, shape (W,).

    The ratio of ``statistic`` after one more window less that before it is what this one adds,
    given all the others since the change; no window may add more than ``max_increment``.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        after: Windows for which it is not worked out, but left at zero.
        causes: What may have changed.
        max_increment: Log-likelihood ratio that one window may add.
        test: Windows that are looked back and learned from.
    """
    sums, count = _Sums(evidence, belief, causes, test.learning_windows), len(evidence)
    largest = np.zeros(count)
    lookback, block = test.lookback_windows[-1], test.block_windows
    length = np.arange(lookback + 1)
    for first in range(max(after - lookback + 1, 0), count, block):
        begin = np.arange(first, min(first + block, count))[:, None]
        last = np.minimum(begin + length, count)
        ratio = sums.ratio(np.broadcast_to(begin, last.shape), last)
        total = np.cumsum(np.minimum(np.diff(ratio), max_increment), axis=1)
        np.maximum.at(largest, last[:, 1:] - 1, total)
    largest[:after] = 0.0
    return largest


def onset(
    evidence: Evidence, belief: Belief, alarm: int, last: int, test: ChangeTest = CHANGE_TEST
) -> int:
    """The first window after the most likely change.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        alarm: The window after which there was an alarm.
        last: The last window that is counted.
        test: Its constants.
    """
    begin = np.arange(max(alarm + 1 - test.lookback_windows[-1], 0), alarm + 1)
    sums = _Sums(evidence, belief, learning_windows=test.learning_windows)
    ratio = sums.ratio(begin, np.full(len(begin), last + 1))
    return int(begin[ratio.argmax()])


class Before(NamedTuple):
    """How far the twin was off before a change, as far as the log has shown.

    Attributes:
        mean: Most probable deviation from the belief, shape (P,).
        covariance: How unsure that is, shape (P, P).
    """

    mean: Array
    covariance: Array


def baseline(
    evidence: Evidence, belief: Belief, change: int, test: ChangeTest = CHANGE_TEST
) -> Before:
    """Evidence of the windows before a change.

    Args:
        evidence: Windows in the order of time, softened.
        belief: What holds without a change.
        change: The first window after it.
        test: Windows that are learned from.
    """
    before = evidence.take(np.arange(max(change - test.learning_windows, 0), change))
    A, b = before.information.sum(axis=0), before.score.sum(axis=0)  # noqa: N806
    mean, covariance = posterior(A, b, belief.uncertainty)
    return Before(mean, covariance + np.diag(belief.drift**2))


DEAD_TIME_CAUSES = ("dead time",)
DELAY_INDEX = WATCHED_PARAMETERS.index("delay")


def limit_dead_time_evidence(
    evidence: Evidence, belief: Belief, after: int = 0, test: DeadTimeTest = DEAD_TIME_TEST
) -> Evidence:
    """The windows that show the dead time, each weakened to what one may say for a change of it.

    Where a ball stops, friction and tilt gain may seem to be far from what all other windows show.
    Such a window shows little of the dead time alone, but much together with others, which rule
    friction and tilt gain out. Where it is too far off in what no dead time explains, it counts as
    if its noise were so much larger.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
        after: Windows that are left out.
        test: Its constants.
    """
    rolling = np.array([ROLLING_SCATTER_STD[name] for name in WATCHED_PARAMETERS])
    stopping = np.maximum(
        rolling,
        [test.stopping_variability * STOPPING_SCATTER_STD[name] for name in WATCHED_PARAMETERS],
    )
    room = np.hypot(belief.unit * np.stack((rolling, stopping)), belief.uneven)
    shows = evidence.information[:, DELAY_INDEX, DELAY_INDEX] > 0
    narrow = evidence.take(shows).softened(room)
    explained = narrow.tempered(_Sums(narrow, belief, DEAD_TIME_CAUSES).misfit())
    bounded = ChangeTest(max_llr_per_window=test.max_llr_per_window)
    return bound_evidence(explained, belief, int(shows[:after].sum()), DEAD_TIME_CAUSES, bounded)


def dead_time_ratio(
    evidence: Evidence, belief: Belief, after: int = 0, test: DeadTimeTest = DEAD_TIME_TEST
) -> Array:
    """After each window the largest log-likelihood ratio of a different dead time, shape (W,).

    Args:
        evidence: Windows in the order of time, ``limited``.
        belief: The twin.
        after: Windows for which it is not worked out, but left at zero.
        test: Its constants.
    """
    return added_up(evidence, belief, after, DEAD_TIME_CAUSES, test.max_llr_increment)


def statistic_at(evidence: Evidence, ratio: Array, time: Array) -> Array:
    """The statistic as it stands at some times, shape (T,).

    Args:
        evidence: Windows of the test, in the order of time.
        ratio: The statistic after each, shape (W,).
        time: Seconds, shape (T,).
    """
    windows = np.searchsorted(evidence.end, time, side="right")
    return np.asarray(np.concatenate((np.zeros(1), ratio))[windows])


@dataclass
class SequentialTests:
    """Both tests of windows as they come.

    Attributes:
        belief: The twin.
        change: Constants of the test of all causes.
        dead_time: Those of the test of the dead time alone.
        soft: Windows of all kinds, as the test of all causes takes them.
        ratio: Its statistic after each.
        delayed: The same statistic of the test for the dead time alone.
        factors: On what the belief expects parameters to change by, see ``scatter``.
    """

    belief: Belief
    change: ChangeTest = CHANGE_TEST
    dead_time: DeadTimeTest = DEAD_TIME_TEST
    soft: Evidence = NO_EVIDENCE
    ratio: Array = field(default_factory=lambda: np.zeros(0))
    delayed: Array = field(default_factory=lambda: np.zeros(0))
    factors: Array = field(default_factory=lambda: np.zeros((0, 0)))
    _every: Evidence = NO_EVIDENCE
    _unbounded: Evidence = NO_EVIDENCE
    _limited: Evidence = NO_EVIDENCE
    _late: Array = field(default_factory=lambda: np.zeros(0))

    def add(self, new: Evidence) -> None:
        """Take in new windows, not softened, after the old ones."""
        belief, count, known = self.belief, len(self._every), len(self._limited)
        self._every = Evidence.concatenate([self._every, new])
        self.factors = scatter(self._every, belief)
        soft = new.softened(belief.changing, self.factors[count:])
        self._unbounded = Evidence.concatenate([self._unbounded, soft])
        self.soft = Evidence.concatenate(
            [self.soft, bound_evidence(self._unbounded, belief, count, test=self.change)]
        )
        ratio = statistic(self.soft, belief, count, self.change)
        self.ratio = np.concatenate((self.ratio, ratio[count:]))
        self._limited = Evidence.concatenate(
            [self._limited, limit_dead_time_evidence(self._every, belief, count, self.dead_time)]
        )
        late = dead_time_ratio(self._limited, belief, known, self.dead_time)
        self._late = np.concatenate((self._late, late[known:]))
        at_end = statistic_at(self._limited, self._late, self.soft.end[count:])
        self.delayed = np.concatenate((self.delayed, at_end))

    @property
    def limited(self) -> Evidence:
        """The windows that show the dead time, as its own test takes them."""
        return self._limited

    @property
    def suspected(self) -> bool:
        """Whether a different dead time is possible, short of an alarm."""
        return bool(self.delayed.max(initial=0.0) > self.dead_time.suspected_llr)

    def forget(self) -> None:
        """Let what was taken in so far raise no alarm; it still tells what the rig is like."""
        for ratio in (self.ratio, self.delayed, self._late):
            ratio[:] = 0.0

    @property
    def crossings(self) -> list[int]:
        """Windows at which a test comes to exceed its threshold, both having been far below it."""
        share = np.maximum(
            self.ratio / self.change.threshold_llr, self.delayed / self.dead_time.threshold_llr
        )
        found, armed = [], True
        for window, value in enumerate(share):
            if armed and value > 1:
                found.append(window)
            armed = value < 1 / 3 if not armed or value > 1 else armed
        return found

    def crossed(self, crossing: int) -> float:
        """The log-likelihood ratio of the test that a window raises an alarm by."""
        of_all = float(self.ratio[crossing])
        return of_all if of_all > self.change.threshold_llr else float(self.delayed[crossing])


ONE_SIDED_95 = 1.645
"""Standard deviations that 95 % of normal deviations stay below."""


def resolution(tests: SequentialTests) -> dict[str, float]:
    """The smallest change of one parameter that would raise an alarm with about 95 %, by its cause.

    In SI units, rolling friction in m; causes of which no window showed anything are left out. It
    follows from what the last windows show, what may change on a healthy rig, and the thresholds.
    With n the variance without a change and c^2 the variance of a change by its cause, the
    log-likelihood ratio of x is x^2 / 2 (1 / n - 1 / (n + c^2)) - log(1 + c^2 / n) / 2.
    """
    belief, found = tests.belief, dict[str, float]()
    for evidence, threshold, only in (
        (tests.soft, tests.change.threshold_llr, tuple(CAUSE_SIZES)),
        (tests.limited, tests.dead_time.threshold_llr, DEAD_TIME_CAUSES),
    ):
        total = evidence.information[-tests.change.lookback_windows[-1] :].sum(axis=0)
        apart = 1 / (belief.constant**2 + belief.drift**2)
        for cause in only:
            name, *others = CAUSE_SIZES[cause]
            k = WATCHED_PARAMETERS.index(name)
            if (others and cause != "level") or total[k, k] <= 0:
                continue
            known = np.where(np.arange(len(apart)) == k, 0.0, apart)
            unit = np.sqrt(1 / np.maximum(np.diagonal(total) + known, 1e-300))
            scaled = unit[:, None] * (total + np.diag(known)) * unit
            shown = float(np.linalg.pinv(scaled, hermitian=True)[k, k] * unit[k] ** 2)
            none = shown + float(belief.drift[k] ** 2) + min(shown, float(belief.constant[k] ** 2))
            changed = (belief.unit[k] * CAUSE_SIZES[cause][name]) ** 2
            needed = threshold + np.log1p(changed / none) / 2
            least = np.sqrt(2 * needed / (1 / none - 1 / (none + changed)))
            least = float(least + ONE_SIDED_95 * np.sqrt(shown))
            found[cause] = min(least, found.get(cause, np.inf))
    return found
