"""The fault matrix: every case done to an emulated rig that tracks a circle, and judged.

It runs in virtual time: the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable

from twin.jobs import results
from twin.safety.cases import CASES
from twin.safety.row import FaultRow
from twin.safety.trial import Trial


def run_case(index: int) -> FaultRow:
    """Carry out one case; index: in ``CASES``."""
    return Trial(CASES[index]).row()


def run_all(processes: int, progress: Callable[[float], None]) -> list[FaultRow]:
    """Carry out every case.

    Args:
        processes: How many to run at the same time.
        progress: Called with the number of cases done.
    """
    rows: dict[int, FaultRow] = {}
    for index, row in results(run_case, enumerate(range(len(CASES))), processes):
        rows[index] = row
        progress(len(rows))
    return [rows[index] for index in range(len(CASES))]
