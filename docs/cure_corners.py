"""Makes cure_corners.md: the worst corner of the family's box that a search finds, task by task.

uv run python docs/cure_corners.py     # the tasks of [corners] in cure_family.toml
Finished batches are kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from docs.cure import KINDS, known, settings
from docs.cure_family import CURE, LAW, tasks
from docs.pages import HERE, filled, planned, said, write
from twin.study.schema import Family, read_family
from twin.study.work import Builder

CHANGED = 0.12
"""Share of the ends that differ from both parents'."""


class Corner(NamedTuple):
    """A corner of the box: at which end every parameter is, and what is random on such a rig."""

    high: tuple[bool, ...]
    screen: int
    noise: int

    def point(self, family: Family) -> dict[str, Any]:
        """The parameters of the rig."""
        found: dict[str, Any] = {}
        for (key, each), high in zip(family.parameters.items(), self.high, strict=True):
            if each.integers is not None:
                found[key] = self.screen
            elif each.values is not None:
                found[key] = each.values[-1 if high else 0]
            else:
                found[key] = each.ends[int(high)]
        return found


class Search(NamedTuple):
    """What a task's search found."""

    runs: int
    worst: Corner
    value: float | None
    others: list[float | None]
    """Of the same corner on other screens, under other noises."""


def judged(task: dict[str, Any], corners: list[Corner], family: Family) -> list[float | None]:
    """What a task gives on corners."""
    build, fixed = Builder(CURE["scenario"]), settings(CURE, task, LAW)
    runs = [build([*fixed, f"seed={each.noise}"], each.point(family)) for each in corners]
    return known(runs, task.get("judged", "tracking"))


def searched(task: dict[str, Any], plan: dict[str, Any], family: Family) -> Search:
    """Corners drawn at random, then, generation after generation, children of the worst of them.

    A child has every end of one of two parents, and now and then the other one.
    """
    rng = np.random.default_rng(plan["draw"])
    count = len(family.parameters)

    def fresh(high: NDArray[np.bool_]) -> Corner:
        screen, noise = rng.integers(1_000_000), rng.integers(2**31)
        return Corner(tuple(high.tolist()), int(screen), int(noise))

    corners = [fresh(rng.random(count) < 0.5) for _ in range(plan["first"])]
    values = judged(task, corners, family)
    for _ in range(plan["generations"]):
        order = np.argsort([-np.inf if v is None else -v for v in values])
        parents = [corners[at] for at in order[: plan["parents"]].tolist()]
        children = []
        for _ in range(plan["children"]):
            a, b = (np.array(parents[at].high) for at in rng.integers(len(parents), size=2))
            high = np.where(rng.random(count) < 0.5, a, b)
            children.append(fresh(high ^ (rng.random(count) < CHANGED)))
        corners += children
        values += judged(task, children, family)
    at = int(np.argmin([-np.inf if v is None else -v for v in values]))
    again = [fresh(np.array(corners[at].high)) for _ in range(plan["again"])]
    return Search(len(corners), corners[at], values[at], judged(task, again, family))


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan, family, found = planned("cure_family"), read_family(CURE["family"]), []
    about = plan["corners"] | {"parameters": len(family.parameters)}
    for task in tasks(plan):
        if task["name"] in about["tasks"]:
            search = searched(task, about, family)
            click.echo(f"{task['name']}: {search}")
            found.append((task, search, search.worst.point(family)))
    words = {"kinds": KINDS, "said": said, "family": CURE["family"], "about": about}
    left = [task["name"] for task in tasks(plan) if task["name"] not in about["tasks"]]
    text = filled("cure_corners", found=found, left=left, **words)
    write(HERE / "cure_corners.md", text)


if __name__ == "__main__":
    main()
