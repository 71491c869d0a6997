"""Makes cure_margins.md: how wrong a rig may be for the cure, one thing at a time, and all at once.

uv run python docs/cure_margins.py
What has been simulated is kept in runs/cure and used again while scenarios and code stay the same.
"""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from docs.cure import known
from docs.pages import HERE, clopper_pearson, filled, planned, said, write
from twin.study.schema import draw_rigs, read_family
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
    return [*margin.get("also", []), f"{key}={pair or real}"]


def cases(plan: dict[str, Any]) -> list[tuple[str, str, list[str]]]:
    """What is wrong, how much, and what is set for it."""
    return [("nothing", "", [])] + [
        (margin["name"], f"{value:g}", setting(margin, value))
        for margin in plan["margins"]
        for value in margin["values"]
    ]


def found(plan: dict[str, Any]) -> dict[str, list[float | None]]:
    """Of each law e_tt in % with one thing wrong after the other, then on the family's rigs.

    None for a lost ball; all of a law as one batch.
    """
    about, build, values = plan["family"], Builder(CURE["scenario"]), {}
    rigs = draw_rigs(read_family(about["name"]), about["draw"], about["rigs"])
    for name in plan["laws"]:
        fixed = [*plan["set"], *LAWS[name]]
        runs = [build([*fixed, *keys, "seed=1"], {}) for _, _, keys in cases(plan)]
        runs += [build([*fixed, f"seed={rig.seed}"], rig.point) for rig in rigs]
        values[name] = known(runs)
        click.echo(f"{name}: {values[name].count(None)} of {len(runs)} lost")
    return values


def main() -> None:
    """Simulate what is not kept, then write the page."""
    plan = planned("cure_margins")
    about, wrong, values = plan["family"], cases(plan), found(plan)
    rigs = draw_rigs(read_family(about["name"]), about["draw"], about["rigs"])
    rows = [
        (what, much, [values[law][at] for law in plan["laws"]])
        for at, (what, much, _) in enumerate(wrong)
    ]
    on = {law: each[len(wrong) :] for law, each in values.items()}
    cure = np.array([np.inf if each is None else each for each in on["the cure"]])
    kept = sum(
        each is None and any(on[law][at] is not None for law in plan["laws"][1:])
        for at, each in enumerate(on["the cure"])
    )
    held = int((cure <= about["worst"]).sum())
    words = {
        "held": held,
        "share": clopper_pearson(held, len(rigs)),
        "median": float(np.median(cure)),
        "largest": float(cure.max()),
        "kept": kept,
        "worst": [(cure[at], rigs[at].point) for at in np.argsort(-cure)[:5].tolist()],
        "lost": {law: each.count(None) for law, each in on.items()},
    }
    text = filled("cure_margins", plan=plan, rows=rows, said=said, laws=plan["laws"], **words)
    write(HERE / "cure_margins.md", text)


if __name__ == "__main__":
    main()
