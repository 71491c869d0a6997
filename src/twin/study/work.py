"""The points of a study, and its runs: the scenario of each, its key, how a chunk is run."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic_core import to_jsonable_python

import controllers
from controllers.arrays import Array
from controllers.catalog import left_alone, outside
from twin.base.errors import ScenarioError, TwinError
from twin.base.shipped import model_path
from twin.run.controller_building import build_controller, own_errors
from twin.run.indicators import MOTION_INDICATORS
from twin.run.loop import alike, simulate
from twin.run.metrics import Ending
from twin.scenario import Scenario
from twin.scenario.load import check, resolve, validate
from twin.scenario.load import read as read_tables
from twin.scenario.merging import setting
from twin.scenario.schema import CATALOG_TABLES, at_study_step, checked_settings, choices
from twin.study.schema import Point, Study, column, place_of

DESIGN_SEED = 1
"""Seed of the designs: the same study has the same points."""


SOBOL_DESIGNS = 8
"""Independently scrambled designs of a Sobol study, as far as each has ``SOBOL_LEAST`` samples."""
SOBOL_LEAST = 8
"""Base samples below which a design's indices are too coarse for Student's t."""


def sobol_designs(study: Study) -> int:
    """How many independent designs share the base samples of a Sobol study; at least two."""
    return min(SOBOL_DESIGNS, max(2, study.samples // SOBOL_LEAST))


def quantiles(study: Study, times: int = 1) -> Array:
    """The design in quantiles, shape (points, parameters); of the methods that have one.

    So many times as many points are designs of the same size, independent of the study's own.

    The design ``sobol`` is several designs, one after the other, each an independently scrambled
    Sobol sequence (Owen). A base sample has two points A and B that are drawn independently, and is
    a block of d + 2 rows: A, then A with one coordinate of B after the other, then B.
    """
    count, d = study.samples, len(study.parameters)
    rng = np.random.default_rng(DESIGN_SEED if times == 1 else (DESIGN_SEED, times))
    if study.method == "lhs":
        cubes = [scipy.stats.qmc.LatinHypercube(d, rng=rng).random(count) for _ in range(times)]
        return np.concatenate(cubes)
    if study.method != "sobol":
        return np.asarray(rng.uniform(size=(times * count, d)))
    designs, spawned = sobol_designs(study), rng.spawn(times * sobol_designs(study))
    base = [scipy.stats.qmc.Sobol(2 * d, rng=each).random(count // designs) for each in spawned]
    # a sequence is most even in neighbouring dimensions: they are the two values of a parameter
    pairs = np.concatenate(base).reshape(-1, d, 2)
    blocks = np.repeat(pairs[:, None, :, 0], d + 2, axis=1)
    for k in range(d):
        blocks[:, k + 1, k] = pairs[:, k, 1]
    blocks[:, -1] = pairs[..., 1]
    return np.asarray(blocks.reshape(-1, d))


class Design(Sequence[Point]):
    """The points of a study, kept by columns.

    Args:
        columns: Values by key, shape (points,) each.
    """

    def __init__(self, columns: Mapping[str, NDArray[Any]]) -> None:
        self.columns = dict(columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def __getitem__(self, index: Any) -> Any:
        """One point; of a list of places or a slice, a design of those."""
        if isinstance(index, int):
            return {key: each.item(index) for key, each in self.columns.items()}
        return Design({key: each[index] for key, each in self.columns.items()})


def points(study: Study, times: int = 1) -> Design:
    """The points of a study, or so many times as many others, in the order its analysis needs."""
    about = study.parameters
    if study.method == "grid":
        steps = [about[key].steps(study.samples) for key in about]
        values = zip(*product(*steps), strict=True)
        return Design({key: column(each) for key, each in zip(about, values, strict=True)})
    rows = quantiles(study, times)
    return Design({key: about[key].at(rows[:, k]) for k, key in enumerate(about)})


_MISSING_VALUE = object()
KNOWN_BALL_FIELDS = ("mass", "radius", "inertia", "height")
"""Parameters of ball and plate that a controller's designer knows."""


def _with_defaults(scenario: Scenario) -> dict[str, Any]:
    """The values of a scenario, with the defaults of its law, observer and reference."""
    found: dict[str, Any] = json.loads(scenario.model_dump_json())
    for name in CATALOG_TABLES:
        choice = getattr(scenario, name)
        own = checked_settings(choices(name)[choice.kind], choice.settings)
        found[name] = to_jsonable_python(own) | found[name]
    return found


class Builder:
    """Scenarios from overrides and points, as ``load`` makes them; but a law is checked once.

    Where a point changes the ball, the controller is designed on the unchanged ball: the point
    stands for what a designer does not know.

    Args:
        name: Name or file of the scenario.
    """

    def __init__(self, name: str) -> None:
        self._tables, self._source = read_tables(name)
        self._setting = cache(setting)
        self._checked: set[str] = set()
        self._bases: dict[tuple[str, ...], dict[str, Any]] = {}

    def __call__(
        self, fixed: Sequence[str], point: Point, relative: Collection[str] = ()
    ) -> Scenario:
        """The scenario with overrides and, over them, the values of a point.

        Args:
            fixed: Overrides ``key=value``.
            point: Dotted key to value; ``key.0`` is the first number of a list.
            relative: Keys with values that are factors on the scenario's values.

        Raises:
            ScenarioError: If a key does not exist, or a value is out of range.
        """
        given: dict[str, Any] = {}
        if any(key.startswith(("plant.ball.", "plant.plate.height")) for key in point):
            known = self._built([*map(self._setting, fixed)]).designed_on
            given["controller.model"] = {key: getattr(known, key) for key in KNOWN_BALL_FIELDS}
        given |= self.whole_keys(fixed, point, relative)
        return self._built([*map(self._setting, fixed), *given.items()])

    def whole_keys(
        self, fixed: Sequence[str], point: Point, relative: Collection[str] = ()
    ) -> dict[str, Any]:
        """A point by the keys of a scenario: lists are whole, factors are multiplied out.

        Args and errors are those of the call.
        """
        given: dict[str, Any] = {}
        for key, value in point.items():
            name, at = place_of(key)
            if at is None and key not in relative:
                given[key] = value
                continue
            whole = given[name] if name in given else self._now(fixed, name)
            given[name] = self._changed(key, whole, at, value, relative=key in relative)
        return given

    def value(self, fixed: Sequence[str], key: str) -> Any:
        """The scenario's value of a key, ``key.0`` the first number of a list, or its default.

        Raises:
            ScenarioError: If there is no such key, or an override is wrong.
        """
        name, at = place_of(key)
        return self._part(key, self._now(fixed, name), at)

    def _part(self, key: str, whole: Any, at: int | None) -> Any:
        if at is None:
            return whole
        if not (isinstance(whole, list) and at < len(whole)):
            known = f"0 to {len(whole) - 1}" if isinstance(whole, list) else "it is no list"
            raise ScenarioError(f"{self._source}: {key}: no such number ({known})")
        return whole[at]

    def _changed(self, key: str, whole: Any, at: int | None, value: Any, *, relative: bool) -> Any:
        """New value of a key: a number, or a list with one of its numbers changed."""
        old = self._part(key, whole, at)
        if relative and not isinstance(old, int | float):
            raise ScenarioError(f"{self._source}: {key}: relative needs a number, got {old!r}")
        new = value * old if relative else value
        return new if at is None else [*whole[:at], new, *whole[at + 1 :]]

    def _now(self, fixed: Sequence[str], key: str) -> Any:
        """The scenario's value of a key, given or by default."""
        base = tuple(text for text in fixed if not text.startswith("seed="))
        if base not in self._bases:
            self._bases[base] = _with_defaults(self._built([*map(self._setting, base)]))
        table: Any = self._bases[base]
        for name in key.split("."):
            table = (
                table.get(name, _MISSING_VALUE) if isinstance(table, Mapping) else _MISSING_VALUE
            )
        if table is _MISSING_VALUE:
            raise ScenarioError(f"{self._source}: {key}: not given by the scenario and no default")
        return table

    def _built(self, settings: Collection[tuple[str, Any]]) -> Scenario:
        merged, source = resolve(self._tables, self._source, settings)
        choices = json.dumps([merged.get(table) for table in CATALOG_TABLES], default=str)
        if choices in self._checked:
            return validate(Scenario, merged, source)
        scenario = check(merged, source)
        self._checked.add(choices)
        return scenario


Row = dict[str, Any]


class StudyTask(NamedTuple):
    """One run: which it is.

    Attributes:
        key: Hash that differs from every other run's: of settings, seed and code.
        alike: Hash that is equal for all runs that can share a batch with it.
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


class ScenarioRuns:
    """Runs of given scenarios, as they are handed out.

    Args:
        scenarios: The scenarios; their names change nothing.
        seen: Whether their metrics are those that the rig's computer sees.
        mark: Further text that distinguishes them from other runs, as the source of their law.

    Attributes:
        tasks: Which runs they are, in their order.
        seen: As it was given.
    """

    def __init__(
        self, scenarios: Iterable[Scenario], *, seen: bool = False, mark: str = ""
    ) -> None:
        self.seen = seen
        self._mark = mark + (f"seen {code()} " if seen else code())
        self._scenarios = [without_title(each) for each in scenarios]
        self.tasks = [
            self._task(each, each.controller.model_dump_json(), number)
            for number, each in enumerate(self._scenarios)
        ]

    @property
    def different(self) -> int:
        """How many runs there are: two tasks may be the same run."""
        return len({task.key for task in self.tasks})

    def scenario(self, task: StudyTask) -> Scenario:
        """Scenario of a task."""
        return self._scenarios[task.point]

    def jobs(self, tasks: Iterable[StudyTask]) -> list[Job]:
        """Runs as they are handed out."""
        return [Job(task.key, task.alike, self.scenario(task).model_dump_json()) for task in tasks]

    def _task(self, scenario: Scenario, variant: str, point: int, seed: int = 0) -> StudyTask:
        kind = digest(json.dumps(alike(scenario), sort_keys=True, default=str))
        key = digest(self._mark + scenario.model_dump_json())
        return StudyTask(key, sys.intern(kind), variant, point, seed)  # one string for all alike


class Work(ScenarioRuns):
    """All runs of a study; every variant has the same points and seeds.

    Scenarios are not kept but made again when they are handed out: a study may have millions.

    Args:
        study: What is asked.
        design: Points in place of the study's own.
        left_out: Parameters that the runs leave as their scenario has them.
        check: Called with the scenario of each run; raises a `TwinError` for one that must not be.

    Attributes:
        design: Its points.
        tasks: The runs, in the order of the design.
        steps: Physics steps of the runs in s.

    Raises:
        ScenarioError: If a parameter is no key of the scenario, or a value is out of range.
    """

    def __init__(
        self,
        study: Study,
        design: Design | None = None,
        left_out: Collection[str] = (),
        *,
        check: Callable[[Scenario], None] = lambda _: None,
    ) -> None:
        super().__init__((), mark="" if study.engine == "python" else f"engine c {c_code()} ")
        self.study = study
        self.design = points(study) if design is None else design
        self._left_out = left_out
        self._relative = {key for key, item in study.parameters.items() if item.relative}
        self._bases = {
            each.name: (Builder(each.scenario or study.scenario), (*study.set, *each.set))
            for each in study.compared
        }
        self.steps: set[float] = set()
        for point, seed, name in product(range(len(self.design)), range(study.seeds), self._bases):
            scenario = self._made(name, point, seed)
            check(scenario)
            self.steps.add(scenario.plant.step)
            self.tasks.append(self._task(scenario, name, point, seed))

    @property
    def labels(self) -> dict[str, Any]:
        """Of every task: variant, point, seed, and the values of the parameters."""
        at = [task.point for task in self.tasks]
        variants, seeds = (
            [getattr(task, key) for task in self.tasks] for key in ("variant", "seed")
        )
        return {"variant": variants, "point": at, "seed": seeds, **self.design[at].columns}

    @property
    def first_of_each_variant(self) -> list[StudyTask]:
        """The first task of each variant."""
        return list({task.variant: task for task in reversed(self.tasks)}.values())

    def scenario(self, task: StudyTask) -> Scenario:
        """Scenario of a task."""
        return self._made(task.variant, task.point, task.seed)

    def _made(self, variant: str, point: int, seed: int) -> Scenario:
        build, fixed = self._bases[variant]
        given = {key: each for key, each in self.design[point].items() if key not in self._left_out}
        scenario = build((*fixed, f"seed={seed}"), given, self._relative)
        return without_title(at_study_step(scenario))


def without_title(scenario: Scenario) -> Scenario:
    """A scenario without its title: what a run is called changes nothing."""
    return scenario.model_copy(update={"title": ""})


def carry_out(jobs: Sequence[Job], *, seen: bool = False) -> list[Row]:
    """Carry out some runs, all those that can share a batch together; one row each, in their order.

    With ``seen`` the metrics are those that the rig's computer sees, not the true ones.
    A run that cannot be carried out, or that diverges, is an outcome, too.
    """
    rows: dict[str, Row] = {}
    ready: dict[str, list[tuple[str, Scenario]]] = {}
    refused: dict[str, TwinError | None] = {}
    for job in jobs:
        scenario = Scenario.model_validate_json(job.scenario)
        controller = controller_key(scenario)
        if controller not in refused:
            refused[controller] = refusal(scenario)
        error = refused[controller]
        if error is not None:
            rows[job.key] = refused_row(job.key, error)
            continue
        ready.setdefault(job.alike, []).append((job.key, scenario))
    for batch in ready.values():
        rows |= {row["key"]: row for row in _together(batch, seen=seen)}
    return [rows[job.key] for job in jobs]


CONTROLLER_TABLES = {"duration", "rig", "controller", "observer", "predictor", "reference"}
"""Tables of a scenario that say which controller it has."""
UNKNOWN_TO_CONTROLLER = {"rig": {"cam_error_percent"}}
"""Keys of these tables that no controller knows: a family's rigs differ in them."""


def controller_key(scenario: Scenario) -> str:
    """A text that is equal for scenarios with the same controller."""
    tables = scenario.model_dump_json(include=CONTROLLER_TABLES, exclude=UNKNOWN_TO_CONTROLLER)
    return tables + repr(scenario.designed_on)


def refusal(scenario: Scenario) -> TwinError | None:
    """Why a scenario has no controller; None if it has."""
    try:
        with own_errors():
            build_controller(scenario)
    except TwinError as error:
        return error
    return None


def _together(batch: Sequence[tuple[str, Scenario]], *, seen: bool) -> Iterator[Row]:
    try:
        found = simulate([scenario for _, scenario in batch], seen=seen)
    except TwinError as error:
        if len(batch) == 1:
            yield refused_row(batch[0][0], error)
            return
        for item in batch:
            yield from _together([item], seen=seen)
        return
    for (key, _), metrics in zip(batch, found, strict=True):
        yield metrics_row(key, metrics)


def metrics_row(key: str, metrics: Mapping[str, Any]) -> Row:
    """The row of a run: how it ended and, if it finished, its indicators."""
    good = metrics["outcome"] == Ending.FINISHED
    row: Row = {"key": key, "outcome": metrics["outcome"], "reason": metrics["reason"]}
    return row | {name: metrics[name] if good else None for name in MOTION_INDICATORS}


def refused_row(key: str, error: TwinError) -> Row:
    """The row of a run that cannot be carried out, and why."""
    row: Row = {"key": key, "outcome": "refused", "reason": str(error)}
    return row | dict.fromkeys(MOTION_INDICATORS)


def digest(text: str) -> str:
    """A short name for a text, different for every text."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def code() -> str:
    """Hash of the code of a simulated run: its sources, its model, and its numerical libraries.

    How a run is handed out, what a real rig needs and what is drawn of it are not among them.
    """
    total = hashlib.sha256()
    for path in sources():
        total.update(path.read_bytes())
    for library in VERSIONED_LIBRARIES:
        with suppress(PackageNotFoundError):  # one that comes with an extra
            total.update(f"{library} {version(library)}".encode())
    return total.hexdigest()


@cache
def c_code() -> str:
    """Hash of the C code of a run that is compiled, and of what writes it."""
    twin = Path(str(files("twin")))
    found = [twin / "fmu" / name for name in ("export.py", "variables.toml")]
    found += [*(twin / "fmu" / "c").iterdir(), *(twin / "fmu" / "templates").iterdir()]
    found += [twin / "study" / "compiled.py", twin / "study" / "c" / "batch.c"]
    texts = (path.read_bytes() for path in sorted(found) if path.is_file())
    return hashlib.sha256(b"".join(texts)).hexdigest()


VERSIONED_LIBRARIES = ("mujoco-core", "numpy", "scipy", "control", "daqp")
"""Libraries with versions that may change the result of a run."""


def sources() -> list[Path]:
    """The files that a simulated run executes or reads."""
    twin, laws = Path(str(files("twin"))), Path(controllers.__file__).parent
    found = [path for path in laws.rglob("*.py") if path.stem != "analysis"]
    found += [path for room in ("sim", "hal", "board") for path in (twin / room).rglob("*.py")]
    found += (twin / "board" / "templates").iterdir()
    found += [twin / "run" / f"{name}.py" for name in RUN_MODULES]
    found += [twin / "scenario" / f"{name}.py" for name in SCENARIO_MODULES]
    found += [twin / "run" / f"{name}.toml" for name in ("channels", "indicators")]
    found += [twin / "base" / "settings.py", twin / "base" / "followers.py", Path(__file__)]
    found += [model_path(), model_path("cams.json")]
    found += [Path(module.__file__) for module in outside() if module.__file__]
    return sorted({*found, *left_alone()})  # what would be run where a command does not only read


RUN_MODULES = (
    *("assemble", "controller_building", "indicators", "loop", "metrics"),
    *("plants", "record", "rig_changes"),
)
"""Modules of the room ``run`` that a run of a study executes."""
SCENARIO_MODULES = ("changing", "load", "merging", "rig_tables", "schema", "titles")
"""The same of the room ``scenario``."""
