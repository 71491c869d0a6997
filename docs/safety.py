"""Makes safety.md, states and conditions, and fault-matrix.md, as measured.

uv run python docs/safety.py
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence

from docs import own_faults
from docs.pages import HERE, filled, write
from twin.base.jobs import cores
from twin.cli.output import progress
from twin.devices.akd.conditions import DRIVE_CONDITIONS
from twin.devices.common import RELAXED
from twin.devices.lumio.conditions import SCREEN_CONDITIONS
from twin.devices.own import OWN_CONDITIONS
from twin.devices.realtime import LOOP_OVERRUN
from twin.devices.rig import UNCHECKED
from twin.hal.agreement import AGREEMENT_CONDITIONS
from twin.hal.interface import SCREEN_SIZE_M, Condition
from twin.hal.supervisor import RIG_CONDITIONS, TRANSITIONS
from twin.safety.fault_row import FAULT_HEADINGS, FaultRow, cells
from twin.safety.faults import CASES
from twin.safety.trial import RUN_AFTER_S, WATCH_AFTER_S, run_all

GROUPS: dict[str, Iterable[Condition]] = {
    "The supervisor, from measurements alone": RIG_CONDITIONS,
    "Motors against plate; the rig file": (*AGREEMENT_CONDITIONS, UNCHECKED, RELAXED),
    "The control loop": (LOOP_OVERRUN,),
    "The touch screen": SCREEN_CONDITIONS,
    "Drives and bus": DRIVE_CONDITIONS,
    "Hardware of one's own": OWN_CONDITIONS,
}


def document(rows: Sequence[FaultRow], own: Sequence[FaultRow] = ()) -> str:
    """Both pages, as Markdown: ``safety.template.md`` with what the code says.

    Args:
        rows: The fault matrix.
        own: Its rows of hardware of one's own.
    """
    return filled(
        "safety",
        transitions=TRANSITIONS,
        conditions=GROUPS,
        counted=[(each.name, each.periods) for each in every() if each.periods not in {1, 4}],
        keys=_keys(),
        after=f"{RUN_AFTER_S:g}",
        left=f"{WATCH_AFTER_S:g}",
        good=sum(row.good for row in rows),
        number=len(rows),
        heading=FAULT_HEADINGS,
        matrix=map(row_cells, rows),
        own=map(row_cells, own),
        own_good=sum(row.good for row in own),
        own_number=len(own),
    )


def every() -> list[Condition]:
    """Every condition."""
    return [each for group in GROUPS.values() for each in group]


def _keys() -> dict[str, str]:
    """Key and meaning, from where they are written: the attributes of a row."""
    attributes = inspect.cleandoc(FaultRow.__doc__ or "").partition("Attributes:\n")[2]
    entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", attributes, flags=re.MULTILINE)
    return {key: " ".join(text.split()) for key, text in entries}


def row_cells(row: FaultRow) -> tuple[str, ...]:
    """The cells of a row in a page."""
    left = any(way > whole / 2 for way, whole in zip(row.ball_later, SCREEN_SIZE_M, strict=True))
    then = "off the plate" if left else ", ".join(f"{1e3 * way:.0f}" for way in row.ball_later)
    facts = ("yes" if fact else "**NO**" for fact in (row.whole, row.recovered))
    verdict = "good" if row.good else f"**BAD**: {', '.join(row.failures)}"
    return (*cells(row), then, *facts, verdict)


def main() -> None:
    """Inject every fault, and write the page."""
    with progress("fault matrix", len(CASES)) as advance:
        rows = run_all(cores(), advance)
    own = [own_faults.carried_out(row) for row in own_faults.ROWS]
    write(HERE / "safety.md", document(rows, own))


if __name__ == "__main__":
    main()
