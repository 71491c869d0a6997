"""Makes cure_family.md: the cure on many rigs of the family, the worst by name, and why.

uv run python docs/cure_family.py              # what cure_family.toml says: 40 minutes of a core
uv run python docs/cure_family.py --own        # cure_rigs.md, on rigs of other kinds: 15 minutes
Finished batches are kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import click
import numpy as np

from docs.cure import KINDS, Cell, cells, known, scenarios, settings
from docs.cure_floor import least
from docs.pages import HERE, clopper_pearson, filled, planned, said, write
from twin.study.schema import FamilyRig, draw_rigs, read_family
from twin.study.work import Builder

CURE = planned("cure")
LAW = CURE["laws"][-1]
RADIUS = {"circle 2 rad/s, 130 mm": 0.13}
"""Of a circle's way in m, where it is not 0.15."""


class Worst(NamedTuple):
    """One of the worst rigs of a task."""

    number: int
    """Which of the family's, from 1."""
    scenario: Any
    value: float | None
    turned: dict[str, float | None]
    """What is left of it with one cause turned back."""
    floor: float | None
    """The least in % that anybody could reach on a way never seen, in the mean of such screens."""

    @property
    def cause(self) -> str:
        """What helps most when it is turned back, and to how much."""
        name, left = min(self.turned.items(), key=lambda each: _order(each[1]))
        return f"{name}: {said(left, '.2f')}"


class Found(NamedTuple):
    """What a task gave."""

    nominal: list[float | None]
    """Of the nominal rig, one noise each."""
    slow: list[float | None]
    """The same at 58 frames/s."""
    floor: float | None
    """The least of that in %, as of the worst rigs."""
    family: list[float | None]
    """Of every rig."""
    worst: list[Worst]

    def quantile(self, share: float) -> float | None:
        """A quantile of the family, lost balls counted as worst; None where it is one."""
        return quantile(self.family, share)

    def within(self, goal: float) -> tuple[int, float, float]:
        """How many rigs keep a goal, and the exact 95 % interval of their share in %."""
        count = sum(_order(value) <= goal for value in self.family)
        return count, *clopper_pearson(count, len(self.family))


def quantile(values: list[float | None], share: float) -> float | None:
    """A quantile of some rigs, lost balls counted as worst; None where it is one."""
    ordered = sorted(values, key=_order)
    return ordered[min(int(np.ceil(share * len(ordered))), len(ordered)) - 1]


def _order(value: float | None) -> float:
    return np.inf if value is None else value


def tasks(plan: dict[str, Any]) -> list[dict[str, Any]]:
    """Those of the plan; what it leaves out of one is as cure.toml says."""
    told = {task["name"]: task for task in CURE["tasks"]}
    return [told.get(task["name"], {}) | task for task in plan["tasks"]]


def family(plan: dict[str, Any]) -> list[FamilyRig]:
    """The rigs."""
    return draw_rigs(read_family(CURE["family"]), plan["draw"], plan["rigs"])


def measured(plan: dict[str, Any], task: dict[str, Any]) -> Found:
    """A task on all rigs, the worst of them again with one cause after the other turned back."""
    judged = task.get("judged", "tracking")
    base = CURE | {"draw": plan["draw"], "rigs": plan["rigs"], "laws": [LAW]}
    runs, noises = scenarios(base, task), CURE["noises"]
    quick = base | {"rigs": 1, "set": [*CURE["set"], "sensors.touch.frame_rate=58.0"]}
    slow = scenarios(quick, task)[:noises]
    first = known([*runs[:noises], *slow], judged)
    rigs, values = runs[noises:], []
    for begin in range(0, len(rigs), plan["batch"]):
        values += known(rigs[begin : begin + plan["batch"]], judged)
        click.echo(f"{task['name']}: {len(values)} rigs")
    order = sorted(range(len(rigs)), key=lambda each: _order(values[each]))[::-1]
    worst = []
    for at in order[: plan["named"]]:
        turned = [without(task, family(plan)[at], keys) for keys in plan["causes"].values()]
        left = dict(zip(plan["causes"], known(turned, judged), strict=True))
        worst.append(Worst(at + 1, rigs[at], values[at], left, edge(task, rigs[at])))
    return Found(first[:noises], first[noises:], edge(task, slow[0]), values, worst)


def edge(task: dict[str, Any], rig: Any) -> float | None:
    """The floor of a task on a rig in %; None where it is no circle."""
    if not task["name"].startswith("circle"):
        return None
    return least(rig, RADIUS.get(task["name"], 0.15), task["omega"])


def excused(asked: list[dict[str, Any]], table: dict[str, Found]) -> str:
    """Whether the floor of a worst rig, or of the nominal one at 58 frames/s, is above its goal."""
    floors = []
    for task in asked:
        found, name, (_, slow, goal) = table[task["name"]], task["name"], task["goals"]
        edges = [(found.floor, slow, "nominal rig at 58 frames/s")]
        edges += [(one.floor, goal, f"rig {one.number}") for one in found.worst]
        floors += [
            (each / most, f"{each:.2f} against {most:g} % ({whose}, {name})")
            for each, most, whose in edges
            if each is not None
        ]
    above = [words for share, words in floors if share > 1]
    if above:
        start = "The floor is above the goal, so no controller could reach the goal: "
        return start + "; ".join(above)
    nearest = max(floors, key=lambda each: each[0])[1]
    return (
        f"The floor is below the goal on all {len(floors)} circles, those of the worst rigs and "
        f"the nominal one at 58 frames/s, so it excuses no miss. The nearest is {nearest}."
    )


def without(task: dict[str, Any], rig: FamilyRig, keys: list[str]) -> Any:
    """A rig some of whose parameters are the nominal one's again."""
    point = {key: value for key, value in rig.point.items() if not key.startswith(tuple(keys))}
    fixed = [*settings(CURE, task, LAW), f"seed={rig.seed}"]
    return Builder(CURE["scenario"])(fixed, point)


UNTOLD = "rig.plate_lag=0"
"""Not told how late the plate follows, which the observer then finds up to 30 ms of."""


def radius(rig: str) -> float:
    """Of the circle of a shipped rig, m."""
    return Builder("circle")([f"parameters={rig}"], {}).reference.settings["amplitude"]


def others(plan: dict[str, Any], rig: str, task: dict[str, Any]) -> list[Cell]:
    """What every law reaches on a shipped rig, and on the rigs about it."""
    family = read_family(plan["family"])
    relative = [key for key, each in family.parameters.items() if each.relative]
    length, runs = str(radius(rig)), []
    for law in plan["laws"]:
        build = Builder(law["scenario"])
        own = [each.replace("RADIUS", length) for each in task["set"]]
        fixed = [f"parameters={rig}", *plan["set"], *own, *law["set"]]
        runs += [build([*fixed, f"seed={noise}"], {}) for noise in range(plan["noises"])]
        runs += [
            build([*fixed, f"seed={each.seed}"], each.point, relative)
            for each in draw_rigs(family, plan["draw"], plan["count"])
        ]
    return cells(plan, known(runs, task.get("judged", "tracking")))


def blamed(plan: dict[str, Any], rig: str) -> dict[str, list[float | None]]:
    """The nominal rig's circle without one cause after the other: told the lag, and not told."""
    build, circle = Builder("cure"), plan["tasks"][0]["set"]
    fixed = [f"parameters={rig}", *plan["set"], *circle]
    told = [build([*fixed, *keys], {}) for keys in plan["causes"].values()]
    not_told = [build([*fixed, UNTOLD, *keys], {}) for keys in plan["causes"].values()]
    left = known([*told, *not_told])
    return {cause: [left[at], left[at + len(told)]] for at, cause in enumerate(plan["causes"])}


def write_others(plan: dict[str, Any]) -> None:
    """Write the page of the shipped rigs of other kinds."""
    causes = {rig: blamed(plan, rig) for rig in plan["rigs"]}
    places = [(rig, task) for rig in plan["rigs"] for task in plan["tasks"]]
    table = {(rig, task["name"]): others(plan, rig, task) for rig, task in places}
    words = {"kinds": KINDS, "said": said, "radius": radius, "quantile": quantile}
    text = filled("cure_rigs", plan=plan, table=table, causes=causes, **words)
    write(HERE / "cure_rigs.md", text)


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan = planned("cure_family")
    if sys.argv[1:] == ["--own"]:
        write_others(plan["own"])
        return
    asked = tasks(plan)
    table = {task["name"]: measured(plan, task) for task in asked}
    words = {"kinds": KINDS, "said": said, "excused": excused(asked, table)}
    write(
        HERE / "cure_family.md",
        filled("cure_family", plan=plan, tasks=asked, table=table, **words),
    )


if __name__ == "__main__":
    main()
