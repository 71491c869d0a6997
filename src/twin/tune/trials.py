"""Form of a tune, checked; its runs, each made once, and the margins of each nominal loop."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from controllers.analysis import Loop, margins, sampled_loop, unstable
from controllers.arrays import Array
from controllers.interfaces import ControlLaw, Observer
from controllers.observers import Ideal
from twin.base.data_file import read_tables
from twin.base.errors import ScenarioError, TwinError
from twin.base.shipped import chosen, shipped_in
from twin.base.validation import Checked, check_named_once, read_model
from twin.run.controller_building import build_controller, own_errors
from twin.run.indicators import MOTION_INDICATORS, nearest_indicator
from twin.scenario import Scenario, load
from twin.scenario.merging import setting
from twin.scenario.schema import at_study_step
from twin.study.experiments import Store, evaluate
from twin.study.schema import FamilyRig, Parameter, Point, draw_rigs, read_family
from twin.study.work import Builder, ScenarioRuns

if TYPE_CHECKING:
    import pandas as pd


RUN_INDICATORS = tuple(
    name
    for name in MOTION_INDICATORS
    if name not in {"settling_time", "overshoot_percent", "steady_error"}
)
"""Indicators that a finished run has, whatever became of the ball's way to its goal."""


class TuneTask(Checked):
    """One of the tasks that a controller must be good at.

    Attributes:
        name: What to call it.
        scenario: Name or file of the scenario.
        set: Overrides ``key=value`` over those of the tune.
        indicator: Of a run, of which less is better.
        scale: The indicator that costs 1, in its own unit.
    """

    name: str
    scenario: str
    set: tuple[str, ...] = ()
    indicator: str = "rms_distance"
    scale: Annotated[float, Field(gt=0)]

    @model_validator(mode="after")
    def _known(self) -> TuneTask:
        if self.indicator not in RUN_INDICATORS:
            where = nearest_indicator(self.indicator, RUN_INDICATORS)
            raise ValueError(f"indicator: no '{self.indicator}'{where}")
        return self


class Constraints(Checked):
    """Constraints of a candidate besides losing no rig.

    Attributes:
        disk: Least disk margin of the nominal loop at any cut, dimensionless.
        delay: Least further dead time in s that the nominal loop bears.
        effort: Largest root mean square control effort of a run, rad/s^2.
    """

    disk: Annotated[float, Field(ge=0, lt=2)] = 0.3
    delay: Annotated[float, Field(ge=0, le=1)] = 0.03
    effort: Annotated[float, Field(gt=0)] = 3.0


class Tune(Checked):
    """A tune: which fields of a controller are to be found, for which rigs and tasks.

    Attributes:
        title: Subject, in a line.
        like: A tune with the values of all keys that this one leaves out.
        family: Name or file of the family of rigs.
        set: Overrides ``key=value`` of all runs; with them the fields begin.
        fields: Dotted scenario key to the range in which it is searched, by ``uniform``,
            ``loguniform``, ``integers`` or ``values``.
        tasks: Tasks that give the cost of a candidate on a rig: the mean of indicator / scale.
        limits: Constraints that it must keep.
        tail: Share of the worst rigs; their mean cost is minimised: CVaR at 1 - tail.
        search: Overrides of the plant and rig in the search.
        verdict: Overrides of the plant and rig for the comparison and the certificate.
        draw: Of the family, for the search.
        certificate_draw: Of the family, for the certificate.
        rigs: Numbers of rigs on which a candidate is run, first to last rung.
        candidates: How many are run, without those with a nominal loop that lacks margin.
        round: How many of them at a time.
        eta: One in so many goes on to the next rung.
        finalists: Best of the search that are compared for the verdict.
        certificate: Rigs of the certificate.
        seed: Of the search's random numbers.
    """

    title: str
    like: str = ""
    family: str
    set: tuple[str, ...] = ()
    fields: Annotated[dict[str, Parameter], Field(min_length=1)]
    tasks: Annotated[tuple[TuneTask, ...], Field(min_length=1)]
    limits: Constraints = Constraints()
    tail: Annotated[float, Field(gt=0, le=1)] = 0.1
    search: tuple[str, ...] = ("plant.kind=lagrange", "plant.step=0.002")
    verdict: tuple[str, ...] = ("plant.kind=mujoco",)
    draw: Annotated[int, Field(ge=0)] = 1
    certificate_draw: Annotated[int, Field(ge=0)] = 2
    rigs: tuple[Annotated[int, Field(ge=1, le=10_000)], ...] = (8, 24, 64)
    candidates: Annotated[int, Field(ge=2, le=100_000)] = 160
    round: Annotated[int, Field(ge=1, le=1000)] = 16
    eta: Annotated[int, Field(ge=2, le=100)] = 4
    finalists: Annotated[int, Field(ge=1, le=100)] = 3
    certificate: Annotated[int, Field(ge=1, le=100_000)] = 60
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 1

    @model_validator(mode="after")
    def _sensible(self) -> Tune:
        check_named_once("tasks", [task.name for task in self.tasks])
        if not self.rigs or list(self.rigs) != sorted(set(self.rigs)):
            raise ValueError(f"rigs: every rung needs more than the last, got {list(self.rigs)}")
        if self.draw == self.certificate_draw:
            raise ValueError(
                f"certificate_draw: must differ from the draw of the search, {self.draw}"
            )
        uncertain = read_family(self.family).parameters
        for key, about in self.fields.items():
            if about.normal is not None:
                raise ValueError(
                    f"fields.{key}: a normal distribution has no range to search; "
                    "give uniform, loguniform, integers or values"
                )
            if key in uncertain:
                raise ValueError(f"fields.{key}: family '{self.family}' draws it, too")
        return self


def read(name: str, **given: Any) -> Tune:
    """The tune of a shipped name or a TOML file.

    Args:
        name: Its name or file.
        given: Keys in place of the tune's own; None for those that are not. ``set`` is added; where
            it names a different rig, the rigs vary about that one, with plant and dead time of its
            file, in place of the family uncertain, which varies about the thesis's rig.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    path = chosen("tune", name, shipped_in("tunes"))
    more = tuple(given.pop("set", None) or ())
    instead = {key: value for key, value in given.items() if value is not None}
    tune = read_model(Tune, path, **(_tables(path) | instead))
    if tune.family == "uncertain" and "parameters" in dict(map(setting, more)):
        fixed = tuple(each for each in tune.set if not each.startswith("predictor.delay="))
        usual = tune.verdict == Tune.model_fields["verdict"].default
        own = {"family": "own", "set": fixed, "verdict": () if usual else tune.verdict}
        tune = tune.model_copy(update=own)
    return tune.model_copy(update={"set": (*tune.set, *more)})


def _tables(path: Path, *before: Path) -> dict[str, Any]:
    """The keys of a tune over those of the one it is like; ``before`` are those like it."""
    own = read_tables(path)
    other = own.get("like")
    if not isinstance(other, str) or not other:
        return own
    file = chosen(f"{path.name}: like: tune", other, shipped_in("tunes"))
    if file.resolve() in (line := (*before, path.resolve())):
        raise ScenarioError(f"{path.name}: like: '{other}' refers to itself")
    return _tables(file, *line) | own


class NominalLoop(NamedTuple):
    """Margins of a sampled loop about the level plate, without friction.

    Attributes:
        disk: Least disk margin at any of its cuts, dimensionless; 0 if it is unstable, None if it
            cannot be linearised.
        delay: Least further dead time in s at any cut; None as well where none destabilises it.
        observed: Whether observer, predictor and dead time are in it. Without, as for an observer
            that learns and so cannot be linearised, it is the law with the full state. None if
            there is no controller.
        refused: Why there is none, in one line.
    """

    disk: float | None
    delay: float | None
    observed: bool | None = True
    refused: str | None = None

    @classmethod
    def none(cls, error: Exception) -> NominalLoop:
        """Of a controller that is refused."""
        return cls(None, None, None, str(error))


def loop_margins(
    law: ControlLaw, observer: Observer, *, dead_time: float, lag: float = 0.0
) -> NominalLoop:
    """Least margins of a sampled loop over its cuts.

    Args:
        law: Any law.
        observer: Any observer, or a predictor around one.
        dead_time: Of the ball's measurement in s.
        lag: Time constant in s with which the plate's rates follow those commanded.
    """
    full_state = Ideal(model=law.model, period=observer.period)
    for seen, late in ((observer, dead_time), (full_state, 0.0)):
        with suppress(ValueError):
            loop = _least(sampled_loop(law, seen, dead_time=late, lag=lag))
            return loop._replace(observed=seen is observer)
    return NominalLoop(None, None, observed=False)  # a law that switches


def _least(loop: Loop) -> NominalLoop:
    if len(unstable(np.linalg.eigvals(loop.A).astype(complex))):
        return NominalLoop(0.0, 0.0)
    found = [margins(loop, cut, points=150) for cut in ("u1", "u2", "x", "y")]
    known = [each for each in found if each is not None]
    delays = [each.delay for each in known if each.delay is not None]
    disk = min((each.disk for each in known), default=0.0)
    return NominalLoop(disk, min(delays, default=None))


Wanted = tuple[Point, int]
"""Values of the fields, and the number of rigs they are tried on."""


class Indicators(NamedTuple):
    """Indicators from the runs of one candidate.

    Attributes:
        values: Each task's indicator, shape (rigs, tasks); NaN where a run did not finish.
        effort: Root mean square control effort in rad/s^2, shape (rigs, tasks); NaN likewise.
        reasons: Why a run did not finish, as ``circle: fell: ball left the plate``.
    """

    values: Array
    effort: Array
    reasons: tuple[str, ...]

    @property
    def lost(self) -> int:
        """Rigs that did not finish every task."""
        return int(np.isnan(self.values).any(axis=1).sum())


class Trials:
    """Carries out candidates on the rigs of a draw; what a folder holds is not run again.

    Args:
        tune: Fields, tasks and family.
        store: Where finished runs are kept.
        how: Who carries them out, as for ``carry``.

    Attributes:
        start: The fields as the scenario and the tune's overrides have them.
        finished: How many runs have been asked for.

    Raises:
        ScenarioError: If a scenario or key does not exist, a field is no number, or a value is out
            of range.
    """

    def __init__(self, tune: Tune, store: Store, **how: Any) -> None:
        self.tune = tune
        self.finished = 0
        self._store, self._how = store, {"processes": 1, "executor": None} | how
        self._family = read_family(tune.family)
        self._builder = cache(Builder)
        about = self._family.parameters | tune.fields
        self._relative = {key for key, each in about.items() if each.relative}
        self.start = self._beginning()
        for place, task in enumerate(tune.tasks):
            try:
                for on in (tune.search, tune.verdict):
                    for rig in draw_rigs(self._family, tune.draw, 1):
                        self.scenario(self.start, place, rig, on)
            except ScenarioError as error:
                raise ScenarioError(f"task {task.name}: {error}") from error

    def scenario(
        self,
        fields: Point,
        task: int,
        rig: FamilyRig | None = None,
        on: Sequence[str] = (),
    ) -> Scenario:
        """A task with values of the fields, on a rig of the family or on the nominal one.

        Args:
            fields: Values by key.
            task: Its place in the tune.
            rig: The rig; None for the scenario's own.
            on: Overrides of the plant and rig of the simulation.

        Raises:
            ScenarioError: If a key does not exist, or a value is out of range.
        """
        about = self.tune.tasks[task]
        seed = () if rig is None else (f"seed={rig.seed}",)
        build = self._builder(about.scenario)
        point = fields | (rig.point if rig is not None else {})
        fixed = (*self.tune.set, *about.set, *on, *seed)
        return at_study_step(build(fixed, point, self._relative & point.keys()))

    def loops(self, candidates: Sequence[Point]) -> list[NominalLoop]:
        """The nominal loop of each candidate's controller.

        Raises:
            TwinError: If a process is killed.
        """
        found: dict[int, NominalLoop] = {}
        ready: dict[int, str] = {}
        for place, fields in enumerate(candidates):
            try:
                ready[place] = self.scenario(fields, 0).model_dump_json()
            except ScenarioError as error:
                found[place] = NominalLoop.none(error)
        executor: Executor | None = self._how["executor"]
        spread = map if executor is None else executor.map
        try:
            found |= zip(ready, spread(_loop, ready.values()), strict=True)
        except BrokenExecutor as error:
            raise TwinError(
                "a process was killed, perhaps for lack of memory; use fewer processes"
            ) from error
        return [found[place] for place in range(len(candidates))]

    def indicators(
        self, wanted: Iterable[Wanted], draw: int, on: Sequence[str]
    ) -> list[Indicators]:
        """What candidates give on the first rigs of a draw.

        Args:
            wanted: Candidates and for each how many rigs.
            draw: Of the family.
            on: Overrides of the plant and rig of the simulation.

        Raises:
            TwinError: If a process is killed, or a chunk of runs is lost too often.
        """
        asked = list(wanted)
        rigs = draw_rigs(self._family, draw, max((count for _, count in asked), default=0))
        which = [
            (candidate, rig, task)
            for candidate, (_, count) in enumerate(asked)
            for rig in range(count)
            for task in range(len(self.tune.tasks))
        ]
        runs = ScenarioRuns(
            self.scenario(asked[c][0], task, rigs[rig], on) for c, rig, task in which
        )
        labels = zip(("candidate", "rig", "task"), zip(*which, strict=True), strict=False)
        gave = evaluate(runs, dict(labels), self._store, whole=True, **self._how)
        self.finished += len(gave)
        return [self._indicators(own) for _, own in gave.groupby("candidate")]

    def _indicators(self, runs: pd.DataFrame) -> Indicators:
        """Indicators of one candidate, rig by rig."""
        lost = runs[runs["outcome"] != "finished"]
        reasons = [
            f"{self.tune.tasks[task].name}: {outcome}: {reason}"
            for task, outcome, reason in lost[["task", "outcome", "reason"]].itertuples(index=False)
        ]
        values, efforts = [], []
        for (_, own), task in zip(runs.groupby("task"), self.tune.tasks, strict=True):
            if own[task.indicator][own["outcome"] == "finished"].isna().any():
                raise ScenarioError(f"task {task.name}: its reference has no {task.indicator}")
            values.append(own[task.indicator])
            efforts.append(own["u_rms"])
        return Indicators(
            np.column_stack(values), np.column_stack(efforts), tuple(dict.fromkeys(reasons))
        )

    def _beginning(self) -> Point:
        """Where the fields begin, each a value that its range holds."""
        build = self._builder(self.tune.tasks[0].scenario)
        fixed = (*self.tune.set, *self.tune.tasks[0].set)
        load(self.tune.tasks[0].scenario, fixed)  # a wrong change is no error of a field
        found: Point = {}
        for key, about in self.tune.fields.items():
            try:
                value = 1.0 if about.relative else build.value(fixed, key)
            except ScenarioError as error:
                raise ScenarioError(f"fields.{key}: {error}") from error
            among = about.values or about.ends
            if about.values:
                inside = value in about.values
            else:
                number = isinstance(value, int | float) and not isinstance(value, bool)
                inside = number and about.ends[0] <= value <= about.ends[1]
            if not inside:
                known = (", " if about.values else " to ").join(map(str, among))
                raise ScenarioError(
                    f"fields.{key}: its first value {value!r} must be one of {known}"
                )
            found[key] = value
        return found


@lru_cache(maxsize=4096)
def _loop(text: str) -> NominalLoop:
    """The loop of law, observer and predictor on the linear plant, as late as the scenario's."""
    scenario = Scenario.model_validate_json(text)
    try:
        with own_errors():
            made = build_controller(scenario)
            dead_time, lag = scenario.lateness
            return loop_margins(made.law, made.observer, dead_time=dead_time, lag=lag)
    except ScenarioError as error:
        return NominalLoop.none(error)
