"""The runs of a study: what each is, and how a chunk of them is carried out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import controllers
from controllers.stack import Controller
from twin.errors import TwinError
from twin.paths import model_path
from twin.run.assemble import build_controller
from twin.run.loop import Ending
from twin.run.metrics import Metrics
from twin.scenario import Scenario
from twin.study.alike import common
from twin.study.batch import simulate
from twin.study.build import Builder
from twin.study.design import points
from twin.study.schema import METRICS, Study

Row = dict[str, Any]


class Task(NamedTuple):
    """One run: which it is.

    Attributes:
        key: What tells it from every other run: settings, seed and code.
        alike: What it has in common with the runs that it can share a batch with.
        variant: Name of what is compared.
        point: Which point of the design.
        seed: Of its noise.
    """

    key: str
    alike: str
    variant: str
    point: int
    seed: int


class Job(NamedTuple):
    """One run as it is handed out.

    Attributes:
        key: As its task's.
        alike: As its task's.
        scenario: What to run, as JSON.
    """

    key: str
    alike: str
    scenario: str


class Work:
    """All runs of a study; every variant has the same points and seeds.

    Scenarios are not kept but made again when they are handed out: a study may have millions.

    Args:
        study: What is asked.

    Attributes:
        design: Its points.
        tasks: The runs, in the order of the design.

    Raises:
        ScenarioError: If a parameter is no key of the scenario, or a value is out of range.
    """

    def __init__(self, study: Study) -> None:
        self.study = study
        self.design = points(study)
        self._build = Builder(study.scenario)
        self._relative = {key for key, item in study.parameters.items() if item.relative}
        self._fixed = {each.name: (*study.set, *each.set) for each in study.compared}
        self._kinds: dict[str, str] = {}
        self.tasks = [
            self._task(name, index, seed)
            for index in range(len(self.design))
            for seed in range(study.seeds)
            for name in self._fixed
        ]

    @property
    def different(self) -> int:
        """How many runs there are: two tasks may be the same run."""
        return len({task.key for task in self.tasks})

    def jobs(self, tasks: Iterable[Task]) -> list[Job]:
        """Runs as they are handed out."""
        found = []
        for task in tasks:
            scenario = self._scenario(task.variant, task.point, task.seed)
            found.append(Job(task.key, task.alike, scenario.model_dump_json()))
        return found

    def _task(self, variant: str, point: int, seed: int) -> Task:
        scenario = self._scenario(variant, point, seed)
        alike = digest(json.dumps(common(scenario), sort_keys=True, default=str))
        # one string for all that are alike
        alike = self._kinds.setdefault(alike, alike)
        return Task(digest(code() + scenario.model_dump_json()), alike, variant, point, seed)

    def _scenario(self, variant: str, point: int, seed: int) -> Scenario:
        fixed = (*self._fixed[variant], f"seed={seed}")
        scenario = self._build(fixed, self.design[point], self._relative)
        # what a run is called changes nothing
        return scenario.model_copy(update={"title": ""})


def carry_out(jobs: Sequence[Job]) -> list[Row]:
    """Carry out some runs, all those that can share a batch together; one row each, in their order.

    A run that cannot be carried out, or whose numbers run away, is an outcome, too.
    """
    rows: dict[str, Row] = {}
    ready: dict[str, list[tuple[str, Scenario, Controller]]] = {}
    build = cache(_controller)
    for job in jobs:
        scenario = Scenario.model_validate_json(job.scenario)
        try:
            item = (job.key, scenario, build(_controlled(scenario)))
        except TwinError as error:
            rows[job.key] = _refused(job.key, error)
            continue
        ready.setdefault(job.alike, []).append(item)
    for batch in ready.values():
        rows |= {row["key"]: row for row in _together(batch)}
    return [rows[job.key] for job in jobs]


def _together(batch: Sequence[tuple[str, Scenario, Controller]]) -> Iterator[Row]:
    try:
        found = simulate([item[1] for item in batch], [item[2] for item in batch])
    except TwinError as error:
        if len(batch) == 1:
            yield _refused(batch[0][0], error)
            return
        for item in batch:
            yield from _together([item])
        return
    for (key, _, _), metrics in zip(batch, found, strict=True):
        yield _row(key, metrics)


def _row(key: str, metrics: Metrics) -> Row:
    summary = metrics.as_dict()
    row: Row = {"key": key, "outcome": str(metrics.outcome), "reason": metrics.reason}
    good = metrics.outcome == Ending.FINISHED
    return row | {name: summary[name] if good else None for name in METRICS}


def _refused(key: str, error: TwinError) -> Row:
    row: Row = {"key": key, "outcome": "refused", "reason": str(error)}
    return row | dict.fromkeys(METRICS)


def _controlled(scenario: Scenario) -> str:
    """A scenario without what its controller does not depend on."""
    plain = {"seed": 0, "plant": type(scenario.plant)(), "sensors": type(scenario.sensors)()}
    return scenario.model_copy(update=plain).model_dump_json()


def _controller(text: str) -> Controller:
    return build_controller(Scenario.model_validate_json(text))


def digest(text: str) -> str:
    """A short name for a text, different for every text."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def code() -> str:
    """What the code that runs is: the sum over its sources and its model."""
    total = hashlib.sha256()
    twin = Path(str(files("twin")))
    sources = [
        path
        for folder in (Path(controllers.__file__).parent, twin / "sim", twin / "hal")
        for path in sorted(folder.rglob("*.py"))
    ]
    names = ("loop.py", "assemble.py", "metrics.py")
    sources += [twin / "run" / name for name in names]
    sources += [twin / "study" / name for name in ("alike.py", "batch.py", "bench.py", "work.py")]
    sources += [model_path(), model_path("cams.json")]
    for path in sources:
        total.update(path.read_bytes())
    return total.hexdigest()
