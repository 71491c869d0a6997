"""What a tune may say, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from twin.errors import ScenarioError, nearest
from twin.run.indicators import METRICS
from twin.shipped import chosen, shipped_in
from twin.study.family import Parameter
from twin.study.family import read as read_family
from twin.validation import Checked, check_named_once, read_model, read_tables

JUDGED = tuple(
    name for name in METRICS if name not in {"settling_time", "overshoot_percent", "steady_error"}
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
        if self.indicator not in JUDGED:
            raise ValueError(f"indicator: no '{self.indicator}'{nearest(self.indicator, JUDGED)}")
        return self


class Constraints(Checked):
    """What a candidate must keep besides losing no rig.

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
        title: What it is about.
        like: Another tune whose keys hold where this one has none.
        family: Name or file of the family of rigs.
        set: Overrides ``key=value`` of all runs; with them the fields begin.
        fields: Dotted scenario key to the range in which it is searched, by ``uniform``,
            ``loguniform``, ``integers`` or ``values``.
        tasks: What a candidate is judged by: its cost on a rig is the mean of indicator / scale.
        limits: What it must keep.
        tail: Share of the worst rigs whose mean cost is made small: CVaR at 1 - tail.
        search: Overrides that say on what is searched.
        verdict: Overrides that say on what the best are compared and certified.
        draw: Of the family, for the search.
        certificate_draw: Of the family, for the certificate.
        rigs: Rigs on which a candidate is judged, first to last rung.
        candidates: How many are run; those whose nominal loop lacks margin are not counted.
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
                f"certificate_draw: must not be that of the search, draw = {self.draw}"
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
        given: Keys in place of the tune's own; None for those that are not. ``set`` is added.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    path = chosen("tune", name, shipped_in("tunes"))
    more = tuple(given.pop("set", None) or ())
    instead = {key: value for key, value in given.items() if value is not None}
    tune = read_model(Tune, path, **(_taken_over(path) | instead))
    return tune.model_copy(update={"set": (*tune.set, *more)})


def _taken_over(path: Path) -> dict[str, Any]:
    """The keys that a tune takes from the one it is like."""
    own, seen = read_tables(path), {path.resolve()}
    found: dict[str, Any] = {}
    other, source = own.get("like"), path.name
    while isinstance(other, str) and other:
        file = chosen(f"{source}: like: tune", other, shipped_in("tunes"))
        if file.resolve() in seen:
            raise ScenarioError(f"{path.name}: like: '{other}' is like this one itself")
        seen.add(file.resolve())
        tables = read_tables(file)
        found = {key: value for key, value in tables.items() if key not in own} | found
        other, source = tables.get("like"), file.name
    found.pop("like", None)
    return found
