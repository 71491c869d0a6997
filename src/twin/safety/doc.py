"""The safety case as a document: states, conditions, and the measured fault matrix."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from twin.devices.akd.conditions import CONDITIONS as DRIVE_CONDITIONS
from twin.devices.lumio.conditions import CONDITIONS as SCREEN_CONDITIONS
from twin.devices.realtime import TIMING_CONDITIONS
from twin.hal.faults import Condition
from twin.hal.states import TRANSITIONS
from twin.hal.supervisor import RIG_CONDITIONS
from twin.run.record import write_whole
from twin.safety.matrix import AFTER, FaultRow

GROUPS: dict[str, Iterable[Condition]] = {
    "The supervisor, from measurements alone": RIG_CONDITIONS,
    "The control loop": TIMING_CONDITIONS,
    "The touch screen": SCREEN_CONDITIONS,
    "Drives and bus": DRIVE_CONDITIONS,
}
INTRODUCTION = """\
# The safety case

Written by `ballplate safety --doc docs/safety.md`; the tables are those of the code.

A rig moves only in the state *running*, which takes an explicit start. What is sent never exceeds
the limits of angle, rate and acceleration. Every condition that a device or the supervisor detects
has one of three severities:

- **warning**: noted in the record; the datum concerned is not used and its age grows.
- **level**: the drives level the plate, then hold it, whatever the controller says.
- **stop**: nothing can be trusted to move. Zero rate is commanded in the same period, both drives
  make a quick stop and then switch their torque off. Where nothing can be sent any more, the
  drives stop by themselves: they watch the host's heartbeat (60 ms of silence), which with their
  factory settings they would not do.

Afterwards nothing resumes by itself: a person must request *recover* or *reset*, and then start.
On the command line both are a new `ballplate run`, with `--reset` if the drives hold faults.
"""


def write_doc(path: Path, rows: Sequence[FaultRow]) -> None:
    """Write the document.

    Raises:
        RecordError: If it cannot be written.
    """
    text = document(rows)
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


def document(rows: Sequence[FaultRow]) -> str:
    """The document, as Markdown."""
    parts = [INTRODUCTION, "## States\n", *_table(("state", "event", "next state"), _transitions())]
    parts.append("An event that is not listed for a state changes nothing.\n")
    parts.append("## Conditions\n")
    for title, conditions in GROUPS.items():
        parts += [f"### {title}\n", *_conditions(conditions)]
    parts += ["## Fault matrix\n", _sentence(rows), *_matrix(rows)]
    return "\n".join(parts).rstrip() + "\n"


def _transitions() -> list[tuple[str, ...]]:
    return [
        (before.name.lower(), str(event), after.name.lower())
        for (before, event), after in TRANSITIONS.items()
    ]


def _conditions(conditions: Iterable[Condition]) -> list[str]:
    heading = ("condition", "severity", "detected within [ms]", "reaction", "recovery")
    return _table(
        heading,
        [
            (c.name, str(c.severity), f"{1e3 * c.within:g}", c.reaction, c.recovery)
            for c in conditions
        ],
    )


def _sentence(rows: Sequence[FaultRow]) -> str:
    good = sum(row.good for row in rows)
    return (
        f"Each fault was injected at the bus or byte level while the circle was tracked, or before "
        f"the rig was switched on; the rig was then observed for {AFTER:g} s. Times count from the "
        f"injection; for the touch screen the dead time of 42 ms and one frame are allowed in "
        f"addition to the condition's time. *Safe*: motors at rest after a stop, plate level after "
        f"a level, the run not affected by a warning. *Whole*: every period is in the record. "
        f"*Again*: the rig runs once the cause is removed and a person has asked for it. "
        f"{good} of {len(rows)} rows pass.\n"
    )


def _matrix(rows: Sequence[FaultRow]) -> list[str]:
    heading = ("fault", "condition", "severity", "allowed [ms]", "detected [ms]", "run", "safe")
    return _table(
        (*heading, "whole", "again"),
        [
            (
                row.name,
                row.condition or "none",
                row.severity or "-",
                f"{1e3 * row.allowed:.0f}" if row.condition else "-",
                "-" if not row.condition else _ms(row.detected),
                row.ending,
                *(("yes" if fact else "**NO**") for fact in (row.safe, row.whole, row.recovered)),
            )
            for row in rows
        ],
    )


def _ms(seconds: float | None) -> str:
    if seconds is None:
        return "**not**"
    return "at once" if seconds == 0 else f"{1e3 * seconds:.0f}"


def _table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [heading, ["---"] * len(heading), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines] + [""]
