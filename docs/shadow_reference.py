"""Makes shadow_reference.md: how often `shadow --reference` errs about a log's first row.

uv run python docs/shadow_reference.py

Rigs of the family `uncertain`. The twin is learned from a reference log of each, and compared
with the beginning of other logs of it: healthy ones, and ones of a rig that has changed before.
Constants of the comparison are set from the calibration rigs, which are not those that are judged.
What has been tried is kept in runs/shadow_reference and used again while the code stays the same.
"""

from __future__ import annotations

import inspect
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from scipy.optimize import minimize

from controllers.arrays import Array
from docs.pages import HERE, filled, kept, wilson, write
from docs.shadow_trials import (
    DELAY,
    FAMILY,
    HEALTHY,
    HEALTHY_SCENARIOS,
    LEVEL,
    ROLLING,
    whole_settings,
)
from twin.base.errors import TwinError
from twin.cli.output import progress
from twin.identify.balls import ball_inertia
from twin.identify.logs import Log
from twin.scenario.load import load
from twin.scenario.schema import at_study_step
from twin.shadow.belief import logs
from twin.shadow.evidence import gaps
from twin.shadow.learning import (
    COMPARED_PARAMETERS,
    HEALTHY_CHANGE_STDS,
    LEARNING_S,
    MAX_CHANCE_STDS,
    Difference,
    beginning,
    compare_with_reference,
    fit_belief,
    learn,
    prepare_for,
    shift_parameters,
)
from twin.shadow.reference import learn_reference, learn_twin
from twin.study.schema import draw_rigs, read_family
from twin.study.work import digest

DRAWS = {"calibration": 63_001, "judged": 63_002}
"""Seeds of the draws of rigs."""
REFERENCE_S, OTHER_S = 30.0, LEARNING_S + 1.0
"""Seconds of a reference log, and of another log."""
TOGETHER = 5
"""Rigs that are simulated side by side."""
Settings = dict[str, Any]
CHANGES = {
    "rolling friction x 2": ("rolling",),
    "level 0.5 deg": ("level_phi", "level_theta"),
    "dead time +30 ms": ("delay",),
    "tilt gain -15 %": ("gain",),
}
"""What has changed before the first row, and the parameters that show it."""
GAIN_SHARE = 0.85
"""Share of the acceleration by gravity that is left of a ball with another gain."""


class Other(NamedTuple):
    """A log that is compared with the reference of its rig."""

    kind: str
    scenario: str


def others(number: int, *, changed: bool) -> list[Other]:
    """The logs of a rig, by its number in the draw."""
    healthy = [Other(HEALTHY, scenario) for scenario in HEALTHY_SCENARIOS]
    if not changed:
        return healthy
    turns = len(HEALTHY_SCENARIOS)
    return healthy + [
        Other(kind, HEALTHY_SCENARIOS[(number + place) % turns])
        for place, kind in enumerate(CHANGES)
    ]


def change(true: Settings, kind: str, rng: np.random.Generator) -> Settings:
    """What has become of a rig, by the keys of a scenario."""
    if kind == "rolling friction x 2":
        return {**true, ROLLING: 2 * true[ROLLING]}
    if kind == "level 0.5 deg":
        heading = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(heading), np.sin(heading)])
        return {**true, LEVEL: (np.array(true[LEVEL]) + 0.5 * way).tolist()}
    if kind == "dead time +30 ms":
        return {**true, DELAY: true[DELAY] + 0.03}
    if kind == "tilt gain -15 %":
        ball = load("circle").plant.model
        share = 1 / (1 + ball.inertia / (ball.mass * ball.radius**2))
        inertia = ball_inertia(ball.mass, ball.radius, GAIN_SHARE * share)
        return {**true, "plant.ball.inertia": inertia}
    return true


def simulate(rigs: Sequence[tuple[Settings, str, int]], seconds: float) -> list[Log]:
    """Logs that do not state their rig.

    Args:
        rigs: Settings, scenario and seed of each.
        seconds: Length of the logs.
    """
    pairs = []
    for settings, scenario, seed in rigs:
        common = [f"duration={seconds}", f"seed={seed}"]
        own = [f"{key}={value}" for key, value in settings.items()]
        pairs.append([at_study_step(load(scenario, [*common, *each])) for each in ([], own)])
    return [replace(log, scenario={}) for log in logs([(a, b) for a, b in pairs])]


def carry_out(draw: str, numbers: Sequence[int], *, identified: bool) -> list[dict[str, Any]]:
    """Compare the other logs of rigs with their references: a row of each in JSON.

    Args:
        draw: In ``DRAWS``.
        numbers: Which rigs of it.
        identified: Whether `identify` finds the twin that learns from the reference; else it is the
            rig as the project describes it.
    """
    points = draw_rigs(read_family(FAMILY), DRAWS[draw], max(numbers) + 1)
    true = {number: whole_settings(points[number].point) for number in numbers}
    seeds = {number: 100 * (DRAWS[draw] + number) for number in numbers}
    first = simulate([(true[n], "excite", seeds[n]) for n in numbers], REFERENCE_S)
    work = [(n, each) for n in numbers for each in others(n, changed=draw == "judged")]
    rigs = []
    for place, (number, other) in enumerate(work):
        rng = np.random.default_rng([seeds[number], place])
        settings = change(true[number], other.kind, rng)
        rigs.append((settings, other.scenario, seeds[number] + 1 + place % 99))
    rows = []
    references = {}
    for number, log in zip(numbers, first, strict=True):
        overrides: tuple[str, ...] = ()
        with tempfile.TemporaryDirectory() as folder:
            if identified:
                overrides = learn_reference(log, Path(folder)).overrides
            references[number] = learn_twin(log, overrides)
    for (number, other), log in zip(work, simulate(rigs, OTHER_S), strict=True):
        about = {"number": number, "identified": identified, **other._asdict(), "why": ""}
        try:
            belief = references[number]
            usable = prepare_for(log, belief)
            found = compare_with_reference(beginning(usable), belief, gaps(log, usable.period))
            rows.append({**about, "differences": [asdict(each) for each in found]})
        except TwinError as error:
            rows.append({**about, "why": str(error), "differences": []})
    return rows


def known(draw: str, numbers: tuple[int, ...], *, identified: bool) -> list[dict[str, Any]]:
    """What is found of some rigs: as kept, or tried and then kept.

    The constants of the comparison are applied afterwards, and change nothing of it.
    """
    rooms = [Path(str(files(f"twin.{room}"))) for room in ("shadow", "identify")]
    names = ("belief.py", "belief.toml", "evidence.py")
    sources = [*(rooms[0] / name for name in names), *sorted(rooms[1].rglob("*.py"))]
    parts: tuple[Callable[..., Any], ...] = (
        others,
        change,
        simulate,
        carry_out,
        learn_twin,
        learn,
        fit_belief,
        shift_parameters,
    )
    parts += (prepare_for, beginning, compare_with_reference)
    how = " ".join([each.read_text(encoding="utf-8") for each in sources])
    how += " ".join(inspect.getsource(each) for each in parts)
    key = digest(f"{how} {draw} {numbers} {identified}")
    return kept("shadow_reference", key, lambda: carry_out(draw, numbers, identified=identified))


def groups(count: int) -> list[tuple[int, ...]]:
    """Numbers of rigs that are simulated side by side."""
    return [
        tuple(range(begin, min(begin + TOGETHER, count))) for begin in range(0, count, TOGETHER)
    ]


def differences(row: Mapping[str, Any]) -> list[Difference]:
    """The parameters of a compared log, the largest deviation first."""
    found = [Difference(**each) for each in row["differences"]]
    return sorted(found, key=lambda each: -abs(each.deviation))


def significant(row: Mapping[str, Any]) -> list[Difference]:
    """Those of them that chance does not explain."""
    return [each for each in differences(row) if each.significant]


def share(hits: int, count: int) -> str:
    """How many of how many, and Wilson's 95 % interval of the share in percent."""
    if not count:
        return "- of 0"
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({low:.0f} to {high:.0f} %)"


def fit_chance(rows: Sequence[Mapping[str, Any]], name: str) -> tuple[float, float]:
    """The most likely scale and standard deviation between logs of a parameter.

    Changes are taken as normal with the variance (scale * fit_std)^2 + between^2.

    Args:
        rows: Of healthy logs.
        name: The parameter.
    """
    found = [each for row in rows for each in differences(row) if each.name == name]
    squares = np.array([each.change / each.unit for each in found]) ** 2
    errors = np.array([each.fit_std / each.unit for each in found])
    usual = float(np.sqrt(squares.mean()))

    def cost(x: Array) -> float:
        variance = (np.exp(x[0]) * errors) ** 2 + (usual * np.exp(x[1])) ** 2
        return float((np.log(variance) + squares / variance).sum())

    # a fit does not state too large errors of itself
    bounds = [(0.0, np.log(20.0)), (np.log(1e-3), np.log(3.0))]
    starts = [(0.1, -0.1), (0.1, -4.0), (1.5, -4.0), (1.0, -1.0)]
    best = min(
        (minimize(cost, start, bounds=bounds) for start in starts), key=lambda each: each.fun
    )
    return float(np.exp(best.x[0])), usual * float(np.exp(best.x[1]))


def largest_deviation(rows: Sequence[Mapping[str, Any]], name: str) -> float:
    """The largest deviation of a parameter with the constants in use."""
    found = [each for row in rows for each in differences(row) if each.name == name]
    return max(abs(each.deviation) for each in found)


def healthy_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Healthy logs of each scenario and of all, and how many are told to differ."""
    table = []
    for name in (*HEALTHY_SCENARIOS, "all"):
        some = [row for row in rows if name in (row["scenario"], "all")]
        table.append((name, share(sum(bool(significant(row)) for row in some), len(some))))
    return table


def changed_table(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Of each change: how many are told to differ, and by which parameter."""
    table: list[tuple[str, ...]] = []
    for kind, names in CHANGES.items():
        some = [row for row in rows if row["kind"] == kind]
        told = [found for row in some if (found := significant(row))]
        named = sum(any(each.name in names for each in found) for found in told)
        first = sum(found[0].name in names for found in told)
        table.append((kind, share(len(told), len(some)), f"{named}", f"{first}"))
    return table


def page(
    judged: Sequence[dict[str, Any]],
    calibration: Sequence[dict[str, Any]],
    whole: Sequence[dict[str, Any]],
    command: str,
) -> str:
    """The page in Markdown.

    Args:
        judged: Logs of the judged rigs.
        calibration: Logs of the calibration rigs.
        whole: Logs of judged rigs with a twin that `identify` found.
        command: That makes this page.
    """
    fine, changed, own, own_changed = (
        [row for row in rows if (row["kind"] == HEALTHY) == well and not row["why"]]
        for rows in (judged, whole)
        for well in (True, False)
    )
    tried = [row for row in calibration if not row["why"]]
    return filled(
        "shadow_reference",
        command=command,
        reference=REFERENCE_S,
        learned=LEARNING_S,
        stds=MAX_CHANCE_STDS,
        rigs=len({row["number"] for row in judged}),
        mute=sum(bool(row["why"]) for row in judged),
        healthy=healthy_table(fine),
        changed=changed_table(changed),
        alarmed=[
            (row["number"], row["scenario"], each.words, f"{abs(each.deviation):.1f}")
            for row in fine
            for each in significant(row)
        ],
        whole_rigs=len({row["number"] for row in whole}),
        whole=healthy_table(own)[-1][1],
        whole_changed=share(sum(bool(significant(row)) for row in own_changed), len(own_changed)),
        calibration_rigs=len({row["number"] for row in tried}),
        calibration_logs=len(tried),
        calibration=[
            (
                name,
                *(f"{value:.2g}" for value in fit_chance(tried, name)),
                *(f"{HEALTHY_CHANGE_STDS[name][key]:.2g}" for key in ("scale", "between")),
                f"{largest_deviation(tried, name):.1f}",
            )
            for name in COMPARED_PARAMETERS
        ],
    )


@click.command()
@click.option("--rigs", type=click.IntRange(min=0), default=20, help="How many are judged.")
@click.option("--calibration", type=click.IntRange(min=1), default=10, help="Others.")
@click.option("--whole", type=click.IntRange(min=0), default=2, help="Judged rigs identified too.")
def main(rigs: int, calibration: int, whole: int) -> None:
    """Compare logs of simulated rigs with references, and write how often that is right."""
    plan = [("calibration", part, False) for part in groups(calibration)]
    plan += [("judged", part, False) for part in groups(rigs)]
    plan += [("judged", part, True) for part in groups(whole)]
    rows: dict[tuple[str, bool], list[dict[str, Any]]] = {
        key: [] for key in (("calibration", False), ("judged", False), ("judged", True))
    }
    with progress("rigs with a reference", 1.0) as advance:
        for done, (draw, numbers, identified) in enumerate(plan):
            rows[draw, identified] += known(draw, numbers, identified=identified)
            advance((done + 1) / len(plan))
    command = (
        f"uv run python docs/shadow_reference.py --rigs {rigs} --calibration {calibration} "
        f"--whole {whole}"
    )
    calibrated, judged, identified_too = rows.values()
    write(HERE / "shadow_reference.md", page(judged, calibrated, identified_too, command))


if __name__ == "__main__":
    main()
