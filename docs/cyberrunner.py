"""Makes cyberrunner.md: laws on simulated rigs like one on which a record was set on hardware.

uv run python docs/cyberrunner.py              # what cyberrunner.toml says
Finished runs are kept in runs/cyberrunner and used again while code and scenarios stay the same.
"""

from __future__ import annotations

import inspect
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

import click
import numpy as np
from scipy.spatial import KDTree

from controllers.arrays import Array, Mask
from docs.cure_family import quantile
from docs.pages import HERE, driven, filled, kept, planned, said, write
from twin.fmu.export import surface_of
from twin.run.assemble import assemble
from twin.run.metrics import Motion
from twin.scenario.schema import Scenario
from twin.study.compiled import LANES, CompiledRig, compiled_runs
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder, c_code, code, controller_key, digest

RECORD = {"median": 3.2, "p90": 6.9, "largest": 12.4, "hold": 2.6}
"""Published of the hardware, mm: distance from the shape, median and 90 % quantile of the frames,
mean of the largest; and the median distance from the middle at rest."""
LAPS = {"first": 0, "third": 2}
"""Laps that are evaluated, and how many are before each."""
CURE = "the cure"
"""Name of the law with which one thing at a time is turned off."""
EVERY = 5
"""Periods from one instant that is evaluated to the next."""


def drawn(plan: Mapping[str, Any], draw: int, count: int) -> list[tuple[Mapping[str, Any], int]]:
    """What rigs of a draw are, and their seeds."""
    family = read_family(plan["family"])
    return [(each.point, each.seed) for each in draw_rigs(family, draw, count)]


def scenarios(
    plan: Mapping[str, Any],
    law: Mapping[str, Any],
    more: Sequence[str],
    rigs: Sequence[tuple[Mapping[str, Any], int]],
) -> list[Scenario]:
    """A law on rigs, with further settings; those that a rig has of its own give way to them."""
    named = {each.partition("=")[0] for each in more}
    build, found = Builder(law["scenario"]), []
    for point, seed in rigs:
        own = {k: v for k, v in point.items() if not any(k.startswith(name) for name in named)}
        found.append(build([*plan["set"], *law["set"], *more, f"seed={seed}"], own))
    return found


def motions_of(runs: Sequence[Scenario]) -> Iterator[Motion | None]:
    """Motions of rigs in compiled code, each until the next is asked for; None of a lost ball."""
    rigs = (CompiledRig(each, surface_of(each)) for each in runs)
    loops = ((compiled_runs(rig, controller_key(rig.scenario)), rig) for rig in rigs)
    for loop, alike in itertools.groupby(loops, key=itemgetter(0)):
        beside = [rig for _, rig in alike]
        for first in range(0, len(beside), LANES):
            yield from loop.run(beside[first : first + LANES])


def errors(motion: Motion | None, during: Mask | None, path: Array | None) -> dict[str, Any]:
    """How far the true ball is from a path, m: median, 90 % quantile, largest.

    Args:
        motion: None of a ball that was lost.
        during: Instants that are evaluated, shape (K,).
        path: Points of the path close together, shape (N, 2).
    """
    if motion is None or during is None or path is None:
        return {"median": None, "p90": None, "largest": None, "rms": None}
    ball = motion.ball[during][::EVERY]
    away = np.asarray(KDTree(path).query(ball)[0])
    behind = np.hypot(*(ball - motion.reference[during][::EVERY]).T)
    return {
        "median": float(np.median(away)),
        "p90": float(np.quantile(away, 0.9)),
        "largest": float(away.max()),
        "rms": float(np.sqrt((behind**2).mean())),
    }


def followed(runs: Sequence[Scenario], shape: Mapping[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """How far the balls were from a shape in the laps, a list for each lap."""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in LAPS}
    for motion in motions_of(runs):
        for name, before in LAPS.items():
            if motion is None:
                found[name].append(errors(None, None, None))
                continue
            since = motion.time - shape["start"] - before * shape["lap"]
            during = (since >= 0) & (since < shape["lap"])
            found[name].append(errors(motion, during, motion.reference[during]))
    return found


def held(runs: Sequence[Scenario], after: float) -> list[dict[str, Any]]:
    """How far the balls were from the middle after a time in s."""
    found = []
    for motion in motions_of(runs):
        during = None if motion is None else motion.time >= after
        found.append(errors(motion, during, np.zeros((1, 2))))
    return found


def known(name: str, runs: Sequence[Scenario], make: Any, *how: Any) -> Any:
    """What is kept of runs, else what is made of them."""
    about = "".join(each.model_dump_json() for each in runs)
    own = " ".join(map(inspect.getsource, (make, motions_of, errors, driven)))
    key = digest(f"{code()} {c_code()} {own} {name} {LAPS} {EVERY} {json.dumps(how)} {about}")
    return kept("cyberrunner", key, lambda: make(runs, *how))


def searched(runs: Sequence[Scenario], candidates: int, start: float) -> list[float | None]:
    """The cost of each candidate, m: the rigs' mean RMS error; None if a ball is lost."""
    duration = runs[0].duration
    record, desired, finished = driven(*assemble(runs, threads=1), duration, every=EVERY)
    late = record.time >= start
    away = np.hypot(*np.moveaxis((record["state"][..., 0::4] - desired)[late], -1, 0))
    cost = np.sqrt((away**2).mean(axis=0)).reshape(candidates, -1).mean(axis=1)
    whole = [all(each) for each in np.reshape(finished, (candidates, -1))]
    return [float(each) if good else None for each, good in zip(cost, whole, strict=True)]


def with_gains(plan: Mapping[str, Any], law: Mapping[str, Any]) -> dict[str, Any]:
    """A law with the best gains of a search, if it has ranges of them."""
    if "gains" not in law:
        return dict(law)
    how, shape = plan["search"], plan["shapes"][0]
    rng, ranges = np.random.default_rng(how["seed"]), law["gains"]
    logs = {name: np.log(ends) for name, ends in ranges.items()}
    words = [
        ",".join(f"{name}={np.exp(rng.uniform(*ends)):.4g}" for name, ends in logs.items())
        for _ in range(how["candidates"])
    ]
    rigs, end = drawn(plan, how["draw"], how["rigs"]), shape["start"] + 1.5 * shape["lap"]
    own = [[each.replace("GAINS", gains) for each in law["set"]] for gains in words]
    more = [*shape["set"], f"duration={end:.2f}"]
    runs = [each for one in own for each in scenarios(plan, {**law, "set": one}, more, rigs)]
    costs = known("search", runs, searched, how["candidates"], shape["start"])
    best = min(range(len(words)), key=lambda at: np.inf if costs[at] is None else costs[at])
    lost = sum(each is None for each in costs)
    return {**law, "set": own[best], "found": words[best], "lost": lost, "cost": costs[best]}


def cell(rows: Sequence[Mapping[str, Any]], name: str, share: float) -> str:
    """A quantile over rigs in mm, lost balls counted as worst; a dash where it is one."""
    value = quantile([each[name] for each in rows], share)
    return said(None if value is None else 1000 * value, ".1f")


def row(name: str, rows: Sequence[Mapping[str, Any]], record: float) -> tuple[str, ...]:
    """A row of a table: quantiles over rigs, rigs within what was published, and lost balls."""
    within = sum(each["median"] is not None and 1000 * each["median"] <= record for each in rows)
    lost = sum(each["median"] is None for each in rows)
    numbers = [cell(rows, "median", 0.5), cell(rows, "median", 1.0), cell(rows, "p90", 0.5)]
    numbers += [cell(rows, "largest", 0.5), cell(rows, "rms", 0.5)]
    return name, *numbers, f"{within} of {len(rows)}", str(lost)


def tables(plan: Mapping[str, Any]) -> dict[str, Any]:
    """What the page has: laws on shapes and at rest, and the cure with one thing turned off."""
    hold, shapes = plan["hold"], plan["shapes"]
    rigs = drawn(plan, plan["draw"], plan["count"])
    laws = [with_gains(plan, law) for law in plan["laws"]]
    found: dict[str, Any] = {"laws": laws, "shapes": [], "hold": [], "causes": [], "held": []}

    def timed(seconds: float) -> str:
        return f"duration={seconds:.2f}"

    for shape in shapes:
        end = timed(shape["start"] + (1 + max(LAPS.values())) * shape["lap"])
        for law in laws:
            runs = scenarios(plan, law, [*shape["set"], end], rigs)
            rows = known("shape", runs, followed, shape)
            found["shapes"] += [
                (shape["name"], lap, *row(law["name"], rows[lap], RECORD["median"])) for lap in LAPS
            ]
            click.echo(f"{shape['name']}: {law['name']}")

    def hold_row(name: str, law: Mapping[str, Any], keys: Sequence[str]) -> tuple[str, ...]:
        more = [*hold["set"], *law.get("hold", []), timed(hold["seconds"]), *keys]
        runs = scenarios(plan, law, more, rigs[: plan["holds"]])
        click.echo(f"hold: {name}")
        return row(name, known("hold", runs, held, hold["from"]), RECORD["hold"])

    found["hold"] = [hold_row(law["name"], law, []) for law in laws]
    found["cured"] = {each[0]: each for each in found["hold"]}
    cure, few = next(law for law in laws if law["name"] == CURE), rigs[: plan["again"]]
    found["held"] = [hold_row(cause, cure, plan["causes"][cause]) for cause in hold["causes"]]
    lap = timed(shapes[0]["start"] + (1 + max(LAPS.values())) * shapes[0]["lap"])
    for cause, keys in plan["causes"].items():
        turning = [*shapes[0]["set"], lap, *keys]
        laps = known("shape", scenarios(plan, cure, turning, few), followed, shapes[0])
        last = laps[list(LAPS)[-1]]
        numbers = [cell(last, name, q) for name in ("median", "rms") for q in (0.5, 1.0)]
        found["causes"].append((cause, *numbers))
        click.echo(cause)
    found["best"] = min(
        found["causes"], key=lambda each: float(each[1]) if each[1] != "-" else np.inf
    )[0]
    return found


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan = planned("cyberrunner")
    family = read_family(plan["family"]).parameters

    def between(key: str) -> str:
        bounds = family[key].uniform
        assert bounds is not None  # the family draws all that the page names from an interval
        return "{:g} to {:g}".format(*bounds)

    words = {"said": said, "between": between, "record": RECORD}
    text = filled("cyberrunner", plan=plan, **words, **tables(plan))
    write(HERE / "cyberrunner.md", text)


if __name__ == "__main__":
    main()
