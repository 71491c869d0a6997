"""Makes plan.md: what identify --plan forecasts of simulated rigs beside what identify then finds.

uv run python docs/plan.py --rigs 30 --again 12

Rigs of the family `uncertain`, drawn by their number, each simulated, identified as a user would,
and forecast at its own numbers from a run with noise of its own; some are identified twice, from
runs that differ in their noise. What has been found is kept in runs/plan and used again while the
code stays the same.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import scipy

from controllers.arrays import Array
from docs.pages import HERE, filled, kept, wilson, write
from twin.base.errors import TwinError
from twin.cli.output import progress
from twin.identify.logs import Log
from twin.identify.parameters import DEFAULT_PARAMETERS
from twin.identify.twin_model import identify_twin
from twin.identify.verdicts import IDENTIFIED_VERDICT
from twin.plan.experiment import MotionForecast, RigChoice, forecast_motion
from twin.plan.forecast import forecast_log, half_width
from twin.plan.motion import optimise_motion, write_motion
from twin.scenario.schema import Scenario, at_study_step
from twin.shadow.belief import logs
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder, code, digest

FAMILY, SCENARIO, SECONDS = "uncertain", "excite", 40.0
"""Of what the rigs are, what they do, and for how long; the last third is held out."""
DRAW = 63_201
"""Of the rigs."""
SEEN = 14
"""The first of them, which were looked at while the method was made."""
FIRST_RUN, SECOND_RUN, PLANNED_RUN = range(3)
"""Runs of a rig, each with noise of its own."""
WITHIN = 1.3
"""Factor within which a forecast is to be."""
BETWEEN = WITHIN ** math.sqrt(2)
"""Factor within which two runs of a rig agree as often as one is within the above of the median of
all its runs, if the logarithms of its widths scatter normally: the best that a forecast can do."""
SHOWN = {
    "rolling": "plant.friction.rolling_mm",
    "breakaway": "plant.friction.breakaway_ratio",
    "delay": "sensors.touch.dead_time",
    "servo": "plant.servo.bandwidth_hz",
    "level_phi": "plant.level_deg (phi)",
    "level_theta": "plant.level_deg (theta)",
}

Found = Mapping[str, Any]
"""What was found of a rig: why nothing, or parameter to verdict."""


@cache
def recorded(rigs: int) -> dict[tuple[int, int], tuple[Scenario, Log]]:
    """All runs of so many rigs, made in one batch: number in the draw and run to rig and log."""
    build, fixed = Builder(SCENARIO), [f"duration={SECONDS}"]
    believed = at_study_step(build(fixed, {}))
    drawn = draw_rigs(read_family(FAMILY), DRAW, rigs)
    every = {
        (number, run): at_study_step(build([*fixed, f"seed={rig.seed + run}"], rig.point))
        for number, rig in enumerate(drawn)
        for run in (FIRST_RUN, SECOND_RUN, PLANNED_RUN)
    }
    made = logs([(believed, truth) for truth in every.values()])
    return dict(zip(every, zip(every.values(), made, strict=True), strict=True))


def identified(truth: Scenario, log: Log) -> dict[str, Any]:
    """What identify finds in the log of a rig."""
    try:
        found = identify_twin(log, DEFAULT_PARAMETERS)
    except TwinError as error:
        return {"why": str(error), "verdicts": {}}
    return {
        "why": "",
        "white": found.whiteness.white,
        "rejected": found.whiteness.rejected,
        "fitted": found.fit.problem.names,
        "windows": len(found.fit.problem.windows),
        "verdicts": {each.name: each.as_dict() for each in found.verdicts},
    }


def forecast(truth: Scenario, log: Log) -> dict[str, Any]:
    """What is forecast of a rig at its own numbers."""
    found = forecast_log(log, truth)
    return {
        "why": found.why,
        "indistinct": found.indistinct,
        "verdicts": {each.name: each.as_dict() for each in found.verdicts},
    }


def known(
    make: Callable[[Scenario, Log], dict[str, Any]], number: int, run: int, rigs: int
) -> dict[str, Any]:
    """What a function makes of a run of a rig, one of so many: as kept, or made and then kept."""
    sources = sorted(Path(str(files("twin.identify"))).rglob("*.py"))
    if make is forecast:
        sources.append(Path(inspect.getfile(forecast_log)))
    about = (inspect.getsource(recorded.__wrapped__), inspect.getsource(make))
    own = [*about, FAMILY, SCENARIO, str((SECONDS, DRAW))]
    how = " ".join((*own, *(path.read_text(encoding="utf-8") for path in sources)))
    key = digest(f"{code()} {how} {number} {run}")
    found: dict[str, Any] = kept("plan", key, lambda: make(*recorded(rigs)[number, run]))
    return found


OPTIMISED_S, COMPARED_RIGS, COMPARED_DRAW = 20.0, 12, 63_202
"""Length of the optimised motion, and the rigs on which it is compared with the shipped one."""
FURTHER_RIGS, FURTHER_SEEN, FURTHER_DRAW = 60, 12, 71_905
"""Rigs of another draw: those behind the first ones, which were seen before, test the motion."""


def optimised() -> dict[str, Any]:
    """The optimised motion, and half widths of it and of the shipped one on other rigs."""
    choice = RigChoice(rigs=COMPARED_RIGS, draw=COMPARED_DRAW)
    found = optimise_motion(SCENARIO, OPTIMISED_S, choice)
    shipped = [forecast_motion(SCENARIO, each, choice) for each in (OPTIMISED_S, 2 * OPTIMISED_S)]
    others = RigChoice(rigs=FURTHER_RIGS, draw=FURTHER_DRAW)
    with TemporaryDirectory() as folder:
        file = Path(folder) / "motion.toml"
        write_motion(file, found)
        further = [
            forecast_motion(file, OPTIMISED_S, others),
            forecast_motion(SCENARIO, 2 * OPTIMISED_S, others),
        ]
    return {
        "motion": found.describe(),
        "text": found.text,
        "forecasts": [each.as_dict() for each in (found.forecast, *shipped)],
        "further": [list(rig_scores(each))[FURTHER_SEEN:] for each in further],
    }


def rig_scores(found: MotionForecast) -> Iterator[float]:
    """The score of a motion on each drawn rig alone."""
    for rig in found.drawn:
        yield replace(found, nominal=rig, drawn=()).score


def known_optimised() -> dict[str, Any]:
    """The same, as kept, or made and then kept."""
    rooms = (Path(str(files(f"twin.{room}"))) for room in ("identify", "plan"))
    sources = [each.read_text(encoding="utf-8") for room in rooms for each in room.rglob("*.py")]
    rigs = (COMPARED_RIGS, COMPARED_DRAW, FURTHER_RIGS, FURTHER_SEEN, FURTHER_DRAW)
    about = (inspect.getsource(optimised), inspect.getsource(rig_scores), str((OPTIMISED_S, *rigs)))
    found: dict[str, Any] = kept(
        "plan", digest(" ".join((code(), *about, *sorted(sources)))), optimised
    )
    return found


def half(found: Found, name: str) -> float:
    """Half width of a parameter's interval, to its longer side; infinite without one."""
    each = found["verdicts"].get(name)
    verdict: Any = SimpleNamespace(**each) if each else None
    return half_width(verdict)


def ratios(above: Sequence[Found], below: Sequence[Found], name: str) -> np.ndarray:
    """Half width of one over that of the other, of rigs where both have one."""
    pairs = [(half(a, name), half(b, name)) for a, b in zip(above, below, strict=True)]
    return np.array([a / b for a, b in pairs if math.isfinite(a) and math.isfinite(b)])


def within(found: np.ndarray, factor: float) -> str:
    """Share of ratios within a factor in percent, and its interval."""
    near = np.abs(np.log(found)) <= math.log(factor)
    low, high = wilson(int(near.sum()), len(found))
    return f"{100 * near.mean():.0f} ({low:.0f} to {high:.0f})"


def cells(found: np.ndarray, factor: float = WITHIN) -> tuple[str, ...]:
    """Rigs, median of their ratios, share within the factor in percent, factor that 90 % keep."""
    if not len(found):
        return "0", "-", "-", "-"
    most = math.exp(float(np.quantile(np.abs(np.log(found)), 0.9)))
    return str(len(found)), f"{np.median(found):.2f}", within(found, factor), f"{most:.2f}"


def rows(
    above: Sequence[Found], below: Sequence[Found], factor: float = WITHIN
) -> Iterator[tuple[str, ...]]:
    """A row for each parameter, and one for all."""
    every = {name: ratios(above, below, name) for name in SHOWN}
    for name, found in every.items():
        yield SHOWN[name], *cells(found, factor)
    yield "all of these", *cells(np.concatenate(list(every.values())), factor)


def near_middle(planned: Sequence[Found], one: Sequence[Found], other: Sequence[Found]) -> str:
    """Share of forecasts near the geometric mean of the widths of two runs, in percent."""
    pairs = (
        (half(p, name), math.sqrt(half(a, name) * half(b, name)))
        for name in SHOWN
        for p, a, b in zip(planned, one, other, strict=True)
    )
    return within(np.array([p / m for p, m in pairs if math.isfinite(p + m)]), WITHIN)


def verdicts(planned: Sequence[Found], found: Sequence[Found]) -> Iterator[tuple[str, ...]]:
    """Of each parameter: on how many rigs `identified` was forecast, and came true."""

    def holds(one: Found, name: str) -> bool:
        each = one["verdicts"].get(name)
        return each is not None and each["verdict"] == IDENTIFIED_VERDICT

    for name, key in SHOWN.items():
        pairs = [(holds(a, name), holds(b, name)) for a, b in zip(planned, found, strict=True)]
        yes, no = ([true for said, true in pairs if said == word] for word in (True, False))
        yield key, f"{sum(yes)} of {len(yes)}", f"{sum(no)} of {len(no)}"


def blind(planned: Sequence[Found], found: Sequence[Found]) -> Iterator[tuple[str, ...]]:
    """Of each parameter: the forecast over all rigs, against what was found of each."""
    for name, key in SHOWN.items():
        halves = np.array([half(each, name) for each in planned])
        there = np.array([half(each, name) for each in found])
        there = there[np.isfinite(there)]
        middle = float(np.median(halves))
        low, high = np.quantile(halves, (0.05, 0.95), method="nearest")
        inside = int(((there >= low) & (there <= high)).sum())
        yield (
            key,
            f"{middle:.2g}",
            f"{low:.2g} to {high:.2g}",
            f"{np.median(there):.2g}",
            f"{inside} of {len(there)}",
        )


def widths(forecast: Mapping[str, Any], name: str) -> float:
    """Median half width of a parameter on the drawn rigs."""
    drawn = ({"verdicts": {v["name"]: v for v in rig["verdicts"]}} for rig in forecast["rigs"][1:])
    return float(np.median([half(each, name) for each in drawn]))


def motions(forecasts: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """Of each parameter the half widths of every motion, and their mean."""
    for name, key in SHOWN.items():
        sizes = [widths(each, name) for each in forecasts]
        yield key, *(f"{each:.2g}" if math.isfinite(each) else "-" for each in sizes)
    yield "mean, over what counts as identified", *(f"{each['score']:.2g}" for each in forecasts)


def geometric_mean(ratios: Array) -> tuple[float, float, float]:
    """The geometric mean of ratios, and its 95 % interval by their scatter (Student's t)."""
    found = scipy.stats.ttest_1samp(np.log(ratios), 0.0).confidence_interval(0.95)
    return float(np.exp(np.log(ratios).mean())), math.exp(found.low), math.exp(found.high)


def compare(
    forecasts: Sequence[Mapping[str, Any]], further: tuple[Sequence[float], Sequence[float]]
) -> str:
    """What the optimised motion gains, in a sentence.

    Args:
        forecasts: Of the optimised motion, of the shipped one in the same time and in twice that.
        further: Scores of the first and the last of these on each further rig that was not seen.
    """
    own, same, twice = (each["score"] for each in forecasts)
    ratios = np.divide(*further)
    mean, low, high = geometric_mean(ratios)
    met = "met" if high <= 1 else "**not met**" if low > 1 else "**not shown to be met**"
    sizes = {key: widths(forecasts[0], n) / widths(forecasts[2], n) for n, key in SHOWN.items()}
    wider = ", ".join(f"`{key}` ({size:.1f} times)" for key, size in sizes.items() if size > 1)
    return (
        f"In the same time its half widths are {own / same:.2f} times those of `{SCENARIO}` "
        f"(geometric mean), and {own / twice:.2f} times those of `{SCENARIO}` in twice the time. "
        f"Wider in the median than in twice the time: {wider or 'none'}.\n\n"
        f"**The goal**, the same mean in half the time, is tested on {len(ratios)} rigs of one "
        f"more draw: the mean is {mean:.2f} times ({low:.2f} to {high:.2f}, 95 % interval by the "
        f"scatter of the rigs) that of `{SCENARIO}` in twice the time, and at most as large on "
        f"{int((ratios <= 1).sum())} of them. The goal is {met}."
    )


def page(
    planned: Sequence[Found],
    found: Sequence[Found],
    again: Sequence[Found],
    optimised: Mapping[str, Any],
) -> str:
    """The page of what was found."""
    every = np.concatenate([ratios(planned, found, name) for name in SHOWN])
    return filled(
        "plan",
        family=FAMILY,
        scenario=SCENARIO,
        seconds=SECONDS,
        rigs=len(found),
        refused=sum(bool(each["why"]) for each in found),
        again=len(again),
        within=WITHIN,
        met=bool(np.mean(np.abs(np.log(every)) <= math.log(WITHIN)) >= 0.9),
        seen=SEEN,
        forecast=[
            *rows(planned, found),
            (f"all of these, rigs {SEEN} on", *list(rows(planned[SEEN:], found[SEEN:]))[-1][1:]),
        ],
        repeated=list(rows(again, found[: len(again)], BETWEEN)) if again else [],
        between=BETWEEN,
        near=near_middle(planned[: len(again)], found[: len(again)], again) if again else "",
        verdicts=list(verdicts(planned, found)),
        blind=list(blind(planned, found)),
        optimised=optimised,
        optimised_s=OPTIMISED_S,
        compared=COMPARED_RIGS,
        shown=[
            f"{name}, {each['seconds']:.0f} s"
            for name, each in zip(
                ("optimised", SCENARIO, SCENARIO), optimised["forecasts"], strict=True
            )
        ],
        motions=list(motions(optimised["forecasts"])),
        verdict=compare(optimised["forecasts"], optimised["further"]),
    )


@click.command()
@click.option("--rigs", type=click.IntRange(min=2), default=30, help="Rigs.")
@click.option("--again", type=click.IntRange(min=0), default=12, help="Of these identified twice.")
def main(rigs: int, again: int) -> None:
    """Compare forecasts with identifications, and write how near they are."""
    jobs = [(identified, n, FIRST_RUN) for n in range(rigs)]
    jobs += [(identified, n, SECOND_RUN) for n in range(min(again, rigs))]
    jobs += [(forecast, n, PLANNED_RUN) for n in range(rigs)]
    found = []
    with progress("runs", len(jobs)) as advance:
        for job in jobs:
            found.append(known(*job, rigs))
            advance(len(found))
    text = page(found[-rigs:], found[:rigs], found[rigs:-rigs], known_optimised())
    write(HERE / "plan.md", text)


if __name__ == "__main__":
    main()
