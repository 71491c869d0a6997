"""The runs of a study: what each is, and how a chunk of them is carried out."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import controllers
from controllers.stack import Controller
from twin.assemble import build_controller
from twin.errors import TwinError
from twin.loop import Ending
from twin.metrics import Metrics
from twin.models import model_path
from twin.scenario import Scenario
from twin.study.alike import common
from twin.study.batch import simulate
from twin.study.build import Builder
from twin.study.design import points
from twin.study.schema import METRICS, Study

Row = dict[str, Any]


class Task(NamedTuple):
    """One run.

    Attributes:
        key: What tells it from every other run: settings, seed and code.
        scenario: What to run, as JSON.
        alike: What it has in common with the runs that it can share a batch with.
        variant: Name of what is compared.
        point: Which point of the design.
        seed: Of its noise.
    """

    key: str
    scenario: str
    alike: str
    variant: str
    point: int
    seed: int


def tasks(study: Study) -> list[Task]:
    """All runs of a study; every variant has the same points and seeds.

    Raises:
        ScenarioError: If a parameter is no key of the scenario, or a value is out of range.
    """
    build = Builder(study.scenario)
    found = []
    relative = {key for key, parameter in study.parameters.items() if parameter.relative}
    for index, point in enumerate(points(study)):
        for seed in range(study.seeds):
            for variant in study.compared:
                fixed = (*study.set, *variant.set, f"seed={seed}")
                scenario = build(fixed, point, relative)
                # what a run is called changes nothing
                text = scenario.model_copy(update={"title": ""}).model_dump_json()
                alike = digest(json.dumps(common(scenario), sort_keys=True, default=str))
                found.append(Task(digest(code() + text), text, alike, variant.name, index, seed))
    return found


def carry_out(some: Sequence[Task]) -> list[Row]:
    """Run some tasks, all those that can share a batch together; one row each, in their order.

    A run that cannot be carried out, or whose numbers run away, is an outcome, too.
    """
    rows: dict[str, Row] = {}
    ready: dict[str, list[tuple[Task, Scenario, Controller]]] = {}
    build = cache(_controller)
    for task in some:
        scenario = Scenario.model_validate_json(task.scenario)
        try:
            item = (task, scenario, build(_controlled(scenario)))
        except TwinError as error:
            rows[task.key] = _refused(task, error)
            continue
        ready.setdefault(task.alike, []).append(item)
    for batch in ready.values():
        rows |= {row["key"]: row for row in _together(batch)}
    return [rows[task.key] for task in some]


def _together(batch: Sequence[tuple[Task, Scenario, Controller]]) -> Iterator[Row]:
    try:
        found = simulate([item[1] for item in batch], [item[2] for item in batch])
    except TwinError as error:
        if len(batch) == 1:
            yield _refused(batch[0][0], error)
            return
        for item in batch:
            yield from _together([item])
        return
    for (task, _, _), metrics in zip(batch, found, strict=True):
        yield _row(task, metrics)


def _row(task: Task, metrics: Metrics) -> Row:
    summary = metrics.as_dict()
    row: Row = {"key": task.key, "outcome": str(metrics.outcome), "reason": metrics.reason}
    good = metrics.outcome == Ending.FINISHED
    return row | {name: _number(summary[name]) if good else None for name in METRICS}


def _refused(task: Task, error: TwinError) -> Row:
    row: Row = {"key": task.key, "outcome": "refused", "reason": str(error)}
    return row | dict.fromkeys(METRICS)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


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
        for folder in (Path(controllers.__file__).parent, twin / "plant", twin / "hal")
        for path in sorted(folder.rglob("*.py"))
    ]
    names = ("loop.py", "assemble.py", "fleet.py", "metrics.py")
    sources += [twin / name for name in names]
    sources += [twin / "study" / name for name in ("alike.py", "batch.py", "bench.py", "work.py")]
    sources += [model_path(), model_path("cams.json")]
    for path in sources:
        total.update(path.read_bytes())
    return total.hexdigest()
