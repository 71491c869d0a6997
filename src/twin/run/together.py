"""Runs side by side in one batch, each with the bits that it has alone; a batch of one is a run."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar, cast

from controllers.per_rig import PerRigReference
from twin.base.errors import LawError, TwinError
from twin.base.jobs import results
from twin.run import assemble, controller_building, plants
from twin.run.finished import Run, run
from twin.run.loop import alike, drive, is_foreign, refuse_faults
from twin.run.metrics import Ending
from twin.run.record import Recorder
from twin.scenario.schema import Scenario, choices

if TYPE_CHECKING:
    from controllers.interfaces import Law

Label = TypeVar("Label", bound=Hashable)
Found = TypeVar("Found")

MAX_BATCH_RIGS = 64
"""Most rigs of a batch: more are hardly faster, and 8 s of 64 rigs take 0.1 GB."""
ALONE_KINDS = {"fmu", "iterative_learning"}
"""Laws with something of their own outside this process, or that learn from run to run."""


def group(scenarios: Mapping[Label, Scenario], parts: int = 1) -> list[list[Label]]:
    """Labels of the runs that go through one batch each, the largest batch first.

    Args:
        scenarios: What to run, by label.
        parts: Number of processes to share the runs among.
    """
    most = min(MAX_BATCH_RIGS, math.ceil(len(scenarios) / parts))
    groups: dict[str, list[Label]] = {}
    found: list[list[Label]] = []
    for label, scenario in scenarios.items():
        key = batch_key(scenario)
        if key is None:
            found.append([label])
        else:
            groups.setdefault(key, []).append(label)
    for its in groups.values():
        found += [its[i : i + most] for i in range(0, len(its), most)]
    return sorted(found, key=len, reverse=True)


def batch_key(scenario: Scenario) -> str | None:
    """Settings that runs must share to share a batch; None for a run that shares none.

    A run shares none if its bits could differ there: a plant, law, observer or reference from
    outside this program may round differently for several rigs; a law with a period or a computing
    time of its own has channels that others lack, and so has a controller that is a program.
    """
    choice = scenario.controller
    if plants.PLANTS[scenario.plant.kind].as_alone is None or choice.kind in ALONE_KINDS:
        return None
    if scenario.takes_time or scenario.board or scenario.law_ticks > 1 or is_foreign(scenario):
        return None
    law = cast("type[Law]", choices("controller")[choice.kind])
    known = {**alike(scenario), "needs": law.needs}
    return json.dumps(known, sort_keys=True, default=str)


def work_in_batches(
    work: Callable[[Sequence[Scenario]], Sequence[Found]],
    scenarios: Mapping[Label, Scenario],
    processes: int,
) -> Iterator[list[tuple[Label, Found]]]:
    """Labels and results of the scenarios of one batch after the other, as they come.

    Args:
        work: What is done with the scenarios of a batch, a function of a module; a result each.
        scenarios: By label.
        processes: Number of processes that work side by side.
    """
    batches = group(scenarios, processes)
    jobs = ((number, [scenarios[each] for each in its]) for number, its in enumerate(batches))
    for number, found in results(work, jobs, min(processes, len(batches))):
        yield list(zip(batches[number], found, strict=True))


def run_together(scenarios: Sequence[Scenario]) -> Iterator[Run | LawError]:
    """The run of each scenario, in their order, or how its law failed.

    A run that ends early, or in which a condition is detected, is repeated alone: its record ends
    with it, and its events are its own.

    Args:
        scenarios: Of one batch, as ``group`` makes them.

    Raises:
        KeyboardInterrupt: If the user interrupts.
        TwinError: If a scenario cannot be assembled.
    """
    refuse_faults(scenarios)
    found: Iterable[Run | None] = [None] * len(scenarios)
    if len(scenarios) > 1:
        with suppress(TwinError):  # one of them is the cause: its own run reports it
            found = _batch(scenarios)
    for scenario, done in zip(scenarios, found, strict=True):
        yield run_alone(scenario) if done is None else done


def run_alone(scenario: Scenario) -> Run | LawError:
    """The run of a scenario, or how its law failed.

    Raises:
        KeyboardInterrupt: If the user interrupts it.
        TwinError: If the scenario cannot be assembled.
    """
    try:
        done = run(scenario)
    except LawError as error:
        return error
    if done.interrupted:
        raise KeyboardInterrupt
    return done


def _batch(scenarios: Sequence[Scenario]) -> Iterator[Run | None]:
    """The runs of one batch, made when they are taken; None for those to be repeated alone."""
    with controller_building.own_errors():
        rig, controller = assemble.assemble(scenarios, threads=1, unseen=True, as_alone=True)
        first = scenarios[0]
        period = first.rig.period
        ticks, knows = round(first.duration / period), controller.observer.knows
        record = Recorder(ticks, len(scenarios), period, rig.channels, knows)
        begin = time.perf_counter()
        outcomes = drive(rig, controller, first.duration, record)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    spent = (time.perf_counter() - begin) / len(scenarios)
    reference = controller.reference
    assert isinstance(reference, PerRigReference)

    def runs() -> Iterator[Run | None]:
        for number, (scenario, outcome) in enumerate(zip(scenarios, outcomes, strict=True)):
            if outcome.ending is not Ending.FINISHED or rig.journal:
                yield None
                continue
            with controller_building.own_errors():
                yield Run.of(
                    scenario,
                    record.of_rig(number),
                    outcome,
                    reference.members[number],
                    real_time_factor=record.length * period / spent,
                )

    return runs()
