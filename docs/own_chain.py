"""Makes own_chain.md: the first excitation and the cure on rigs that nobody has tried.

uv run python docs/own_chain.py            # 50 drawn rigs
uv run python docs/own_chain.py --rigs 1   # one of each kind
Runs are in C (``twin.study.compiled``). Finished ones are kept in runs/own_chain and used again
while scenarios and code stay the same.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import click

from docs.cure_family import quantile
from docs.pages import HERE, clopper_pearson, compiled_rows, filled, said, write
from twin.scenario.load import load
from twin.scenario.schema import Scenario, at_study_step
from twin.study.schema import draw_rigs, read_family
from twin.study.work import Builder

KINDS = {
    "": "thesis",
    "course": "course",
    "hobby": "hobby",
    "three_legs": "three_legs",
    "balancer": "balancer",
}
"""Shipped rigs with a plate around which rigs are drawn, and what the page calls them."""
FAMILY, DRAW, RIGS = "own", 6509, 10
"""Family of what an owner does not know, its draw, and rigs of each kind."""
FIXED = ("baseline=false", "plant.kind=lagrange")
"""Set in every run: the exact equations."""
EXCITED_S = 40.0
"""Length of the excitation in s."""
GOAL_PERCENT = 3.0
"""Largest tracking error of the cure that counts as working, %."""


class Rig(NamedTuple):
    """A drawn rig."""

    kind: str
    """The shipped rig whose file its owner uses; empty for that of the thesis."""
    truth: tuple[str, ...]
    """What it is, as overrides."""

    @property
    def known(self) -> tuple[str, ...]:
        """What its owner knows, as overrides."""
        return (f"parameters={self.kind}",) if self.kind else ()


def drawn(kind: str, count: int) -> list[Rig]:
    """Rigs around a shipped one."""
    family, builder = read_family(FAMILY), Builder("excite")
    relative = {key for key, each in family.parameters.items() if each.relative}
    known = Rig(kind, ()).known
    found = []
    for each in draw_rigs(family, DRAW, count):
        whole = {**builder.whole_keys(known, each.point, relative), "seed": each.seed}
        found.append(Rig(kind, tuple(f"{key}={json.dumps(v)}" for key, v in whole.items())))
    return found


def scenario_of(name: str, rig: Rig, *more: str) -> Scenario:
    """A scenario on a rig, with what its owner knows of it."""
    return at_study_step(load(name, [*rig.known, *FIXED, *more, *rig.truth]))


def known(runs: Sequence[Scenario]) -> list[dict[str, Any]]:
    """Outcome and tracking error of runs, on the true ball."""
    return compiled_rows("own_chain", runs, ("outcome", "reason", "tracking_error_percent"))


class Found(NamedTuple):
    """Results of the rigs of a kind."""

    kept: int
    """Rigs that kept the ball in `excite`."""
    errors: list[float | None]
    """Tracking error of the cure in %; None for a ball that was lost."""

    @property
    def cured(self) -> int:
        """Rigs on which the cure works."""
        return sum(each is not None and each <= GOAL_PERCENT for each in self.errors)


def found_of(rigs: Sequence[Rig]) -> Found:
    """The first excitation and the cure on rigs of a kind."""
    excited = known([scenario_of("excite", each, f"duration={EXCITED_S}") for each in rigs])
    for each, row in zip(rigs, excited, strict=True):
        if row["outcome"] != "finished":
            click.echo(f"{KINDS[each.kind]}: {row['reason']}: {' '.join(each.truth)}")
    errors = [
        row["tracking_error_percent"] for row in known([scenario_of("cure", each) for each in rigs])
    ]
    return Found(sum(row["outcome"] == "finished" for row in excited), errors)


def share(hits: int, count: int) -> str:
    """How many of how many, with the exact 95 % interval of the share."""
    low, high = clopper_pearson(hits, count)
    return f"{hits} of {count} ({low:.0f} to {high:.0f} %)"


@click.command()
@click.option("--rigs", type=click.IntRange(min=1), default=RIGS, show_default=True)
@click.option("--only", type=click.Choice(list(KINDS.values())), help="One kind, without the page.")
def main(rigs: int, only: str | None) -> None:
    """Carry out excite and the cure on drawn rigs, then write the page."""
    table = {}
    for kind, name in KINDS.items():
        if only in (None, name):
            table[name] = found_of(drawn(kind, rigs))
            click.echo(f"{name}: {table[name]}")
    if only is None:
        parts = {"table": table, "quantile": quantile, "said": said, "share": share}
        about = {"draw": DRAW, "family": FAMILY, "seconds": EXCITED_S, "goal": GOAL_PERCENT}
        write(HERE / "own_chain.md", filled("own_chain", rigs=rigs, **about, **parts))


if __name__ == "__main__":
    main()
