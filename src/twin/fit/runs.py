"""The runs of a fit: every experiment with the parameters of every sample, each run once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor

import numpy as np

from controllers.arrays import Array
from twin.errors import LawError
from twin.fit.schema import Experiment, FitTable
from twin.scenario import Scenario
from twin.study.build import Builder
from twin.study.carry import carry
from twin.study.store import Store
from twin.study.work import ScenarioRuns

Sample = tuple[float, ...]
"""A value for each parameter, in the order of the table."""
Wanted = tuple[Sample, int]
"""A sample, and which experiment is to be run with it."""


class Runs:
    """Carries out experiments with given parameters; what a folder holds is not run again.

    Args:
        table: The experiments.
        store: Where finished runs are kept.
        executor: Anything with the interface of ``concurrent.futures``; None for this process.
        processes: How many of its workers.
        progress: Told how many runs have been finished altogether, and how many did not end well.

    Raises:
        ScenarioError: If a scenario or key does not exist, or a value is out of range.
    """

    def __init__(
        self,
        table: FitTable,
        store: Store,
        *,
        executor: Executor | None = None,
        processes: int = 1,
        progress: Callable[[int, int], None] = lambda *_: None,
    ) -> None:
        self.table = table
        self._store, self._executor, self._processes = store, executor, processes
        self._progress = progress
        self._builders = {
            name: Builder(name) for name in dict.fromkeys(e.scenario for e in table.experiments)
        }
        self._known: dict[Wanted, dict[str, float]] = {}
        self._failed = 0
        middle = tuple((p.low + p.high) / 2 for p in table.parameters.values())
        for experiment in table.experiments:
            self.scenario(middle, experiment)

    @property
    def finished(self) -> int:
        """How many different runs have been asked for."""
        return len(self._known)

    def scenario(self, sample: Sample, experiment: Experiment) -> Scenario:
        """An experiment with the parameters of a sample.

        Raises:
            ScenarioError: If a key does not exist, or a value is out of range.
        """
        point: dict[str, float | str] = {}
        factors: dict[str, float] = {}
        for value, parameter in zip(sample, self.table.parameters.values(), strict=True):
            if parameter.groups and experiment.own_group not in parameter.groups:
                continue
            key = parameter.key
            if not parameter.relative:
                point[key] = value
            elif key in point:
                point[key] = value * float(point[key])
            else:
                factors[key] = value * factors.get(key, 1.0)
        build = self._builders[experiment.scenario]
        fixed = (*self.table.set, *experiment.set)
        return build(fixed, {**point, **factors}, factors)

    def indicators(self, wanted: Iterable[Wanted]) -> Mapping[Wanted, Mapping[str, float]]:
        """The indicators of runs, as the rig's computer sees them; nan where a run has none.

        Raises:
            TwinError: If a process is killed, or a chunk of runs is lost too often.
            LawError: If none of an experiment can be run, as where its law raises an error.
        """
        asked = list(dict.fromkeys(wanted))
        missing = [each for each in asked if each not in self._known]
        if missing:
            experiments = self.table.experiments
            batch = ScenarioRuns(
                (self.scenario(sample, experiments[i]) for sample, i in missing), seen=True
            )
            before = len(self._known)
            rows = carry(
                batch,
                self._store,
                executor=self._executor,
                processes=self._processes,
                whole=True,
                progress=lambda done, failed: self._progress(before + done, self._failed + failed),
            ).to_pylist()
            self._failed += sum(row["outcome"] != "finished" for row in rows)
            for place, one in enumerate(experiments):
                its = [row for (_, at), row in zip(missing, rows, strict=True) if at == place]
                if its and all(row["outcome"] == "refused" for row in its):
                    raise LawError(f"{one.label}: {its[0]['reason']}")
            for each, row in zip(missing, rows, strict=True):
                self._known[each] = {
                    name: float("nan") if row[name] is None else row[name]
                    for name in self.table.experiments[each[1]].measured
                }
        return {each: self._known[each] for each in asked}


def rounded(share: Array, table: FitTable) -> Sample:
    """The sample at shares between 0 and 1 of the parameters' ranges, shape (parameters,).

    Rounded to a ten-thousandth of the range: what is printed is what was run.
    """
    found = []
    for at, parameter in zip(np.clip(share, 0, 1), table.parameters.values(), strict=True):
        step = 10.0 ** (np.floor(np.log10(parameter.high - parameter.low)) - 4)
        value = parameter.low + float(at) * (parameter.high - parameter.low)
        found.append(
            float(f"{np.clip(round(value / step) * step, parameter.low, parameter.high):.12g}")
        )
    return tuple(found)


def shares(sample: Sample, table: FitTable) -> Array:
    """Where a sample lies in the ranges, each 0 to 1, shape (parameters,)."""
    ends = np.array([(p.low, p.high) for p in table.parameters.values()])
    found: Array = (np.array(sample) - ends[:, 0]) / (ends[:, 1] - ends[:, 0])
    return found
