"""Makes tuned.md and its picture: every law tuned with the same budget, judged on fresh rigs.

uv run python docs/tuned.py    # what tuned.toml says
Finished runs are kept in runs/tuned and used again while what a run executes stays the same, also
by a larger budget; what a search found, while all that it read does.
"""

from __future__ import annotations

import inspect
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.figure import Figure

from docs.pages import HERE, filled, kept, planned, points, said, write
from twin.study.experiments import Store, executors
from twin.study.work import code, digest
from twin.tune.search import carry_out_tune
from twin.tune.trials import Trials, read

OWN, KNOWN = ", thesis", ", friction known"
BUDGET = ("candidates", "rigs", "finalists", "certificate")
FREE = {"title", "like", "set", "fields"}
"""What of its tune a law has for itself; all else is the same for every law."""


def asked(plan: dict[str, Any]) -> dict[str, Any]:
    """The tune of every law by name, with the budget that all have.

    Raises:
        ClickException: If one differs from the others in anything but what is its own.
    """
    budget = {key: plan[key] for key in BUDGET}
    found = {law["name"]: read(law["tune"], set=law.get("set"), **budget) for law in plan["laws"]}
    first, *others = found.items()
    for name, tune in others:
        terms = sorted(set(type(tune).model_fields) - FREE)
        unlike = [key for key in terms if getattr(tune, key) != getattr(first[1], key)]
        if unlike:
            raise click.ClickException(f"{name}: other {', '.join(unlike)} than {first[0]}")
    return found


def files() -> list[Path]:
    """The files that a search reads: more than its runs do, as costs, margins, families, tasks."""
    folders = ("src", "controllers", "scenarios", "models")
    found = (path for folder in folders for path in (HERE.parent / folder).rglob("*"))
    return sorted(path for path in found if path.suffix in {".py", ".toml", ".xml", ".json"})


def key(tune: Any) -> str:
    """What tells the result of a tune from every other: all that the search depends on."""
    texts = [digest(path.read_bytes().hex()) for path in files()]
    texts += [code(), version("optuna"), inspect.getsource(result), tune.model_dump_json()]
    return digest(" ".join(texts))


def result(tune: Any) -> dict[str, Any]:
    """What a tune finds, as its ``--json`` says."""
    with executors(None) as (executor, count):
        store = Store(HERE.parent / "runs" / "tuned")
        return carry_out_tune(Trials(tune, store, executor=executor, processes=count)).as_dict()


def fewer(plan: dict[str, Any], found: dict[str, dict[str, Any]]) -> list[str]:
    """Laws that ran fewer candidates than they might, as others had no margin.

    Raises:
        ClickException: If one had more than its budget.
    """
    less = []
    for name, about in found.items():
        ran = sum(each["rigs"] > 0 for each in about["candidates"])
        fresh = [about[side]["rigs"] for side in ("before", "after")]
        had = (about["search_rigs"], *fresh) != (plan["rigs"][-1], *[plan["certificate"]] * 2)
        if ran > plan["candidates"] or had:
            raise click.ClickException(
                f"{name}: not the budget of the others: {ran} candidates on up to "
                f"{about['search_rigs']} rigs, {fresh[0]} and {fresh[1]} fresh ones"
            )
        if ran < plan["candidates"]:
            less.append(f"{name} ({ran})")
    return less


def order(about: dict[str, Any]) -> tuple[int, float]:
    """Who is better on fresh rigs: first who loses fewer of them, then who costs less."""
    after = about["after"]
    return after["failures"], np.inf if after["cost"] is None else after["cost"]


def cell(about: dict[str, Any], task: str) -> str:
    """Median and largest RMS distance of a task in mm, before and after."""
    sides = []
    for side in ("before", "after"):
        found = about[side]["tasks"][task]
        if found["median"] is None:
            sides.append("-")
        else:
            sides.append(f"{1e3 * found['median']:.2g}, {1e3 * found['largest']:.2g}")
    return " → ".join(sides)


def page(plan: dict[str, Any], found: dict[str, dict[str, Any]], tune: Any) -> str:
    """The page as Markdown."""
    names = sorted(found, key=lambda name: order(found[name]))
    return filled(
        "tuned", plan=plan, tune=tune, found={name: found[name] for name in names}, cell=cell,
        said=said, shares=shares(found), less=fewer(plan, found),
    )  # fmt: skip


def shares(found: dict[str, dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Of laws that were tuned with and without the observer, what each came to."""
    both = {}
    for name, own in found.items():
        law = name.removesuffix(OWN)
        known = found.get(law + KNOWN)
        if law != name and known is not None:
            both[law] = [each[side] for each in (own, known) for side in ("before", "after")]
    return both


def drawing(found: dict[str, dict[str, Any]], path: Path) -> None:
    """The picture: the cost of every law before and after."""
    names = sorted(found, key=lambda name: order(found[name]), reverse=True)
    costs = [[found[name][side]["cost"] for side in ("before", "after")] for name in names]
    beyond = 2 * max((cost for pair in costs for cost in pair if cost is not None), default=1.0)
    figure = Figure(figsize=(9, 1.2 + 0.28 * len(names)), layout="constrained")
    axis = figure.subplots()
    for at, when in enumerate(("before", "after")):
        values = [pair[at] for pair in costs]
        points(axis, values, beyond, (when, f"a rig lost {when}"), full=at == 1, large=at == 1)
    axis.set_yticks(range(len(names)), names)
    axis.set(xscale="log", xlabel="cost of the worst rigs, 1 = 1 % of the circle")
    axis.grid(color="0.9")
    figure.legend(loc="outside upper right", ncols=4, fontsize="small")
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Tune what is not tuned yet, then write the page."""
    plan, found = planned("tuned"), {}
    tunes = asked(plan)
    for name, tune in tunes.items():
        found[name] = kept("tuned", key(tune), partial(result, tune))
        click.echo(f"{name}: lost and cost {order(found[name])}")
    drawing(found, HERE / "figures" / "tuned.svg")
    write(HERE / "tuned.md", page(plan, found, next(iter(tunes.values()))))


if __name__ == "__main__":
    main()
