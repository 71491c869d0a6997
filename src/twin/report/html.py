"""The report as one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twin.html import inline, render
from twin.report.diagnosis import Diagnosis
from twin.report.figures import details, overview
from twin.report.numbers import differing, flat, rows
from twin.report.summary import summary
from twin.run.finished import Run

MOST = 40
"""Events that are listed."""


def html(runs: Sequence[Run]) -> str:
    """The report on one run, or on several side by side."""
    return render(
        "report/report.html.j2",
        title=_title(runs),
        runs=[
            {
                "name": run.name,
                "summary": summary(run, Diagnosis.of(run)),
                "good": run.metrics.get("outcome") == "finished",
                "versions": run.versions,
            }
            for run in runs
        ],
        rows=rows(runs),
        timing=[(run.name, *line) for run in runs for line in _timing(run.ledger)],
        events=[(run.name, *line) for run in runs for line in _events(run.events)],
        overview=inline(overview(runs)),
        details=inline(details(runs)),
        differing=differing(runs),
        settings=flat(runs[0].settings),
        sources=_sources(runs),
    )


def _sources(runs: Sequence[Run]) -> list[tuple[str, str, str]]:
    """Names of the runs, file and text of every class of theirs that is not this program's."""
    found: dict[tuple[str, str], list[str]] = {}
    for run in runs:
        for its in run.classes.values():
            if its.get("source"):
                found.setdefault((its["file"], its["source"]), []).append(run.name)
    return [(", ".join(dict.fromkeys(names)), *each) for each, names in found.items()]


def _title(runs: Sequence[Run]) -> str:
    """One run's own, that of a what-if, or how many are compared."""
    if len(runs) == 1:
        return runs[0].scenario.title
    moments = {(run.branch.get("of"), run.branch.get("at")) for run in runs}
    if len(moments) == 1 and all(run.branch for run in runs):
        return f"What if: {runs[0].branch['of']} from {runs[0].branch['at']:g} s on"
    return f"Comparison of {len(runs)} runs"


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


def _events(events: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """What was detected, the first ones."""
    lines: list[tuple[str, ...]] = [
        (f"{e['time']:.3f}", str(e["severity"]), str(e["text"])) for e in events[:MOST]
    ]
    if len(events) > MOST:
        lines.append(("", "", f"and {len(events) - MOST} more, in run.parquet"))
    return lines
