"""The safety case as a document: states, conditions, and the measured fault matrix."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from twin.devices.akd.conditions import CONDITIONS as DRIVE_CONDITIONS
from twin.devices.lumio.conditions import CONDITIONS as SCREEN_CONDITIONS
from twin.devices.realtime import TIMING_CONDITIONS
from twin.hal.faults import Condition
from twin.hal.interface import SCREEN
from twin.hal.states import TRANSITIONS
from twin.hal.supervisor import RIG_CONDITIONS
from twin.safety.proof import DEFENCES, NOT_PROVEN, PROVEN
from twin.safety.row import FaultRow
from twin.safety.trial import AFTER, LEFT
from twin.safety.words import HEADING, both, cells
from twin.writing import write_whole

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

Afterwards nothing resumes, and nothing in the program leads back to *running*: a person runs
`ballplate run` again, with `--reset` if the drives hold faults.
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
    parts += [DEFENCES, PROVEN, NOT_PROVEN]
    parts += ["## Keys of a row with `--json`\n", inspect.cleandoc(KEYS), "", *_keys()]
    parts += ["## Fault matrix\n", _sentence(rows), *_matrix(rows)]
    parts += ["## What the rows are judged by\n", LIMITS, *_reasons(rows)]
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


KEYS = """
    Times are in s, angles in rad, ways in m. A pair is that of phi and theta, or of x and y. What
    ends in `_limit` or `_expected` is what the key before it is judged by.
"""


def _keys() -> list[str]:
    """Key and meaning, from where they are written: the attributes of a row."""
    attributes = inspect.cleandoc(FaultRow.__doc__ or "").partition("Attributes:\n")[2]
    entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", attributes, flags=re.MULTILINE)
    return _table(
        ("key", "meaning"), [(f"`{key}`", " ".join(text.split())) for key, text in entries]
    )


def _sentence(rows: Sequence[FaultRow]) -> str:
    good = sum(row.good for row in rows)
    return (
        f"Each fault was injected at the bus or byte level while the circle was tracked, or before "
        f"the rig was switched on. The run was then watched for {AFTER:g} s or to its end, and a "
        f"rig whose run had ended for {LEFT:g} s more. A value is followed by its limit: *4 of "
        f"22*. Times count from the injection, or from switching on. *Detected* is when the host "
        f"notes it, up to one period after it has acted; for the touch screen the dead time of "
        f"42 ms and one frame are allowed in addition to the condition's time. *Standstill* (and "
        f"level, where the plate is levelled), *tilt* (the largest from the fault on) and *ball* "
        f"(its largest distances from the centre until the plate has to stand) are those of the "
        f"plant, not those measured by the host; *then* is how far the ball rolled later on a "
        f"plate left tilted: that is not judged. *Reached* is the drives' state: with torque where "
        f"the plate is levelled or the run goes on, else the first without. At the end no drive "
        f"has torque. *Whole*: every period is in the record. *Again*: the rig runs once the cause "
        f"is removed and a person has asked for it. {good} of {len(rows)} rows pass.\n"
    )


def _matrix(rows: Sequence[FaultRow]) -> list[str]:
    heading = (*HEADING, "then [mm]", "whole", "again", "verdict")
    return _table(heading, [_cells(row) for row in rows])


def _cells(row: FaultRow) -> tuple[str, ...]:
    left = any(way > whole / 2 for way, whole in zip(row.ball_later, SCREEN, strict=True))
    then = "off the plate" if left else ", ".join(f"{1e3 * way:.0f}" for way in row.ball_later)
    facts = ("yes" if fact else "**NO**" for fact in (row.whole, row.recovered))
    verdict = "good" if row.good else f"**BAD**: {', '.join(row.failures)}"
    return (*cells(row), then, *facts, verdict)


LIMITS = """\
Limits follow from what drives and host are set to and from how plate and ball moved when the fault
began; none is fitted to what came out.
"""
LIMITED = {
    "standstill_limit": "standstill",
    "torque_off_limit": "no torque",
    "tilt_limit": "tilt",
    "ball_limit": "ball",
}


def _reasons(rows: Sequence[FaultRow]) -> list[str]:
    """Every way in which a limit came about, with the number of rows and the first who had to."""
    counts: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        for key, why in row.why.items():
            counts.setdefault((LIMITED[key], why), []).append(both(row.stopped_by_expected))
    return _table(
        ("limit of", "what it is made of", "to be stopped by", "rows"),
        [
            (what, why, "; ".join(dict.fromkeys(stoppers)), str(len(stoppers)))
            for (what, why), stoppers in sorted(counts.items())
        ],
    )


def _table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [heading, ["---"] * len(heading), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines] + [""]
