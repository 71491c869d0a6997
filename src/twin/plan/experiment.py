"""An experiment before the rig moves: what each motion will tell, on the nominal rig and others."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from twin.base.errors import ScenarioError, plural
from twin.base.page import Table, round_plainly
from twin.identify.logs import Log
from twin.identify.parameters import DEFAULT_PARAMETERS, FITTED_SHARE, HIDDEN_PARAMETERS
from twin.identify.verdicts import IDENTIFIED_VERDICT, ParameterVerdict
from twin.plan.forecast import FORECAST, RigForecast, forecast_log, half_width, width_ratio
from twin.scenario.schema import Scenario, at_study_step
from twin.shadow.belief import logs
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder

EXCITATIONS = {1: ("line", "excite"), 2: ("excite", "circle", "sine")}
"""Shipped scenarios that are compared if none is chosen, by the number of axes of the rig."""
FAMILY, OWN_FAMILY = "uncertain", "own"
"""Families of what is not known of the thesis's rig, and of any other."""
DRAWN_RIGS, MAX_RIGS = 4, 200
"""Number of rigs of the family, unless chosen otherwise, and the largest one."""
MIN_SECONDS, MAX_SECONDS = 5.0, 600.0
"""Shortest and longest run that can be planned, s."""
DRAW = 63
"""Number of the draw of the rigs, unless chosen otherwise."""
FORECAST_HEADINGS = (
    "parameter",
    "unit",
    "nominal rig",
    "expected verdict",
    "drawn rigs: +- median",
    "+- largest",
    "identified",
)
"""Columns of the table of a forecast."""


PLANT_OF_ONE_AXIS = "plant.kind=lagrange"
"""The usual rig's plant where it is to have one axis: its mechanism has two."""


def axes_settings(axes: int | None, on: str) -> tuple[str, ...]:
    """Changes of the scenario that give a rig so many axes; none for None.

    Args:
        axes: Number of axes; None for those that the rig has.
        on: Name or file of the rig; empty for the thesis's rig.
    """
    if axes is None:
        return ()
    return (f"plant.axes={axes}", *((PLANT_OF_ONE_AXIS,) if axes == 1 and not on else ()))


@dataclass(frozen=True, kw_only=True)
class RigChoice:
    """Rigs that an experiment is planned for.

    Attributes:
        on: Name or file of the rig; empty for the thesis's rig.
        rigs: Number of rigs drawn of its family, in addition to the nominal one.
        draw: Number of the draw.
        settings: Further changes of the scenario, ``KEY=VALUE`` each.
    """

    on: str = ""
    rigs: int = DRAWN_RIGS
    draw: int = DRAW
    settings: tuple[str, ...] = ()

    @property
    def changes(self) -> tuple[str, ...]:
        """The rig as a setting of a scenario."""
        return (f"parameters={self.on}",) if self.on else ()

    @cached_property
    def axes(self) -> int:
        """Number of axes of the rig.

        Raises:
            ScenarioError: If there is no such rig or key.
        """
        return Builder("hold")([*self.changes, *self.settings], {}).plant.axes

    @property
    def family(self) -> str:
        """Name of the family of rigs that differ by what is not known of this one."""
        return OWN_FAMILY if self.on else FAMILY

    def scenarios(self, name: str | Path, seconds: float) -> tuple[Scenario, list[Scenario]]:
        """A scenario as it is believed, and the rigs: first the nominal one, then those drawn.

        Args:
            name: Name or file of the scenario.
            seconds: Its duration.

        Raises:
            ScenarioError: If there is no such scenario, rig or key.
        """
        build = Builder(str(name))
        fixed = [f"duration={seconds:g}", *self.changes, *self.settings]
        believed = at_study_step(build(fixed, {}))
        family = read_family(self.family)
        relative = {key for key, about in family.parameters.items() if about.relative}
        drawn = [
            build([*fixed, f"seed={rig.seed}"], rig.point, relative)
            for rig in (draw_rigs(family, self.draw, self.rigs) if self.rigs else ())
        ]
        return believed, [believed, *map(at_study_step, drawn)]


@dataclass(frozen=True, kw_only=True)
class MotionForecast:
    """What a motion will tell.

    Attributes:
        scenario: Name or file of the scenario.
        seconds: Its duration.
        nominal: Forecast on the nominal rig.
        drawn: Forecasts on the rigs of the family.
    """

    scenario: str
    seconds: float
    nominal: RigForecast
    drawn: tuple[RigForecast, ...]

    @property
    def every(self) -> tuple[RigForecast, ...]:
        """Forecasts of all rigs."""
        return (self.nominal, *self.drawn)

    @cached_property
    def rows(self) -> tuple[str, ...]:
        """Names of the parameters as verdicts have them: the level has two."""
        of = next((each.verdicts for each in self.every if each.verdicts), ())
        return tuple(each.name for each in of)

    @property
    def score(self) -> float:
        """Half width over the one that counts as identified: geometric mean of all parameters."""
        lost = [FORECAST.worst_ratio] * max(1, len(self.rows))
        ratios = [
            [width_ratio(each.verdict(name)) for name in self.rows] if each.verdicts else lost
            for each in self.every
        ]
        return float(np.exp(np.mean(np.log(np.concatenate(ratios)))))

    @property
    def table(self) -> Table:
        """The forecast of each parameter."""
        return Table(
            f"{self.scenario}, {self.seconds:g} s",
            FORECAST_HEADINGS,
            [self._row(name) for name in self.rows],
            words=range(len(FORECAST_HEADINGS)),
        )

    def _row(self, name: str) -> tuple[str, ...]:
        there = [each.verdict(name) for each in self.drawn]
        about = next(v for v in (each.verdict(name) for each in self.every) if v is not None)
        halves = [half_width(each) for each in there]
        own = self.nominal.verdict(name)
        found = sum(each is not None and each.word == IDENTIFIED_VERDICT for each in there)
        return (
            about.label,
            about.about.unit,
            _describe(own),
            "-" if own is None else own.word,
            _number(float(np.median(halves))) if halves else "-",
            _number(max(halves)) if halves else "-",
            f"{found} of {len(there)}",
        )

    def sentences(self) -> Iterator[str]:
        """What the table does not say: what is not told apart, and where nothing is expected."""
        for each in dict.fromkeys(group for rig in self.every for group in rig.indistinct):
            count = sum(each in rig.indistinct for rig in self.every)
            yield (
                f"expected to be known only together on {count} of "
                f"{plural(len(self.every), 'rig')}: {' and '.join(each)}"
            )
        if self.nominal.why:
            yield f"nothing is expected of the nominal rig: {self.nominal.why}"
        lost = [each.why for each in self.drawn if each.why]
        if lost:
            drawn = plural(len(self.drawn), "drawn rig")
            yield f"nothing is expected of {len(lost)} of {drawn}: {lost[0]}"

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "scenario": self.scenario,
            "seconds": self.seconds,
            "score": self.score,
            "rigs": [
                {
                    "verdicts": [each.as_dict() for each in rig.verdicts],
                    "not_told_apart": [list(group) for group in rig.indistinct],
                    "why": rig.why,
                }
                for rig in self.every
            ],
        }


def _describe(found: ParameterVerdict | None) -> str:
    """The expected interval of a parameter; in percent as well where it has a size."""
    half = half_width(found)
    if found is None or found.low is None:
        return "-"
    if math.isinf(half) or found.value is None:
        return found.interval
    percent = round_plainly(100 * half / abs(found.value)) if found.value else ""
    share = f" ({percent} %)" if found.about.relative and percent else ""
    return f"{found.value:.4g} +- {round_plainly(half)}{share}"


def _number(half: float) -> str:
    return round_plainly(half) if math.isfinite(half) else "none"


def check_plan(
    seconds: float,
    choice: RigChoice,
    names: tuple[str, ...],
    name_of: Callable[[str], str] = str,
) -> tuple[str, ...]:
    """Make sure that numbers are in range; the names of parameters that a motion may show.

    Args:
        seconds: Duration of the run.
        choice: The rigs.
        names: The parameters.
        name_of: Gives the name of an argument in messages.

    Raises:
        ScenarioError: If a number is out of range, or no motion shows any parameter.
    """
    asked = tuple(each for each in names if each not in HIDDEN_PARAMETERS)
    if not asked:
        raise ScenarioError(f"{name_of('parameters')}: cannot be forecast: {', '.join(names)}")
    if not MIN_SECONDS <= seconds <= MAX_SECONDS:
        allowed = f"{MIN_SECONDS:g} to {MAX_SECONDS:g}"
        raise ScenarioError(f"{name_of('seconds')}: must be {allowed}, got {seconds:g}")
    if not 0 <= choice.rigs <= MAX_RIGS:
        raise ScenarioError(f"{name_of('rigs')}: must be 0 to {MAX_RIGS}, got {choice.rigs}")
    return asked


def forecast_motion(
    name: str | Path,
    seconds: float,
    choice: RigChoice,
    names: tuple[str, ...] = DEFAULT_PARAMETERS,
    share: float = FITTED_SHARE,
    progress: Callable[[float], None] = lambda _: None,
) -> MotionForecast:
    """Forecast what a scenario will tell of the nominal rig and others.

    Args:
        name: Name or file of the scenario.
        seconds: Its duration.
        choice: The rigs.
        names: The parameters, as ``identify`` takes them.
        share: Share of the run that will be fitted; the rest is held out.
        progress: Called with the share of the work done.

    Raises:
        ScenarioError: If anything is unknown or out of range.
    """
    asked = check_plan(seconds, choice, names)
    believed, rigs = choice.scenarios(name, seconds)
    recorded = logs([(believed, rig) for rig in rigs])
    return forecast_runs(name, seconds, rigs, recorded, asked, share, progress)


def forecast_runs(
    name: str | Path,
    seconds: float,
    rigs: Sequence[Scenario],
    recorded: Sequence[Log],
    names: tuple[str, ...],
    share: float = FITTED_SHARE,
    progress: Callable[[float], None] = lambda _: None,
) -> MotionForecast:
    """The forecast of a motion from simulated runs of the nominal rig and others, in this order."""
    found = []
    for k, (log, rig) in enumerate(zip(recorded, rigs, strict=True)):
        found.append(forecast_log(log, rig, names, share))
        progress((k + 1) / len(rigs))
    return MotionForecast(
        scenario=str(name),
        seconds=seconds,
        nominal=found[0],
        drawn=tuple(found[1:]),
    )


def forecast_motions(
    scenarios: Sequence[str | Path],
    seconds: float,
    choice: RigChoice,
    names: tuple[str, ...] = DEFAULT_PARAMETERS,
    share: float = FITTED_SHARE,
    progress: Callable[[float], None] = lambda _: None,
) -> list[MotionForecast]:
    """Forecasts of several scenarios, the one that tells most first; arguments as of one."""
    found = []
    chosen = scenarios or EXCITATIONS[choice.axes]
    for k, name in enumerate(chosen):

        def advance(done: float, k: int = k) -> None:
            progress((k + done) / len(chosen))

        found.append(forecast_motion(name, seconds, choice, names, share, advance))
    return sorted(found, key=lambda each: each.score)
