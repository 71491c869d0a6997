"""The report as one HTML file that needs nothing else, and its pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from twin.base.data_file import read_packaged
from twin.base.page import Block, Code, Picture, Table, Text, Verdict
from twin.base.page import html as html_of
from twin.run.finished import Run, columns
from twin.run.picture import literal, picture, style, styled_figure
from twin.run.tables import differing, in_json, indicators
from twin.view.summary import Diagnosis, spectrum, summary, verdict

PANEL_DETAILS = read_packaged("twin.view", "details.toml")
"""Of each panel title, labels, and where its axis begins and ends if that is known."""
MAX_LEGEND_RUNS = 12
"""Runs that a legend within a panel has room for."""


def overview(runs: Sequence[Run]) -> Figure:
    """Path on the plate, positions, error, angles and effort."""
    return picture({run.name: run.motion for run in runs}, "", runs[0].scenario.dimensions)


def details(runs: Sequence[Run]) -> Figure:
    """Error spectrum, distribution of the error and, where the truth is known, estimation error."""
    known = any("true_x" in run.rows for run in runs)
    names = ["spectrum", "share", *(["estimate"] if known else [])]
    with styled_figure(12, 3.4) as figure:
        panels = dict(zip(names, figure.subplots(1, len(names)), strict=True))
        for index, run in enumerate(runs):
            frequency, amplitude = spectrum(run)
            amplitude = amplitude[:, : run.scenario.plant.axes]
            level = np.maximum(1000 * np.sqrt((amplitude**2).mean(axis=1)), 1e-6)
            look = {**style(index), "lw": 1}
            panels["spectrum"].loglog(frequency[1:], level[1:], label=literal(run.name), **look)
            until = run.motion.until(run.judged_until)
            distance = np.sort(1000 * np.hypot(*until.error.T))
            share = 100 * np.arange(1, len(distance) + 1) / len(distance)
            panels["share"].plot(distance, share, **look)
            if "true_x" in run.rows:
                wrong = 1000 * (columns(run.rows, "estimated")[:, 0::4] - run.motion.ball)
                panels["estimate"].plot(run.motion.time, np.hypot(*wrong.T), **look)
        for name, panel in panels.items():
            panel.set(**PANEL_DETAILS[name]["words"])
            panel.set_ylim(**PANEL_DETAILS[name]["limits"])
        if 1 < len(runs) <= MAX_LEGEND_RUNS:
            entries = panels["spectrum"].get_legend_handles_labels()
            figure.legend(*entries, loc="outside lower center", ncols=4, fontsize=9)
    return figure


MAX_LISTED_EVENTS = 40
"""Events that are shown without being asked for."""
MOST_TOLD = 3
"""Runs of which each has a sentence a fact; of more, one in all."""
INDICATOR_NOTE = (
    "Indicators of the thesis's Appendix C; on single axes they judge x. Steady ones count from "
    "metrics.start on."
)


def html(runs: Sequence[Run]) -> str:
    """The report on one run, or on several side by side."""
    several = len(runs) > 1
    names = [run.name for run in runs]
    blocks: list[Block] = []
    good = [run.metrics.get("outcome") == "finished" for run in runs]
    found = [Diagnosis.of(run) for run in runs]
    if len(runs) > MOST_TOLD:
        lines = [f"{run.name}: {verdict(run, its)}" for run, its in zip(runs, found, strict=True)]
        blocks.append(Verdict(lines, all(good)))
    else:
        summaries = map(summary, runs, found)
        titles = names if several else [""]
        blocks += map(Verdict, summaries, good, titles)
    blocks += [
        indicators("Numbers", {run.name: run.metrics for run in runs}, note=INDICATOR_NOTE),
        Picture("Motion", overview(runs)),
        Picture("Error and estimation", details(runs)),
    ]
    timing = [(run.name, *line) for run in runs for line in _timing(run.ledger)]
    if timing:
        stages = ("run", "stage", "p50 [us]", "p99 [us]", "longest [us]")
        blocks.append(Table("Real time", stages, timing, words=(0, 1)))
    events = [
        (run.name, f"{each['time']:.3f}", str(each["severity"]), str(each["text"]))
        for run in runs
        for each in run.events
    ]
    if events:
        heads = ("run", "time [s]", "severity", "what was detected")
        folded = f"all {len(events)}" if len(events) > MAX_LISTED_EVENTS else ""
        blocks.append(Table("Events", heads, events, words=(0, -1), folded=folded))
    if several:
        differ = [(key, *values) for key, values in differing(runs)]
        what = "Settings that differ; the others are those of the first run, below"
        blocks.append(Table(what, ("key", *names), differ, words=range(1 + len(runs))))
    blocks += [
        Code(file or "Typed at a prompt", text, f"Of {owner}." if several else "")
        for owner, file, text in _sources(runs)
    ]
    settings = [*in_json(runs[0].settings).items()]
    folded = f"all {len(settings)}"
    blocks.append(Table("Settings", ("key", "value"), settings, words=(0, 1), folded=folded))
    versions = [f"{run.name}: {', '.join(map(' '.join, run.versions.items()))}" for run in runs]
    same = len({run.scenario.title for run in runs}) == 1
    title = runs[0].scenario.title if same else f"Comparison of {len(runs)} runs"
    return html_of(title, [*blocks, Text(versions, "Versions")])


def _sources(runs: Sequence[Run]) -> list[tuple[str, str, str]]:
    """Names of the runs, file and text of every class of theirs that is not this program's."""
    found: dict[tuple[str, str], list[str]] = {}
    for run in runs:
        for its in run.classes.values():
            if its.get("source"):
                found.setdefault((its["file"], its["source"]), []).append(run.name)
    return [(", ".join(dict.fromkeys(names)), *each) for each, names in found.items()]


def _timing(ledger: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The ledger of a run in real time, one line per stage: p50, p99 and longest in us."""
    if not ledger:
        return []
    stages = {
        "lateness": ledger["lateness"],
        **ledger["stages"],
        "round trip": ledger["round_trip"],
    }
    return [
        (name, *(f"{each[key]}" for key in ("p50_us", "p99_us", "max_us")))
        for name, each in stages.items()
        if each["number"]
    ]
