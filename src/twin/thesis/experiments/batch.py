"""Experiments on rigs: every experiment on every rig, side by side as one batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import Scenario
from twin.scenario.load import check, read, resolved
from twin.sim.encoders import COUNTS
from twin.thesis.experiments.judge import ExperimentTrace
from twin.thesis.experiments.tables import MeasuredExperiment
from twin.thesis.reproduce.cases import BALL, DISTURBANCE, PLATE

RigKeys = Mapping[str, Any]
"""What is peculiar to a rig: scenario keys and values, laid over those of an experiment."""

EVERY = 5
"""Control periods from one recorded instant to the next."""
DURATION = 35.12
"""Seconds that an experiment lasts."""


def rolling(arm: float) -> RigKeys:
    """A rig with a rolling friction arm in m."""
    return {"plant.friction.rolling_mm": 1000 * arm}


def noise(factor: float) -> RigKeys:
    """A rig with noise and disturbance of Table B.1 times a factor; 0 leaves out the grids, too."""
    variances = {
        "sensors.touch.variance": BALL,
        "sensors.encoders.variance": PLATE,
        "disturbance.variance": DISTURBANCE,
    }
    return {
        **{key: [factor * each for each in variance] for key, variance in variances.items()},
        "sensors.touch.grid": 4096 if factor else 0,
        "sensors.encoders.counts": COUNTS if factor else 0,
    }


def on_rig(name: str, rig: RigKeys, *, mechanism: bool, duration: float) -> Scenario:
    """A scenario of chapter 9 on a rig.

    Args:
        name: The scenario's.
        rig: What is peculiar to the rig. Settings of the law count where the scenario has them.
        mechanism: Whether on the MuJoCo mechanism, or on the exact model.
        duration: Seconds.

    Raises:
        ScenarioError: If a key is unknown or its value out of range.
    """
    tables, source = read(name)
    settings = {key: value for key, value in rig.items() if _applies(key, tables["controller"])}
    settings["duration"] = duration
    if not mechanism:
        settings |= {"plant.kind": "lagrange", "plant.step": 0.002}
    return check(*resolved(tables, source, settings.items()))


def _applies(key: str, law: Mapping[str, Any]) -> bool:
    table, _, name = key.partition(".")
    return table != "controller" or name in law


def simulate(
    experiments: Sequence[MeasuredExperiment],
    rigs: Sequence[RigKeys],
    *,
    mechanism: bool = True,
    duration: float = DURATION,
    progress: Callable[[float], None] = lambda _: None,
) -> list[list[ExperimentTrace]]:
    """For every experiment one trace per rig.

    Args:
        experiments: What to do.
        rigs: On which rigs.
        mechanism: Whether on the MuJoCo mechanism, or on the exact model (five times faster).
        duration: Seconds.
        progress: Called with the simulated seconds.

    Raises:
        KeyboardInterrupt: If the user interrupts.
        ScenarioError: If a rig's keys are unknown or out of range.
    """
    scenarios = [
        on_rig(experiment.scenario, rig, mechanism=mechanism, duration=duration)
        for experiment in experiments
        for rig in rigs
    ]
    seeds = [np.random.SeedSequence(0, spawn_key=(k,)) for k in range(len(scenarios))]
    rig, controller = assemble(scenarios, threads=1, seeds=seeds)
    record = Recorder(
        round(duration / rig.period),
        len(scenarios),
        rig.period,
        keep=("state", "estimate", "measured", "applied"),
        every=EVERY,
    )
    outcomes = drive(rig, controller, duration, record, progress)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    desired = controller.reference(record.time)[0].reshape(record.length, -1, 2)
    traces = [
        ExperimentTrace(
            time=record.time,
            state=record["state"][:, k],
            estimate=record["estimate"][:, k],
            measured=record["measured"][:, k],
            reference=desired[:, k],
            u=record["applied"][:, k],
            outcome=outcome,
        )
        for k, outcome in enumerate(outcomes)
    ]
    return [traces[i : i + len(rigs)] for i in range(0, len(traces), len(rigs))]
