"""The files of a tune: page, numbers, and the tuned controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from twin.html import inline, render
from twin.page import digits
from twin.report.numbers import LABELS
from twin.run.assemble import build_law
from twin.tune.certificate import CONFIDENCE
from twin.tune.figures import before_and_after, trade_off
from twin.tune.fragment import options, settings, toml
from twin.tune.trials import Trials
from twin.tune.tune import TuneResult
from twin.writing import write_json, write_whole

FRAGMENT = "tuned.toml"


def sentences(found: TuneResult) -> list[str]:
    """What a tune says, in words."""
    tune, after, before = found.tune, found.after, found.before
    tried = len(found.candidates)
    ran = sum(bool(each.scores) for each in found.candidates)
    lines = [
        f"{tried} candidates, {ran} of them run on up to {tune.rigs[-1]} rigs of draw {tune.draw} "
        f"of the family {tune.family}; {tried - ran} had a nominal loop without the margins asked.",
        f"On {after['rigs']} fresh rigs of draw {tune.certificate_draw}: {failed(after)}; "
        f"before: {failed(before)}.",
    ]
    lines += [f"Lost, as in {reason}." for reason in after["reasons"][:1]]
    cost, was = after["cost"], before["cost"]
    if cost is not None:
        than = "a lost rig" if was is None else f"{was:.3g}"
        lines.append(
            f"Mean cost of the worst {tune.tail:.0%} of these rigs: {cost:.3g} after {than}."
        )
    if found.chosen is found.candidates[0]:
        lines.append("Nothing better than the beginning was found.")
    if not found.verdict.kept:
        broken = [name for name, value in found.verdict.constraints.items() if value > 0]
        lines.append(f"No candidate keeps every constraint; this one breaks: {', '.join(broken)}.")
    loop = found.chosen.loop
    if not loop.refused and loop.disk is None:
        lines.append(
            "The law has no linearisation, so that nothing is said of the margins of its loop."
        )
    elif not loop.refused and not loop.observed:
        lines.append(
            "The observer has no linearisation: margins are those of the law with the full state."
        )
    return lines


def failed(certificate: dict[str, Any]) -> str:
    """Failures and their bound in words."""
    bound = 100 * certificate["failure_rate_below"]
    return (
        f"{certificate['failures']} of {certificate['rigs']} lost, so with {CONFIDENCE:.0%} "
        f"confidence fewer than {bound:.2g} % of all such rigs are"
    )


def fields_table(found: TuneResult) -> list[tuple[str, ...]]:
    """Each field with its range, before and after."""
    rows = []
    for key, about in found.tune.fields.items():
        among = about.values or about.ends
        rows.append(
            (
                key + (" (factor)" if about.relative else ""),
                (", " if about.values else " to ").join(f"{value}" for value in among),
                *(f"{each.fields[key]}" for each in (found.candidates[0], found.chosen)),
                about.unit,
            )
        )
    return rows


def task_table(found: TuneResult) -> list[tuple[str, ...]]:
    """Each task's indicator before and after on fresh rigs."""
    rows = []
    for task in found.tune.tasks:
        for label, side in (("before", found.before), ("after", found.after)):
            name, unit = LABELS[task.indicator]
            own = side["tasks"][task.name]
            rows.append(
                (
                    task.name,
                    label,
                    f"{name} [{unit}]",
                    *(digits(own[key], unit) for key in ("median", "quantile_90", "largest")),
                    digits(task.scale, unit),
                    f"{own['finished']} of {side['rigs']}",
                    "-" if own["effort"] is None else f"{own['effort']:.2g}",
                )
            )
    return rows


def neighbours_table(found: TuneResult) -> list[tuple[str, ...]]:
    """The result with one field changed, each: what that does to its cost."""
    return [
        (
            each.key,
            each.value if isinstance(each.value, str) else f"{each.value:.4g}",
            "fails" if each.ratio is None else f"{each.ratio:.3g}",
            "yes" if each.kept else "no",
        )
        for each in found.neighbours
    ]


def margins_table(found: TuneResult) -> list[tuple[str, ...]]:
    """Margins and verdict before and after."""
    rows: list[tuple[str, ...]] = []
    for label, candidate in (("before", found.candidates[0]), ("after", found.chosen)):
        score = next(s for each, s in found.finalists if each is candidate)
        loop = candidate.loop
        rows.append(
            (
                label,
                "-" if loop.disk is None else f"{loop.disk:.3f}",
                "-" if loop.delay is None else f"{1000 * loop.delay:.0f} ms",
                "-" if score.cost is None else f"{score.cost:.3g}",
                "-" if score.effort is None else f"{score.effort:.2g}",
                f"{score.lost} of {score.rigs}",
                "yes" if score.kept else "no",
            )
        )
    return rows


def write(trials: Trials, found: TuneResult, folder: Path) -> None:
    """Write report.html, tune.json and tuned.toml.

    Raises:
        RecordError: If a file cannot be written.
    """
    tuned = settings(trials, found.chosen.fields)
    law = build_law(trials.scenario(found.chosen.fields, 0))
    said = [*sentences(found), *law.remarks]
    head = [
        found.tune.title,
        *said,
        f"ballplate run circle --set parameters={FRAGMENT}",
    ]
    drawn: dict[str, Any] = {
        "Before and after on the fresh rigs (dotted: cost 1)": before_and_after(found),
        "Error against effort": trade_off(found),
    }
    page = render(
        "tune/report.html.j2",
        title=found.tune.title,
        good=found.good,
        sentences=said,
        figures={heading: inline(figure) for heading, figure in drawn.items()},
        tasks=task_table(found),
        margins=margins_table(found),
        limits=found.tune.limits,
        fields=fields_table(found),
        neighbours=neighbours_table(found),
        reasons=found.after["reasons"],
        about=_about(found),
        command=f"ballplate run circle --set parameters={folder / FRAGMENT}",
        options=f"ballplate run circle {options(tuned)}",
    )
    write_whole(folder / FRAGMENT, lambda path: path.write_text(toml(tuned, head), "utf-8"))
    write_json(folder / "tune.json", found.as_dict() | {"settings": tuned})
    write_whole(folder / "report.html", lambda path: path.write_text(page, encoding="utf-8"))


def _about(found: TuneResult) -> str:
    tune = found.tune
    tasks = ", ".join(f"{task.name} ({task.scenario})" for task in tune.tasks)
    return (
        f"Tasks: {tasks}. A rig costs the mean over them of indicator / scale. All candidates met "
        f"the same rigs and noise: rungs of {', '.join(map(str, tune.rigs))} rigs, one in "
        f"{tune.eta} goes on. Searched with {', '.join(tune.search)}; the best {tune.finalists} "
        f"and the beginning compared, and the certificate given, with {', '.join(tune.verdict)}. "
        f"{found.runs} runs. Overrides of all runs: {', '.join(tune.set) or 'none'}."
    )
