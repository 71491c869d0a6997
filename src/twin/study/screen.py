"""Many points of a study on the exact equations, those that decide on the mechanism.

The study's own points run on the mechanism and, paired with these, on the exact equations. So many
times as many further points, drawn independently, run on the exact equations alone. The pairs show
the bias of the exact equations; ``twin.study.fidelity`` joins both plants to estimates of the
mechanism. The worst and the best of the further points run on the mechanism, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from controllers.arrays import Array
from twin.base.errors import ScenarioError, plural
from twin.run.tables import INDICATOR_LABELS
from twin.scenario.rig_tables import LEFT_OUT
from twin.study.experiments import label_rows
from twin.study.fidelity import (
    Estimate,
    Numbers,
    Points,
    combine,
    correlation,
    estimate_mean,
    estimate_quantile,
    index_parts,
)
from twin.study.schema import Engine, place_of
from twin.study.work import Work, points, sobol_designs

EXACT_PLANT = "plant.kind=lagrange"
"""What puts a run on the exact equations."""
MAX_TIMES = 1000
"""Largest number of points on the exact equations for each on the mechanism."""
SCREENED_METHODS = ("montecarlo", "sobol")
"""Methods that draw points, or designs, independently of each other; ``lhs`` does not."""
CHECKED_POINTS = 5
"""So many worst points of each variant, and as many best, are checked on the mechanism."""
MIN_TAIL_POINTS = 20
"""Fewest points on the mechanism on either side of a quantile: with 10 its intervals hold the truth
in 93 %, with fewer in less."""
QUANTILE_SHARES = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}
"""Quantiles that are estimated, by name."""

Carry = Callable[[Work], pa.Table]
"""Finishes the runs of a work; their rows in the order of its tasks."""
End = tuple[str, str, int]
"""Variant, which end, ``worst`` or ``best``, and place among the further points."""


class Bias(NamedTuple):
    """An indicator on both plants at the same points, with the same noise.

    Attributes:
        variant: The variant.
        indicator: Name of the indicator.
        mean: Mean on the mechanism.
        difference: Mean of exact equations minus mechanism.
        correlation: Of both; NaN where one does not vary.
        points: Number of points.
    """

    variant: str
    indicator: str
    mean: float
    difference: Estimate
    correlation: float
    points: int


class Joined(NamedTuple):
    """A statistic of the study's first metric on the mechanism.

    Attributes:
        variant: The variant, or ``first minus second`` of two.
        statistic: Its name; of an index the parameter.
        alone: From the runs on the mechanism.
        joined: From both plants.
    """

    variant: str
    statistic: str
    alone: Estimate
    joined: Estimate


class CheckedPoint(NamedTuple):
    """A point at an end of what the exact equations give, on both plants.

    Attributes:
        variant: The variant.
        which: ``worst`` or ``best``.
        point: Values by key.
        exact: The metric on the exact equations; NaN for a failed run.
        mechanism: The metric on the mechanism; NaN for a failed run.
    """

    variant: str
    which: str
    point: Mapping[str, float | str]
    exact: float
    mechanism: float


@dataclass(frozen=True)
class Screened:
    """The results of a screened study.

    Attributes:
        times: Points on the exact equations for each on the mechanism.
        engine: What simulated the exact equations.
        left_out: Parameters that the exact equations do not have.
        counts: Runs by name of their part: ``mechanism``, ``paired``, ``wide``, ``checked``.
        biases: By variant and indicator.
        joined: Statistics by variant.
        checked: The points that decide.
        notes: What there is not, and why.
        rows: A row of each of these runs but the mechanism's own behind the labels of its point:
            ``part``, which is paired, wide or checked, and ``plant``.
    """

    times: int
    engine: Engine
    left_out: tuple[str, ...]
    counts: Mapping[str, int]
    biases: tuple[Bias, ...]
    joined: tuple[Joined, ...]
    checked: tuple[CheckedPoint, ...]
    notes: tuple[str, ...]
    rows: pa.Table


class Screen:
    """The runs of a screened study.

    Args:
        work: The study on the mechanism.
        times: Points on the exact equations for each on the mechanism.
        engine: What simulates the exact equations.

    Attributes:
        paired: The study's points on the exact equations.
        wide: So many times as many further points there.

    Raises:
        ScenarioError: If points are not drawn independently, or a variant is on the exact
            equations already or has a setting that they do not know.
    """

    def __init__(self, work: Work, times: int, engine: Engine = "python") -> None:
        study = work.study
        if not isinstance(times, int) or not 2 <= times <= MAX_TIMES:
            raise ScenarioError(
                f"screen: must be a whole number from 2 to {MAX_TIMES}, got {times!r}"
            )
        if study.method not in SCREENED_METHODS:
            raise ScenarioError(
                f"screen: method must be {' or '.join(SCREENED_METHODS)}, which draw points "
                f"independently, got {study.method}"
            )
        for task in work.first_of_each_variant:
            if work.scenario(task).plant.kind != "mujoco":
                raise ScenarioError(
                    f"screen: variant {task.variant} is on the exact equations already; set "
                    "plant.kind=mujoco"
                )
        self.work, self.times, self.engine = work, times, engine
        self.left_out = tuple(
            key for key in study.parameters if place_of(key)[0] in LEFT_OUT["lagrange"]
        )
        if len(self.left_out) == len(study.parameters):
            raise ScenarioError("screen: the exact equations have none of the study's parameters")
        exact = study.model_copy(
            update={
                "engine": engine,
                "set": (*study.set, EXACT_PLANT),
                "variants": tuple(
                    each.model_copy(update={"set": (*each.set, EXACT_PLANT)})
                    for each in study.variants
                ),
            }
        )
        self.paired = Work(exact, design=work.design, left_out=self.left_out)
        self.wide = Work(exact, design=points(study, times), left_out=self.left_out)

    @property
    def most_checked(self) -> int:
        """Largest number of runs on the mechanism at the ends of the further points."""
        ends = 2 * min(CHECKED_POINTS, len(self.wide.design) // 2)
        return ends * self.work.study.seeds * len(self.work.study.compared)

    def carry_out(self, rows: pa.Table, carry: Carry) -> Screened:
        """Finish all runs.

        Args:
            rows: Those of the study on the mechanism.
            carry: Finishes those of a work.
        """
        study, paired, wide = self.work.study, carry(self.paired), carry(self.wide)
        metric, values = study.metrics[0], dict[str, tuple[Array, Array, Array]]()
        biases, joined, notes = list[Bias](), list[Joined](), list[str]()
        ends = list[End]()
        for variant in (each.name for each in study.compared):
            every = [
                _by_point(work, part, variant, metric)
                for work, part in ((self.work, rows), (self.paired, paired), (self.wide, wide))
            ]
            values[variant] = (every[0], every[1], every[2])
            biases += self._biases(variant, rows, paired)
            if note := _differing_failures(variant, *every[:2]):
                notes.append(note)
            else:
                joined += self._joined(variant, values[variant])
            ends += _ends(variant, every[2])
        for one, other in itertools.combinations(values, 2):
            difference = [a - b for a, b in zip(values[one], values[other], strict=True)]
            name = f"{one} minus {other}"
            if not _differing_failures(name, *difference[:2]):
                joined += self._means(name, (difference[0], difference[1], difference[2]))
        places = sorted({place for _, _, place in ends})
        ended = self._work_of_ends(ends, places)
        rows_of_ends = carry(ended)
        exact = {name: each[2] for name, each in values.items()}
        checked = self._checked(ends, places, exact, ended, rows_of_ends)
        parts = {
            "paired": (self.paired, paired),
            "wide": (self.wide, wide),
            "checked": (ended, rows_of_ends),
        }
        counts = {"mechanism": self.work, "paired": self.paired, "wide": self.wide}
        return Screened(
            self.times,
            self.engine,
            self.left_out,
            {name: each.different for name, each in counts.items()} | {"checked": len(ends)},
            tuple(biases),
            tuple(joined),
            tuple(checked),
            tuple(notes),
            pa.concat_tables(
                [_rows_of_part(name, *each) for name, each in parts.items()],
                promote_options="permissive",
            ),
        )

    def _drawn(self, work: Work) -> tuple[Numbers, Numbers]:
        """The points of a work that were drawn independently, and the unit of each."""
        every = np.arange(len(work.design))
        if self.work.study.method != "sobol":
            return every, every
        block = len(self.work.study.parameters) + 2
        place = every % block
        drawn = every[(place == 0) | (place == block - 1)]
        return drawn, self._designs(work, len(every))[drawn]

    def _designs(self, work: Work, count: int) -> Numbers:
        """The number of the design of each of the points of a Sobol study."""
        times = 1 if work is not self.wide else self.times
        return np.arange(count) * (sobol_designs(self.work.study) * times) // count

    def _biases(self, variant: str, rows: pa.Table, paired: pa.Table) -> Iterator[Bias]:
        at, units = self._drawn(self.work)
        for indicator in INDICATOR_LABELS:
            if indicator not in rows.column_names or not pa.types.is_floating(rows[indicator].type):
                continue
            own = _by_point(self.work, rows, variant, indicator)[at]
            other = _by_point(self.paired, paired, variant, indicator)[at]
            both = np.isfinite(own) & np.isfinite(other)
            if both.sum() < 3:
                continue
            difference = estimate_mean(Points((other - own)[both], units[both]))
            related = correlation(own[both], other[both])
            yield Bias(
                variant, indicator, float(own[both].mean()), difference, related, int(both.sum())
            )

    def _joined(self, name: str, values: tuple[Array, Array, Array]) -> Iterator[Joined]:
        """The statistics of a variant."""
        own, paired, wide = values
        yield from self._means(name, values)
        at, units = self._drawn(self.work)
        wide_at, wide_units = self._drawn(self.wide)
        good, wide_good = np.isfinite(own[at]), np.isfinite(wide[wide_at])
        if wide_good.any():
            points = Points(own[at][good], units[good])
            others = Points(wide[wide_at][wide_good], wide_units[wide_good])
            for statistic, share in QUANTILE_SHARES.items():
                if min(share, 1 - share) * good.sum() < MIN_TAIL_POINTS:
                    continue
                alone = estimate_quantile(share, points)
                both = estimate_quantile(share, points, paired[at][good], others)
                yield Joined(name, statistic, alone, both)
        if self.work.study.method == "sobol":
            yield from self._indices(name, values)

    def _means(self, name: str, values: tuple[Array, Array, Array]) -> Iterator[Joined]:
        """The mean of the metric."""
        at, units = self._drawn(self.work)
        wide_at, wide_units = self._drawn(self.wide)
        own, paired, wide = values[0][at], values[1][at], values[2][wide_at]
        good, wide_good = np.isfinite(own) & np.isfinite(paired), np.isfinite(wide)
        if good.sum() < 3 or wide_good.sum() < 3:
            return
        points = Points(own[good], units[good])
        both = combine(points, paired[good], Points(wide[wide_good], wide_units[wide_good]))
        yield Joined(name, "mean", estimate_mean(points), both)

    def _indices(self, name: str, values: tuple[Array, Array, Array]) -> Iterator[Joined]:
        """The total index of each parameter, from whole blocks."""
        keys = list(self.work.study.parameters)
        own, paired, wide = (each.reshape(-1, len(keys) + 2) for each in values)
        good, wide_good = (np.asarray(np.isfinite(each).all(axis=1)) for each in (own, wide))
        if good.sum() < 2 or wide_good.sum() < 2 or np.ptp(own[good]) == 0:
            return
        units = self._designs(self.work, len(own))[good]
        wide_units = self._designs(self.wide, len(wide))[wide_good]
        parts = [index_parts(own[good]), index_parts(paired[good]), index_parts(wide[wide_good])]
        for k, key in enumerate(keys):
            points = Points(parts[0][:, k], units)
            others = Points(parts[2][:, k], wide_units)
            yield Joined(name, key, estimate_mean(points), combine(points, parts[1][:, k], others))

    def _work_of_ends(self, ends: Sequence[End], places: list[int]) -> Work:
        """The runs of the points at the ends on the mechanism; arguments as of ``_checked``."""
        work = Work(self.work.study, design=self.wide.design[places])
        wanted = {(variant, places.index(place)) for variant, _, place in ends}
        work.tasks = [task for task in work.tasks if (task.variant, task.point) in wanted]
        return work

    def _checked(
        self,
        ends: Sequence[End],
        places: list[int],
        exact: Mapping[str, Array],
        work: Work,
        rows: pa.Table,
    ) -> Iterator[CheckedPoint]:
        """The points at the ends, on the mechanism.

        Args:
            ends: The ends of all variants.
            places: Places of their points, each once, in order.
            exact: Values on the exact equations by variant.
            work: Their runs on the mechanism.
            rows: Of these.
        """
        values = np.where(
            _find_finished(rows), np.array(rows[self.work.study.metrics[0]], float), np.nan
        )
        for variant, which, place in ends:
            at = [
                k
                for k, task in enumerate(work.tasks)
                if (task.variant, task.point) == (variant, places.index(place))
            ]
            value, point = float(values[at].mean()), self.wide.design[place]
            yield CheckedPoint(variant, which, point, float(exact[variant][place]), value)


def _rows_of_part(part: str, work: Work, rows: pa.Table) -> pa.Table:
    """Rows behind labels, and which part and plant they are of."""
    plant = "mujoco" if part == "checked" else "lagrange"
    of = {name: [each] * rows.num_rows for name, each in (("part", part), ("plant", plant))}
    return label_rows({**of, **work.labels}, rows)


def _find_finished(rows: pa.Table) -> Any:
    return np.array(pc.equal(rows["outcome"], "finished"), bool)


def _by_point(work: Work, rows: pa.Table, variant: str, indicator: str) -> Array:
    """An indicator of a variant at each point, the mean over its noises; NaN if a run failed."""
    every = np.where(_find_finished(rows), np.array(rows[indicator], float), np.nan)
    places = [k for k, task in enumerate(work.tasks) if task.variant == variant]
    return np.asarray(every[places].reshape(len(work.design), -1).mean(axis=1))


def _differing_failures(name: str, own: Array, paired: Array) -> str:
    """Why there are no estimates from both plants: what fails differs; empty if it does not."""
    apart = int((np.isfinite(own) != np.isfinite(paired)).sum())
    if not apart:
        return ""
    return (
        f"{name}: no estimates from both plants, because at {apart} of "
        f"{plural(len(own), 'point')} a run fails on one of them only"
    )


def _ends(variant: str, values: Array) -> Iterator[End]:
    """The worst points, failed ones first, and the best; each value once."""
    order = np.argsort(np.nan_to_num(values, nan=math.inf), kind="stable")
    _, first = np.unique(values[order], return_index=True, equal_nan=False)
    different = order[np.sort(first)]
    count = min(CHECKED_POINTS, len(different) // 2)
    for place in reversed(different[len(different) - count :].tolist()):
        yield variant, "worst", place
    for place in different[:count].tolist():
        yield variant, "best", place
