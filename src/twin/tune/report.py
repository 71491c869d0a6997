"""The files of a tune: page, numbers, and keys that lie over any scenario."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from twin.base import page
from twin.base.errors import plural
from twin.base.page import Block, Code, Table, Text, Verdict, digits, percent
from twin.base.writing import write_json, write_whole
from twin.run.controller_building import build_law
from twin.run.tables import INDICATOR_LABELS, flat
from twin.scenario.merging import setting
from twin.scenario.schema import CONTROL_TABLES
from twin.study.schema import Point, place_of
from twin.tune.search import BOUND_CONFIDENCE, TuneResult
from twin.tune.trials import Trials


def settings(trials: Trials, fields: Point) -> dict[str, Any]:
    """The tuned controller as dotted scenario keys: its rig, all of it, and every other field.

    Args:
        trials: With the tune.
        fields: Values of its fields.
    """
    scenario = json.loads(trials.scenario(fields, 0).model_dump_json())
    found = flat({table: scenario[table] or {} for table in CONTROL_TABLES})
    for field in fields:
        key, _ = place_of(field)
        if key.partition(".")[0] not in CONTROL_TABLES:
            found[key] = flat(scenario)[key]
    found["parameters"] = dict(map(setting, trials.tune.set)).get("parameters")
    return {key: value for key, value in found.items() if value is not None}


def toml(settings: dict[str, Any], comment: list[str]) -> str:
    """Keys as a TOML file that ``--set parameters=FILE`` lays over a scenario.

    Args:
        settings: Values by dotted key: texts, numbers, truth values and lists of them.
        comment: Lines at its head.
    """
    lines = [f"# {line}".rstrip() for line in comment]
    # JSON of texts, numbers, truth values and lists of them is TOML, too
    lines += [f"{key} = {json.dumps(value)}" for key, value in settings.items()]
    return "\n".join(lines) + "\n"


FRAGMENT_FILE = "tuned.toml"
FIELD_HEADINGS = ("field", "searched", "before", "after", "unit")
TASK_HEADINGS = (
    *("task", "", "indicator", "median", "90 %", "largest", "cost 1 at", "finished"),
    "median RMS effort [rad/s²]",
)


def sentences(found: TuneResult) -> list[str]:
    """The result of a tune, in sentences."""
    tune, after, before = found.tune, found.after, found.before
    tried = len(found.candidates)
    ran = sum(bool(each.scores) for each in found.candidates)
    lines = [
        f"{plural(tried, 'candidate')}, {ran} of them run on up to {plural(tune.rigs[-1], 'rig')} "
        f"of draw {tune.draw} "
        f"of the family {tune.family}; {tried - ran} had a nominal loop without the margins asked.",
        f"On {after['rigs']} fresh rigs of draw {tune.certificate_draw}: "
        f"{describe_failures(after)}; before: {describe_failures(before)}.",
    ]
    lines += [f"Lost, as in {reason}." for reason in after["reasons"][:1]]
    cost, was = after["cost"], before["cost"]
    if cost is not None:
        than = "a lost rig" if was is None else f"{was:.3g}"
        lines.append(
            f"Mean cost of the worst {percent(tune.tail, 0)} of these rigs: {cost:.3g} "
            f"after {than}."
        )
    if found.chosen is found.candidates[0]:
        lines.append("Nothing better than the beginning was found.")
    if not found.verdict.kept:
        broken = [name for name, value in found.verdict.constraints.items() if value > 0]
        lines.append(f"No candidate keeps every constraint; this one breaks: {', '.join(broken)}.")
    loop = found.chosen.loop
    if loop.disk is not None and loop.delay is not None:
        lines.append(
            f"Its nominal loop has a disk margin of {loop.disk:.3f} and bears "
            f"{1000 * loop.delay:.0f} ms of further dead time."
        )
    if not loop.refused and loop.disk is None:
        lines.append("The law has no linearisation, so the margins of its loop are unknown.")
    elif not loop.refused and not loop.observed:
        lines.append(
            "The observer has no linearisation: margins are those of the law with the full state."
        )
    return lines


def describe_failures(certificate: dict[str, Any]) -> str:
    """Failures and their bound in words."""
    failures, rigs = certificate["failures"], certificate["rigs"]
    bound = 100 * certificate["failure_rate_below"]
    if failures == rigs:
        return f"{failures} of {rigs} lost, which excludes no share of all such rigs"
    return (
        f"{failures} of {rigs} lost, so with {100 * BOUND_CONFIDENCE:g} % confidence fewer than "
        f"{bound:.{2 if bound < 99 else 3}g} % of all such rigs are"
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
            name, unit = INDICATOR_LABELS[task.indicator]
            own = side["tasks"][task.name]
            rows.append(
                (
                    task.name,
                    label,
                    f"{name} [{unit}]",
                    *(digits(own[key], unit) for key in ("median", "quantile_90", "largest")),
                    digits(task.scale, unit),
                    f"{own['finished']} of {side['rigs']}",
                    digits(own["effort"], places=2),
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
    verdict = [*sentences(found), *law.remarks]
    head = [found.tune.title, *verdict, f"ballplate run circle --set parameters={FRAGMENT_FILE}"]
    tasks = Table("Every task on the fresh rigs", TASK_HEADINGS, task_table(found), words=(0, 1, 2))
    blocks: list[Block] = [Verdict(verdict, found.good), tasks]
    if found.after["reasons"]:
        blocks.append(Text(found.after["reasons"]))
    blocks += [
        Table("Fields", FIELD_HEADINGS, fields_table(found), words=(0, -1)),
        Code("Run it", f"ballplate run circle --set parameters={folder / FRAGMENT_FILE}"),
        Text(["As data: tune.json in the folder of this page; the tuned controller: tuned.toml."]),
    ]
    write_whole(folder / FRAGMENT_FILE, toml(tuned, head))
    write_json(folder / "tune.json", found.as_dict() | {"settings": tuned})
    page.write(folder / "report.html", found.tune.title, blocks)
