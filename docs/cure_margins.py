"""Makes cure_margins.md: how wrong a rig may be for the cure, one thing at a time, and all at once.

uv run python docs/cure_margins.py
What has been simulated is kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np
from cure import known
from pages import HERE, clopper_pearson, filled, planned, said, write

from twin.study.schema import drawn, read_family
from twin.study.work import Builder

CURE = planned("cure")
KNOWN = {each["name"]: each["set"] for each in CURE["laws"]}
LAWS = {
    "the cure": list(KNOWN.values())[-1],
    "LQR": ["controller.kind=lqr"],
    "AFL": KNOWN["AFL, thesis"],
}
VARIANCE = (7.2538e-7, 1.7721e-7)
"""Of a touch sample along x and y in m^2, Table B.1."""


def setting(margin: dict[str, Any], value: float) -> list[str]:
    """What is set of the nominal rig for one value of what is wrong."""
    key, real = margin["key"], value * margin.get("factor", 1.0)
    if margin.get("noise"):
        return [f"{key}={[real**2 * each for each in VARIANCE]}"]
    pair = [real * each for each in margin.get("pair", ())]
    return [f"{key}={pair or real}"]


def table(plan: dict[str, Any]) -> list[tuple[Any, ...]]:
    """Of what is wrong, and how much: e_tt in % under each law; None for a lost ball."""
    none: list[str] = []
    cases = [("nothing", "", none)] + [
        (margin["name"], f"{value:g}", setting(margin, value))
        for margin in plan["margins"]
        for value in margin["values"]
    ]
    build, columns = Builder(CURE["scenario"]), []
    for name in plan["laws"]:
        runs = [build([*plan["set"], *LAWS[name], *keys, "seed=1"], {}) for _, _, keys in cases]
        found = known(runs)
        columns.append(found)
        click.echo(f"{name}: {found.count(None)} of {len(cases)} lost")
    rows = np.array(columns, dtype=object).T.tolist()
    return [(what, much, *row) for (what, much, _), row in zip(cases, rows, strict=True)]


def family(plan: dict[str, Any]) -> tuple[dict[str, list[float | None]], list[Any]]:
    """Of each law e_tt in % on the rigs of the family, and those rigs."""
    about, build = plan["family"], Builder(CURE["scenario"])
    rigs, found = drawn(read_family(about["name"]), about["draw"], about["rigs"]), {}
    for name in plan["laws"]:
        fixed = [*plan["set"], *LAWS[name]]
        found[name] = known([build([*fixed, f"seed={rig.seed}"], rig.point) for rig in rigs])
        click.echo(f"{name}: {found[name].count(None)} of {len(rigs)} lost")
    return found, rigs


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan = planned("cure_margins")
    rows = table(plan)
    found, rigs = family(plan)
    cure = np.array([np.inf if each is None else each for each in found["the cure"]])
    kept = sum(
        each is None and any(found[law][at] is not None for law in plan["laws"][1:])
        for at, each in enumerate(found["the cure"])
    )
    held = int((cure <= plan["family"]["worst"]).sum())
    worst = [(cure[at], rigs[at].point) for at in np.argsort(-cure)[:5].tolist()]
    words = {
        "held": held,
        "share": clopper_pearson(held, len(rigs)),
        "median": float(np.median(cure)),
        "largest": float(cure.max()),
        "kept": kept,
        "worst": worst,
        "lost": {law: values.count(None) for law, values in found.items()},
    }
    text = filled("cure_margins", plan=plan, rows=rows, said=said, laws=plan["laws"], **words)
    write(HERE / "cure_margins.md", text)


if __name__ == "__main__":
    main()
