"""Makes shadow_identified.md: what the shadow says with twins that were identified from logs.

uv run python docs/shadow_identified.py --rigs 24 --doc docs/shadow_identified.md

Simulated rigs of the family `uncertain`, each identified from a log as a user would, then watched.
What has been tried is kept in runs/shadow_identified and used again while the code stays the same.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
import pandas as pd
from pages import HERE, filled, kept
from scipy import stats
from shadow_trials import (
    AT,
    DURATION,
    FAMILY,
    HEALTHY,
    HEALTHY_SCENARIOS,
    IN_TIME,
    KINDS,
    RAMP,
    Settings,
    _changed,
    _whole,
    alarms,
    judged_rigs,
    slowly,
)

from twin.cli.options import PROCESSES
from twin.cli.output import progress
from twin.errors import TwinError
from twin.identify.judged import IDENTIFIED
from twin.identify.logs import Log
from twin.identify.parameters import DEFAULT
from twin.identify.report import parameters
from twin.identify.twin_model import identify
from twin.jobs import cores, results
from twin.scenario.load import load
from twin.scenario.schema import Scenario, at_study_step
from twin.shadow.alarms import likely
from twin.shadow.belief import believed, logs
from twin.shadow.follow import shadow
from twin.study.schema import drawn, read_family
from twin.study.work import code, digest
from twin.writing import write_whole

DRAW = 9_140
"""Of the rigs."""
FIRST = 400_000
"""Seed of the first rig."""
TOGETHER = 3
"""Rigs that are simulated side by side; something happens to the first of them."""
EXCITED = "excite"
"""What a rig does while it is identified, and when something happens to it."""
HAPPENS = [name for name, kind in KINDS.items() if "patch" not in kind and "lost" not in name]
"""What happens, by turns: rigs of the family have uneven screens and lost motion from the start."""


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


def known(numbers: tuple[int, ...]) -> list[dict[str, Any]]:
    """What is said of some rigs: as kept, or tried and then kept."""
    rooms = [Path(str(files(f"twin.{room}"))) for room in ("shadow", "identify")]
    sources = [Path(__file__), *(HERE / f"shadow{end}" for end in ("_trials.py", ".toml"))]
    for end in ("py", "toml"):
        sources += [each for room in rooms for each in sorted(room.rglob(f"*.{end}"))]
    how = " ".join(each.read_text(encoding="utf-8") for each in sources)
    key = digest(f"{code()} {how} {numbers}")
    found: list[dict[str, Any]] = kept("shadow_identified", key, lambda: carry_out(numbers))
    return found


def carry_out(numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Simulate, identify and watch rigs: a row for each watched run in JSON.

    Args:
        numbers: Which of the draw.
    """
    rigs = drawn(read_family(FAMILY), DRAW, max(numbers) + 1)
    runs: list[tuple[int, Watched, tuple[Scenario, Scenario]]] = []
    for number in numbers:
        true = _whole(rigs[number].point)
        each = [Watched(FIRST + number, EXCITED, HEALTHY), *watched(number)]
        runs += [(number, run, simulated(true, run, n)) for n, run in enumerate(each)]
    recorded = list(zip(runs, logs([pair for *_, pair in runs]), strict=True))
    found = []
    for number in numbers:
        (_, first), *others = ((run, log) for (rig, run, _), log in recorded if rig == number)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "parameters.toml")
            names = identified(first, file)
            for run, log in others:
                for learning in (True, False) if run.kind == HEALTHY else (True,):
                    about = {**run._asdict(), "learning": learning, "identified": names}
                    found.append({**about, **said(log, file, learning=learning)})
    return found


def identified(log: Log, file: Path) -> list[str]:
    """What `ballplate identify` finds in a log, written to a file, which is empty if it is nothing.

    The command writes no file then.
    """
    file.write_text("", encoding="utf-8")
    try:
        found = identify(log, DEFAULT)
    except TwinError:
        return []
    file.write_text(parameters(found), encoding="utf-8")
    return [each.name for each in found.verdicts if each.word == IDENTIFIED]


def said(log: Log, file: Path, *, learning: bool) -> dict[str, Any]:
    """What a twin with the parameters of a file says of a run; why it says nothing.

    When there was the first alarm in s, what it was held to be, and the median score.
    """
    nothing: dict[str, Any] = {"alarm": None, "causes": [], "score": None, "why": ""}
    try:
        found = shadow(log, believed(log, [f"parameters={file}"]), learning=learning)
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
    ends = stats.binomtest(hits, count).proportion_ci(method="wilson")
    return f"{hits} of {count} ({100 * ends.low:.0f} to {100 * ends.high:.0f} %)"


def healthy(rigs: pd.DataFrame) -> tuple[str, str, str]:
    """False alarms, median score and largest score of healthy rigs."""
    score = rigs["score"].dropna().astype(float)
    middle = "-" if score.empty else f"{score.median():.2f}"
    most = "-" if score.empty else f"{score.min():.2f} to {score.max():.2f}"
    return share(int(rigs["alarm"].notna().sum()), len(rigs)), middle, most


def causes(row: Mapping[Any, Any]) -> str:
    """What an alarm was held to be."""
    return ", ".join(row["causes"]) or "-"


def page(rows: Sequence[dict[str, Any]], command: str) -> str:
    """The page in Markdown.

    Args:
        rows: What was said of every watched run.
        command: That makes this page.
    """
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
@click.option("--rigs", type=click.IntRange(min=1), default=24, help="How many.")
@click.option("--doc", type=click.Path(path_type=Path), default=HERE / "shadow_identified.md")
@PROCESSES
def main(rigs: int, doc: Path, processes: int | None) -> None:
    """Identify simulated rigs, let the twins watch them, and write how good that is."""
    jobs = list(enumerate(groups(rigs)))
    found: list[dict[str, Any]] = []
    with progress("rigs that are identified and watched", 1.0) as advance:
        for done, (_, some) in enumerate(results(known, jobs, processes or cores())):
            found += some
            advance((done + 1) / len(jobs))
    text = page(found, f"uv run python docs/shadow_identified.py --rigs {rigs}")
    write_whole(doc, lambda path: path.write_text(text, encoding="utf-8"))


if __name__ == "__main__":
    # what other processes work on has to lie in a module
    from shadow_identified import main as of_module

    of_module()
