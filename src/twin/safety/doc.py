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
from twin.safety.matrix import AFTER, Row

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

- **warning**: noted in the record; the datum concerned is not used, its age grows.
- **level**: the plate is levelled by the drives, then held, whatever the controller says.
- **stop**: nothing can be trusted to move. Zero rate is commanded in the same period, both drives
  make a quick stop, and have no torque then. Where nothing can be sent any more, the drives stop
  by themselves: they watch the host's heartbeat (silence of 60 ms), which their factory setting
  does not.

Nothing goes on by itself afterwards: *recover* and *reset* are requests of a person, and so is the
start after them. On the command line both are a new `ballplate run`, with `--reset` where faults
stand in the drives.
"""


def write_doc(path: Path, rows: Sequence[Row]) -> None:
    """Write the document.

    Raises:
        RecordError: If it cannot be written.
    """
    parts = [INTRODUCTION, "## States\n", *_table(("state", "event", "next state"), _transitions())]
    parts.append("An event that is not listed for a state changes nothing.\n")
    parts.append("## Conditions\n")
    for title, conditions in GROUPS.items():
        parts += [f"### {title}\n", *_conditions(conditions)]
    parts += ["## Fault matrix\n", _sentence(rows), *_matrix(rows)]
    text = "\n".join(parts).rstrip() + "\n"
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))


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


def _sentence(rows: Sequence[Row]) -> str:
    good = sum(row.good for row in rows)
    return (
        f"Each fault was injected at the bus or byte level while the circle was tracked, or before "
        f"the rig was switched on; the rig was watched for {AFTER:g} s. Times count from the "
        f"injection; for the touch screen the dead time of 42 ms and a frame are allowed on top of "
        f"the condition's time. *Safe*: motors at rest after a stop, plate level after a level, "
        f"the run unharmed by a warning. *Whole*: every period is in the record. *Again*: the rig "
        f"runs after the cause was removed and a person asked for it. "
        f"{good} of {len(rows)} rows are as they must be.\n"
    )


def _matrix(rows: Sequence[Row]) -> list[str]:
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
