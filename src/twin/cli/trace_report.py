"""Output of the command trace: the verdict with its findings, and tables of the frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rich.text import Text

from twin.base.errors import list_first, plural, printable
from twin.base.page import Table, digits

if TYPE_CHECKING:
    from twin.devices.akd.findings import Verdict

SEVERITY_COLOURS = {"unresolved": "bold red", "recovered": "bold yellow", "warning": "yellow"}
"""Colours of severities; a trace without findings is green, without any node yellow."""


def verdict_lines(verdict: Verdict, heading: str, *, timed: bool) -> Iterator[Text | str]:
    """Summary in one line, then each problem.

    Args:
        verdict: The verdict.
        heading: What was read, in words.
        timed: Whether the trace has times; else frames stand in their place.
    """
    worst = verdict.worst
    otherwise = "bold green" if verdict.heard else "bold yellow"
    style = SEVERITY_COLOURS[worst] if worst else otherwise
    yield Text(printable(verdict.headline), style=style)
    yield f"{heading}; {verdict.count}" if verdict.count else heading
    located = zip(verdict.findings, verdict.places, strict=True)
    for number, (finding, place) in enumerate(located, 1):
        when = _time_words(finding.time, timed=timed)
        line = f"  {finding.code}  {when}  {place}: {finding.text}"
        yield ""
        yield Text.assemble(
            f"{number:2}. ",
            (str(finding.severity), SEVERITY_COLOURS[finding.severity]),
            printable(line),
        )
        rows = {
            "motion": finding.motion,
            "cause": "; ".join(finding.causes),
            "check": "; ".join(finding.check),
            "frames": list_first([str(each) for each in finding.frames], MAX_FRAMES_SHOWN),
        }
        for head, words in rows.items():
            if words:
                yield f"      {head:<8}{words}"


def _time_words(time: float, *, timed: bool) -> str:
    """A time of a trace in s, or the number of a frame where there are no times."""
    return f"{time:.3f} s" if timed else f"frame {time:.0f}"


MAX_FRAMES_SHOWN = 8
"""Numbers of frames that are printed with a finding; ``--json`` has all."""


def node_tables(found: dict[str, Any]) -> list[Table]:
    """The actions and the traffic of each node, as tables."""
    nodes = found["nodes"].values()
    heads = ("", "sent", "network", "drive", "SDO", "faults")
    did = [
        (
            node["name"],
            format_counts(node["frames"]) or "nothing",
            " -> ".join(node["states"]),
            "; ".join(
                f"axis {axis}: {' -> '.join(states)}" if axis > 1 else " -> ".join(states)
                for axis, states in ({1: node["drive"]} | node["axes"]).items()
                if states
            ),
            format_counts(node["transfers"]),
            "; ".join(
                f"{_time_words(each['time'], timed=found['timed'])} {each['text']}"
                for each in node["faults"]
            ),
        )
        for node in nodes
    ]
    if errors := found["errors"]:
        text = "; ".join(f"{count} {what}" for what, count in errors.items())
        did.append(("adapter", plural(sum(errors.values()), "error frame"), "", "", "", text))
    signals = [
        (node["name"], name, digits(its["from"]), digits(its["to"]), _unit(its))
        for node in nodes
        for name, its in node["signals"].items()
    ]
    tables = (
        Table("", heads, did, words=range(len(heads))),
        Table("", ("", "in PDOs", "from", "to", "unit"), signals, words=(0, 1, 4)),
    )
    return [each for each in tables if each.rows]


def _unit(signal: dict[str, Any]) -> str:
    """Unit of a signal; of one without any counts, but for numbers of IEEE 754, which are none."""
    whole = isinstance(signal["from"], int) and isinstance(signal["to"], int)
    return str(signal["unit"]) or ("counts" if whole else "")


def format_counts(numbers: dict[str, int]) -> str:
    """Numbers by what was counted, in words."""
    return ", ".join(f"{count} {name}" for name, count in numbers.items())
