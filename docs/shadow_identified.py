"""Makes shadow_identified.md: what identify finds of simulated rigs, and what the shadow says.

uv run python docs/shadow_identified.py --rigs 15 --identified 66

Simulated rigs of the family `uncertain`, each identified from a log as a user would; of some the
intervals are held against the truth, others are watched by a twin of what was identified.
What has been tried is kept in runs/shadow_identified and used again while the code stays the same.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pandas as pd

from docs.pages import HERE, filled, kept, wilson, write
from docs.shadow_trials import (
    AT,
    DURATION,
    FAMILY,
    HEALTHY,
    HEALTHY_SCENARIOS,
    IN_TIME,
    KINDS,
    LEVEL,
    RAMP,
    Settings,
    _changed,
    alarms,
    judged_rigs,
    slowly,
    whole_settings,
)
from twin.base.errors import TwinError
from twin.base.jobs import cores, results
from twin.cli.output import progress
from twin.identify.logs import Log
from twin.identify.parameters import BALL_PARAMETERS, DEFAULT_PARAMETERS, FITTED_SHARE
from twin.identify.report import parameters
from twin.identify.twin_model import identify_twin, replay_log
from twin.identify.verdicts import HOLD_OUT, IDENTIFIED_VERDICT, score
from twin.scenario.load import load
from twin.scenario.schema import Scenario, at_study_step
from twin.shadow.belief import belief_of, logs
from twin.shadow.causes import likely
from twin.shadow.follow import shadow
from twin.study.schema import draw_rigs, read_family
from twin.study.work import code, digest

DRAW = 9_140
"""Of the rigs."""
FRESH = 58_317
"""The same of those of which only the intervals are judged: none was used to make the method."""
FIRST = 400_000
"""Seed of the first rig."""
TOGETHER = 3
"""Rigs that are simulated side by side; something happens to the first of them."""
EXCITED = "excite"
"""What a rig does while it is identified, and when something happens to it."""
HAPPENS = [name for name, kind in KINDS.items() if "patch" not in kind and "lost" not in name]
"""What happens, by turns: rigs of the family have uneven screens and lost motion from the start."""


TRUTHS = {
    "rolling": ("plant.friction.rolling_mm", "mm"),
    "breakaway": ("plant.friction.breakaway_ratio", ""),
    "delay": ("sensors.touch.dead_time", "s"),
    "servo": ("plant.servo.bandwidth_hz", "Hz"),
    "level_phi": (f"{LEVEL}.0", "deg"),
    "level_theta": (f"{LEVEL}.1", "deg"),
}
"""What is identified, by the keys of the family."""


class Watched(NamedTuple):
    """A run beside which the twin runs: of which rig, what it does, what happens to it."""

    seed: int
    scenario: str
    kind: str


def watched(number: int) -> list[Watched]:
    """The runs of a rig after it was identified; by its number in the draw."""
    seed = FIRST + number
    scenario = HEALTHY_SCENARIOS[(number + number // TOGETHER) % len(HEALTHY_SCENARIOS)]
    runs = [Watched(seed, scenario, HEALTHY)]
    if number % TOGETHER == 0:
        runs.append(Watched(seed, EXCITED, HAPPENS[number // TOGETHER % len(HAPPENS)]))
    return runs


def simulated(true: Settings, run: Watched, place: int) -> tuple[Scenario, Scenario]:
    """What a user without a twin of the rig believes of it, and the rig.

    Args:
        true: What the rig is.
        run: What it does.
        place: Number of the run of this rig: each has noise of its own.
    """
    common = [f"duration={DURATION}", f"seed={10 * run.seed + place}"]
    more = []
    if run.kind != HEALTHY:
        rng = np.random.default_rng([run.seed, 18])
        over = RAMP if slowly(run.seed, run.kind) else 0.0
        changed = _changed(KINDS[run.kind], true, rng).items()
        values = ", ".join(f'"{key}"={json.dumps(value)}' for key, value in changed)
        more = [f"change=[{{at={AT}, over={over}, set={{{values}}}}}]"]
    truth = load(run.scenario, [*common, *(f"{key}={value}" for key, value in true.items()), *more])
    return at_study_step(load(run.scenario, common)), at_study_step(truth)


def known(job: tuple[bool, tuple[int, ...]]) -> list[dict[str, Any]]:
    """What is said of some rigs, watched or identified only: as kept, or tried and then kept."""
    watching, numbers = job
    rooms = [Path(str(files(f"twin.{room}"))) for room in ("shadow", "identify")[not watching :]]
    sources = [Path(__file__), *(HERE / f"shadow{end}" for end in ("_trials.py", ".toml"))]
    for end in ("py", "toml"):
        sources += [each for room in rooms for each in sorted(room.rglob(f"*.{end}"))]
    how = " ".join(each.read_text(encoding="utf-8") for each in sources)
    key = digest(f"{code()} {how} {job}")
    make = carry_out if watching else judged
    return kept("shadow_identified", key, lambda: make(numbers))


def judged(numbers: Sequence[int]) -> list[dict[str, Any]]:
    """What `ballplate identify` finds of rigs beside the truth: a row for each in JSON."""
    points = [each.point for each in draw_rigs(read_family(FAMILY), FRESH, max(numbers) + 1)]
    runs = [Watched(2 * FIRST + number, EXCITED, HEALTHY) for number in numbers]
    pairs = [
        simulated(whole_settings(points[k]), run, 0) for k, run in zip(numbers, runs, strict=True)
    ]
    return [
        {"number": number, **found_of(log, points[number])}
        for number, log in zip(numbers, logs(pairs), strict=True)
    ]


def found_of(log: Log, point: Mapping[str, Any]) -> dict[str, Any]:
    """Verdicts of a log with the truth, and how far off after 1 s the part held out is predicted.

    Args:
        log: Of 60 s.
        point: The truth, by the keys of the family.
    """
    try:
        found = identify_twin(log, DEFAULT_PARAMETERS)
    except TwinError as error:
        return {"why": str(error)}
    verdicts = {
        each.name: (each.word, point[TRUTHS[each.name][0]], each.value, each.low, each.high)
        for each in found.verdicts
        if each.name in TRUTHS
    }
    # the rig as the project describes it, in place of what was found
    usual = {"rolling": 1.8e-4, "delay": 0.042, "breakaway": 1.0}
    names = found.fit.problem.names
    theta = np.array([[usual.get(name, max(0.0, BALL_PARAMETERS[name].least)) for name in names]])
    nominal = replace(found.fit, found=found.fit.found._replace(theta=theta))
    off = score(replay_log(found.log.split(FITTED_SHARE)[1], nominal, 0.0)).median["model"]
    at = HOLD_OUT.horizons_s.index(1.0)
    errors = {who: each[at] for who, each in found.scores[0].median.items()}
    return {
        "why": "",
        "white": not found.whiteness.rejected,
        "uneven": found.fit.problem.windows.white is not None,
        "verdicts": verdicts,
        "errors": {**errors, "nominal": off[at]},
    }


def carry_out(numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Simulate, identify and watch rigs: a row for each watched run in JSON.

    Args:
        numbers: Which of the draw.
    """
    rigs = draw_rigs(read_family(FAMILY), DRAW, max(numbers) + 1)
    runs: list[tuple[int, Watched, tuple[Scenario, Scenario]]] = []
    for number in numbers:
        true = whole_settings(rigs[number].point)
        each = [Watched(FIRST + number, EXCITED, HEALTHY), *watched(number)]
        runs += [(number, run, simulated(true, run, n)) for n, run in enumerate(each)]
    recorded = list(zip(runs, logs([pair for *_, pair in runs]), strict=True))
    found = []
    for number in numbers:
        (_, first), *others = ((run, log) for (rig, run, _), log in recorded if rig == number)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "parameters.toml")
            names = identified(first, file)
            given = [f"parameters={file}"] if names else []
            for run, log in others:
                for learning in (True, False) if run.kind == HEALTHY else (True,):
                    about = {**run._asdict(), "learning": learning, "identified": names}
                    found.append({**about, **said(log, given, learning=learning)})
    return found


def identified(log: Log, file: Path) -> list[str]:
    """What `ballplate identify` finds in a log, written to a file."""
    try:
        found = identify_twin(log, DEFAULT_PARAMETERS)
    except TwinError:
        return []
    file.write_text(parameters(found), encoding="utf-8")
    return [each.name for each in found.verdicts if each.word == IDENTIFIED_VERDICT]


def said(log: Log, given: Sequence[str], *, learning: bool) -> dict[str, Any]:
    """What a twin with such settings says of a run; why it says nothing.

    When there was the first alarm in s, what it was held to be, and the median score.
    """
    nothing: dict[str, Any] = {"alarm": None, "causes": [], "score": None, "why": ""}
    try:
        found = shadow(log, belief_of(log, given), learning=learning)
    except TwinError as error:
        return {**nothing, "why": str(error)}
    for alarm in found.alarms[:1]:
        nothing["alarm"] = alarm.time
        nothing["causes"] = [cause.name for cause in likely(alarm.causes)]
    return {**nothing, "score": found.score_median}


def groups(count: int) -> Iterator[tuple[int, ...]]:
    """Numbers of rigs that are simulated side by side."""
    for begin in range(0, count, TOGETHER):
        yield tuple(range(begin, min(begin + TOGETHER, count)))


def share(hits: int, count: int) -> str:
    """How many of how many, and Wilson's 95 % interval of the share in percent."""
    if not count:
        return "- of 0"
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({low:.0f} to {high:.0f} %)"


def healthy(rigs: pd.DataFrame) -> tuple[str, str, str]:
    """False alarms, median score and largest score of healthy rigs."""
    score = rigs["score"].dropna().astype(float)
    middle = "-" if score.empty else f"{score.median():.2f}"
    most = "-" if score.empty else f"{score.min():.2f} to {score.max():.2f}"
    return share(int(rigs["alarm"].notna().sum()), len(rigs)), middle, most


def causes(row: Mapping[Any, Any]) -> str:
    """What an alarm was held to be."""
    return ", ".join(row["causes"]) or "-"


def coverage(rigs: Sequence[dict[str, Any]]) -> list[tuple[Any, ...]]:
    """Rows of a table: of each parameter its verdicts, intervals that hold, and half widths."""
    table = []
    for name, (key, unit) in TRUTHS.items():
        every = [rig["verdicts"][name] for rig in rigs]
        ends = [
            (word, true, value, low, np.inf if high is None else high)
            for word, true, value, low, high in every
            if low is not None
        ]
        good = [each for each in ends if each[0] == IDENTIFIED_VERDICT]
        held, sure = (
            share(sum(low <= true <= high for _, true, _, low, high in some), len(some))
            for some in (ends, good)
        )
        middle = [
            f"{np.median(numbers):.2g}" if numbers else "-"
            for numbers in (
                [(high - low) / 2 for *_, low, high in good],
                [abs(value - true) for _, true, value, *_ in good],
            )
        ]
        table.append((key, unit, f"{len(good)} of {len(every)}", sure, held, *middle))
    return table


def page(rows: Sequence[dict[str, Any]], fresh: Sequence[dict[str, Any]], command: str) -> str:
    """The page in Markdown.

    Args:
        rows: What was said of every watched run.
        fresh: What was identified of the other rigs.
        command: That makes this page.
    """
    told = [each for each in fresh if not each["why"]]
    errors = {
        who: f"{1000 * np.median([each['errors'][who] for each in told]):.2g}"
        for who in ("model", "nominal", "without friction", "stays", "goes on")
    }
    better = sum(each["errors"]["model"] < each["errors"]["nominal"] for each in told)
    every = judged_rigs(rows)
    judged = every[every["why"] == ""]
    fine, without = (
        judged[(judged["kind"] == HEALTHY) & (judged["learning"] == learning)]
        for learning in (True, False)
    )
    changed = judged[judged["kind"] != HEALTHY]
    rest, timely, right = alarms(changed)
    first = without["alarm"].dropna()
    found = fine["identified"].str.len() > 0
    parts = [("something was identified", fine[found]), ("nothing was identified", fine[~found])]
    parts += [(str(name), some) for name, some in fine.groupby("scenario")]
    return filled(
        "shadow_identified",
        command=command,
        seconds=DURATION,
        excited=EXCITED,
        fresh=len(fresh),
        refused=len(fresh) - len(told),
        rejected=sum(not each["white"] for each in told),
        uneven=sum(each["uneven"] for each in told),
        coverage=coverage(told),
        errors=errors,
        better=share(better, len(told)),
        scenarios=HEALTHY_SCENARIOS,
        at=AT,
        ramp=RAMP,
        in_time=IN_TIME,
        rigs=every["seed"].nunique(),
        mute=every[every["why"] != ""]["seed"].nunique(),
        healthy=healthy(fine),
        without=healthy(without),
        first="-" if first.empty else f"{first.median():.1f} s, the last at {first.max():.1f} s",
        early=len(changed) - rest,
        timely=share(timely, rest),
        right=share(right, timely),
        by=[(name, *healthy(some)) for name, some in parts],
        empty=int((~found).sum()),
        judged=len(fine),
        alarmed=[
            (row["seed"] - FIRST, row["scenario"], f"{row['alarm']:.1f}", causes(row))
            for row in fine[fine["alarm"].notna()].to_dict("records")
        ],
        changed=[
            (
                row["seed"] - FIRST,
                ", ".join(row["identified"]) or "nothing",
                row["kind"] + (", along a ramp" if slowly(row["seed"], row["kind"]) else ""),
                "-" if np.isnan(row["alarm"]) else f"{row['alarm'] - AT:.1f}",
                "yes" if row["in_time"] else "no",
                causes(row),
                "yes" if row["named"] else "no",
            )
            for row in changed.to_dict("records")
        ],
    )


@click.command()
@click.option("--rigs", type=click.IntRange(min=1), default=15, help="How many are watched.")
@click.option("--identified", "fresh", type=click.IntRange(min=1), default=66, help="Others.")
def main(rigs: int, fresh: int) -> None:
    """Identify simulated rigs, let the twins watch them, and write how good that is."""
    parts = [
        (watching, some) for watching in (False, True) for some in groups((fresh, rigs)[watching])
    ]
    jobs = list(enumerate(parts))
    found: dict[bool, list[dict[str, Any]]] = {False: [], True: []}
    with progress("rigs that are identified and watched", 1.0) as advance:
        for done, (job, some) in enumerate(results(known, jobs, cores())):
            found[parts[job][0]] += some
            advance((done + 1) / len(jobs))
    command = f"uv run python docs/shadow_identified.py --rigs {rigs} --identified {fresh}"
    write(HERE / "shadow_identified.md", page(found[True], found[False], command))


if __name__ == "__main__":
    # what other processes work on has to lie in a module
    from docs.shadow_identified import main as of_module

    of_module()
