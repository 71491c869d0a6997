"""Makes tuned.md and its picture: every law tuned with the same budget, judged on fresh rigs.

uv run python docs/tuned.py                          # what tuned.toml says
uv run python docs/tuned.py --only "AFL, thesis"     # one law; no page
uv run python docs/tuned.py --finished               # a page of the laws that are tuned, at once
Finished runs are kept in runs/tuned and used again while what a run executes stays the same, also
by a larger budget; what a search found, while all that it read does.
"""

from __future__ import annotations

import inspect
import json
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import numpy as np

HERE = Path(__file__).parent
OWN, KNOWN = ", thesis", ", friction known"
BUDGET = ("candidates", "rigs", "finalists", "certificate")
FREE = {"title", "like", "set", "fields"}
"""What of its tune a law has for itself; all else is the same for every law."""


def asked(plan: dict[str, Any]) -> dict[str, Any]:
    """The tune of every law by name, with the budget that all have.

    Raises:
        ClickException: If one differs from the others in anything but what is its own.
    """
    from twin.tune.schema import read  # noqa: PLC0415

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
    from twin.scenario.load import read as read_tables  # noqa: PLC0415
    from twin.study.family import read as read_family  # noqa: PLC0415
    from twin.study.work import code, digest  # noqa: PLC0415

    texts = [digest(path.read_bytes().hex()) for path in files()]
    texts += [code(), version("optuna"), inspect.getsource(result), tune.model_dump_json()]
    texts.append(read_family(tune.family).model_dump_json())
    texts += [repr(read_tables(task.scenario)) for task in tune.tasks]
    return digest(" ".join(texts))


def result(tune: Any, kept: Path, *, simulate: bool) -> dict[str, Any] | None:
    """What a tune found, as its ``--json`` says; None if it is not known."""
    from twin.study.executors import executors  # noqa: PLC0415
    from twin.study.store import Store  # noqa: PLC0415
    from twin.tune.fragment import settings  # noqa: PLC0415
    from twin.tune.trials import Trials  # noqa: PLC0415
    from twin.tune.tune import tuned  # noqa: PLC0415
    from twin.writing import write_json  # noqa: PLC0415

    file = kept / f"{key(tune)}.json"
    if file.is_file():
        known: dict[str, Any] = json.loads(file.read_text())
        return known
    if not simulate:
        return None
    with executors(None) as (executor, count):
        trials = Trials(tune, Store(kept), executor=executor, processes=count)
        found = tuned(trials, sensitivity=False)
    about = found.as_dict() | {"settings": settings(trials, found.chosen.fields)}
    write_json(file, about)
    return about


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


def said(cost: float | None) -> str:
    """A cost of a table."""
    return "-" if cost is None else f"{cost:.3g}"


def page(plan: dict[str, Any], found: dict[str, dict[str, Any]], tune: Any) -> str:
    """The page as Markdown, of the laws that are tuned."""
    names = sorted(found, key=lambda name: order(found[name]))
    tasks = [task.name for task in tune.tasks]
    left = [law["name"] for law in plan["laws"] if law["name"] not in found]
    less = fewer(plan, found)
    lines = [
        "# Equal budgets: every law tuned alike",
        "",
        "Made by `uv run python docs/regenerate.py tuned`; what it runs is `docs/tuned.toml`.",
        "",
        f"Each law's own fields were searched by `ballplate tune` with {plan['candidates']} "
        f"candidates on {' then '.join(map(str, plan['rigs']))} rigs of the family "
        f"`{tune.family}` (draw {tune.draw}) on the exact equations, for the mean cost of the "
        f"worst {tune.tail:.0%} of the rigs; the best {tune.finalists} met the same rigs on the "
        "mechanism in MuJoCo. What is told here is the certificate: "
        f"{plan['certificate']} fresh rigs of draw {tune.certificate_draw} on the mechanism, "
        "before (gains of the thesis, or a law's defaults) and after. The observers keep their "
        "defaults. All tasks take 12 s, so that nothing is said of laws that learn for longer: "
        "lap learning has no part. So small a budget finds less than the one "
        "`ballplate tune` takes by itself.",
        "",
        "![Cost of every law on fresh rigs before and after](figures/tuned.svg)",
        "",
        "## Who wins",
        "",
        "Cost: mean over the tasks of RMS distance / scale, of the worst rigs; the scale is "
        + ", ".join(f"{1e3 * task.scale:g} mm ({task.name})" for task in tune.tasks)
        + f". Lost: rigs of {plan['certificate']} that did not finish every task, and the failure "
        "rate that this excludes with 95 % confidence. A law that loses a rig has no cost. Tasks: "
        "median and largest RMS distance of ball and reference in mm of the rigs that finished.",
        "",
        f"| law | lost | cost | {' | '.join(tasks)} | keeps its limits |",
        "|---|--:|--:" + "|--:" * len(tasks) + "|---|",
    ]
    for name in names:
        about = found[name]
        before, after = about["before"], about["after"]
        lost = (
            f"{before['failures']} → {after['failures']} "
            f"(below {100 * after['failure_rate_below']:.2g} %)"
        )
        cost = f"{said(before['cost'])} → {said(after['cost'])}"
        cells = " | ".join(cell(about, task) for task in tasks)
        kept = "yes" if about["kept"] else "no"
        lines.append(f"| {name} | {lost} | {cost} | {cells} | {kept} |")
    lines += [
        "",
        "Limits: disk margin of the nominal loop at least "
        f"{tune.limits.disk:g}, {1e3 * tune.limits.delay:g} ms more dead time borne, RMS effort of "
        f"any run at most {tune.limits.effort:g} rad/s^2.",
    ]
    lines += winners(found, tasks) + shares(found)
    if plan["why"]:
        lines += ["", "## Why", "", *(f"- {line}" for line in plan["why"])]
    lines += [
        "",
        "## What was found",
        "",
        "| law | fields |",
        "|---|---|",
    ]
    for name in names:
        fields = found[name]["chosen"]["fields"]
        texts = [f"`{key}={value:.4g}`" for key, value in fields.items()]
        lines.append(f"| {name} | {' '.join(texts)} |")
    if less:
        lines += ["", f"Fewer candidates had the margins to be run: {'; '.join(less)}."]
    if left:
        lines += ["", f"Not tuned for this page: {'; '.join(left)}."]
    lines.append("")
    return "\n".join(lines)


def best(found: dict[str, dict[str, Any]], side: str, task: str, number: str) -> str:
    """Who has the least of a task among the laws that lost no rig, and how much in mm."""
    known = [
        (about[side]["tasks"][task][number], name)
        for name, about in found.items()
        if not about[side]["failures"]
    ]
    return f"{min(known)[1]}: {1e3 * min(known)[0]:.2g}" if known else "none"


def winners(found: dict[str, dict[str, Any]], tasks: list[str]) -> list[str]:
    """Who wins where."""
    lines = [
        "",
        "## Where",
        "",
        "Least distance in mm among the laws that lost no rig: median of the fresh rigs, largest.",
        "",
        "| task | median before | median after | largest before | largest after |",
        "|---|---|---|---|---|",
    ]
    for task in tasks:
        cells = [
            best(found, side, task, number)
            for number in ("median", "largest")
            for side in ("before", "after")
        ]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    return lines


def shares(found: dict[str, dict[str, Any]]) -> list[str]:
    """What tuning does to a law, and what the observer does."""
    pairs = [
        (name.removesuffix(OWN), found[name], found[name.removesuffix(OWN) + KNOWN])
        for name in found
        if name.endswith(OWN) and name.removesuffix(OWN) + KNOWN in found
    ]
    if not pairs:
        return []
    lines = [
        "",
        "## Tuning, or knowing the friction?",
        "",
        "Cost on the fresh rigs (rigs lost) of the thesis's laws with and without either.",
        "",
        "| law | neither | tuned | behind the observer | both |",
        "|---|--:|--:|--:|--:|",
    ]
    for name, own, known in pairs:
        sides = (own["before"], own["after"], known["before"], known["after"])
        texts = [f"{said(side['cost'])} ({side['failures']})" for side in sides]
        lines.append(f"| {name} | {' | '.join(texts)} |")
    return lines


def drawing(found: dict[str, dict[str, Any]], path: Path) -> None:
    """The picture: the cost of every law before and after."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    names = sorted(found, key=lambda name: order(found[name]), reverse=True)
    costs = [[found[name][side]["cost"] for side in ("before", "after")] for name in names]
    known = [cost for pair in costs for cost in pair if cost is not None]
    beyond = 2 * max(known, default=1.0)
    figure = Figure(figsize=(9, 1.2 + 0.28 * len(names)), layout="constrained")
    axis = figure.subplots()
    rows = np.arange(len(names))
    for at, (label, face) in enumerate((("before", "none"), ("after", "tab:blue"))):
        x = np.array([beyond if pair[at] is None else pair[at] for pair in costs])
        lost = np.array([pair[at] is None for pair in costs])
        axis.scatter(
            x[~lost], rows[~lost], s=30, facecolors=face, edgecolors="tab:blue", label=label
        )
        size, word = (15, "a rig lost before") if at == 0 else (40, "a rig lost after")
        axis.scatter(x[lost], rows[lost], s=size, marker="x", c="tab:red", label=word)
    axis.set_yticks(rows, names)
    axis.set(xscale="log", xlabel="cost of the worst rigs, 1 = 1 % of the circle")
    axis.grid(color="0.9")
    figure.legend(loc="outside upper right", ncols=4, fontsize="small")
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


@click.command()
@click.option("--only", multiple=True, help="Tune this law alone; write no page.")
@click.option("--finished", is_flag=True, help="Simulate nothing: a page of the tuned laws.")
def main(only: tuple[str, ...], *, finished: bool) -> None:
    """Tune what is not tuned yet, then write the page."""
    plan = tomllib.loads((HERE / "tuned.toml").read_text(encoding="utf-8"))
    kept, found = HERE.parent / "runs" / "tuned", {}
    tunes = asked(plan)
    for name, tune in tunes.items():
        if only and name not in only:
            continue
        about = result(tune, kept, simulate=not finished)
        if about is not None:
            found[name] = about
            click.echo(f"{name}: lost and cost {order(about)}")
    if only:
        return
    if not found:
        raise click.ClickException("no law is tuned")
    drawing(found, HERE / "figures" / "tuned.svg")
    text = page(plan, found, next(iter(tunes.values())))
    (HERE / "tuned.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
