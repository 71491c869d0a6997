"""Whether the fault matrix can fail: one line of defence taken away, and the rows that rely on it.

A row that stays good without what it relies on proves nothing. Every such row must turn bad.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np

from controllers.arrays import Array
from twin.devices.akd.exchange import CyclicExchange
from twin.emulator.drive import EmulatedDrive
from twin.hal.limits import Clamp
from twin.jobs import results
from twin.safety.case import FaultCase
from twin.safety.cases import AT_START, CASES
from twin.safety.reaction import Stopper
from twin.safety.row import FaultRow
from twin.safety.trial import Trial


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """One thing taken away.

    Attributes:
        name: What, in words.
        change: What is done to the program instead, in words.
        concerns: Which rows rely on it.
        apply: Takes it away while the context lasts.
        changed: The case that is carried out in place of a row's.
        key: What must be among the row's failures; empty for any.
    """

    name: str
    change: str
    concerns: Callable[[FaultCase], bool]
    apply: Callable[[], AbstractContextManager[Any]] = nullcontext
    changed: Callable[[FaultCase], FaultCase] = lambda case: case
    key: str = ""


@dataclass(frozen=True)
class MutationResult:
    """What came of a mutation.

    Attributes:
        name: What was taken away.
        change: What was done to the program instead.
        rows: Failures by name, of the rows that noticed it.
        unnoticed: Rows that rely on it and stayed good.
    """

    name: str
    change: str
    rows: dict[str, tuple[str, ...]]
    unnoticed: tuple[str, ...]

    @property
    def noticed(self) -> bool:
        """Whether every row that relies on what was taken away turned bad."""
        return bool(self.rows) and not self.unnoticed

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "name": self.name,
            "change": self.change,
            "noticed": self.noticed,
            "rows": self.rows,
            "unnoticed": self.unnoticed,
        }


def _relies(*stoppers: Stopper) -> Callable[[FaultCase], bool]:
    return lambda case: not set(stoppers).isdisjoint(case.stoppers)


def _no_quick_stop() -> AbstractContextManager[Any]:
    return patch.object(CyclicExchange, "quick_stop", lambda _: None)


def _close(exchange: CyclicExchange, _: Callable[[float], None]) -> None:
    exchange._transport.close()


def _no_stop() -> AbstractContextManager[Any]:
    with ExitStack() as stack:
        stack.enter_context(_no_quick_stop())
        stack.enter_context(patch.object(CyclicExchange, "shut_down", _close))
        return stack.pop_all()


def _no_watch() -> AbstractContextManager[Any]:
    with ExitStack() as stack:
        for module in ("bringup", "sdo_poll"):
            stack.enter_context(patch(f"twin.devices.akd.{module}.monitoring", lambda _: 0))
        return stack.pop_all()


def _no_levelling() -> AbstractContextManager[Any]:
    def stay(_: Clamp, angle: Array) -> Array:
        return np.zeros_like(angle)

    return patch.object(Clamp, "towards_level", stay)


def _no_sto() -> AbstractContextManager[Any]:
    return patch.object(EmulatedDrive, "open_sto", lambda _: None)


def _other_reason(case: FaultCase) -> FaultCase:
    """The case with what is done in the next row of those that must be refused."""
    at = AT_START.index(case)
    return replace(case, act=AT_START[(at + 1) % len(AT_START)].act)


MUTATIONS = (
    Mutation(
        name="levelling removed",
        change="where the plate is to be levelled, the rate is zero",
        concerns=_relies(Stopper.LEVELLING),
        apply=_no_levelling,
    ),
    Mutation(
        name="quick stop removed",
        change="the host never requests a quick stop",
        concerns=_relies(Stopper.QUICK_STOP),
        apply=_no_quick_stop,
    ),
    Mutation(
        name="host stop removed",
        change="the host writes nothing to stop the drives; it closes the bus",
        concerns=_relies(Stopper.QUICK_STOP),
        apply=_no_stop,
    ),
    Mutation(
        name="heartbeat watch never written",
        change="1016h of the drives stays 0, and the host takes 0 for right when it asks",
        concerns=_relies(Stopper.HEARTBEAT),
        apply=_no_watch,
    ),
    Mutation(
        name="STO not wired",
        change="opening the input does nothing",
        concerns=_relies(Stopper.STO),
        apply=_no_sto,
    ),
    Mutation(
        name="refused for another reason",
        change="another row's fault is made before switching on: refused, but not for what is said",
        concerns=lambda case: case.refused,
        changed=_other_reason,
        key="reason",
    ),
)
"""Every mutation, the lines of defence in their order."""

Job = tuple[int, int]
"""A mutation and a case, by their places in ``MUTATIONS`` and ``CASES``."""


def run_mutated(job: Job) -> FaultRow:
    """Carry a case out under a mutation; the recovery afterwards is not judged."""
    mutation, case = MUTATIONS[job[0]], CASES[job[1]]
    with mutation.apply():
        return Trial(mutation.changed(case)).row(recover=False)


def jobs(chosen: tuple[Mutation, ...] = MUTATIONS) -> list[Job]:
    """Every mutation with every row that relies on what it takes away."""
    return [
        (MUTATIONS.index(mutation), at)
        for mutation in chosen
        for at, case in enumerate(CASES)
        if mutation.concerns(case)
    ]


def run_mutations(processes: int, progress: Callable[[float], None]) -> list[MutationResult]:
    """Carry every mutation out.

    Args:
        processes: How many rows to run at the same time.
        progress: Called with the number of rows done.
    """
    rows: dict[Job, FaultRow] = {}
    for job, row in results(run_mutated, ((job, job) for job in jobs()), processes):
        rows[job] = row
        progress(len(rows))
    return [judged(mutation, [rows[job] for job in jobs((mutation,))]) for mutation in MUTATIONS]


def judged(mutation: Mutation, rows: list[FaultRow]) -> MutationResult:
    """Which of a mutation's rows noticed it."""
    noticed = {
        row.name: row.failures
        for row in rows
        if (mutation.key in row.failures if mutation.key else not row.good)
    }
    left = tuple(row.name for row in rows if row.name not in noticed)
    return MutationResult(mutation.name, mutation.change, noticed, left)
