"""The exact model under continuous control: the tables as an accurate integrator gives them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from controllers.arrays import Array
from controllers.per_rig import Fleet, Paths
from twin.thesis.reproduce.cases import Case, laws
from twin.thesis.reproduce.continuous import Loop
from twin.thesis.reproduce.measures import Trace
from twin.thesis.reproduce.noise import draw, repeated

GRID = 0.002
"""Seconds between the instants at which a solution for full state feedback is looked at."""
STEP = 0.01
"""Integration step in s with an observer: halving it changes no indicator by more than 0.05 %."""


def exact(cases: Sequence[Case]) -> list[Trace]:
    """One trace a case; cases with an observer must differ in law and reference only."""
    if cases[0].observer is None:
        return [full_state(case) for case in cases]
    return with_observer(cases)


def full_state(case: Case, tolerance: float = 1e-9) -> Trace:
    """The closed loop with full state feedback, by a multistep method of variable order."""
    law, path, model = case.law(), case.path(), case.model

    def rate(t: float, z: Array) -> Array:
        x, q = z[:8], z[8:]
        u = law.control(t, x, path, q)
        return np.concatenate((model.derivative(x, u), law.memory_rate(t, x, path, q)))

    time = np.linspace(0, case.duration, round(case.duration / GRID) + 1)
    start = np.zeros(8 + law.memory)
    solution = solve_ivp(
        rate, (0, case.duration), start, "LSODA", time, rtol=tolerance, atol=tolerance / 100
    )
    z = solution.y.T
    u = np.array(
        [law.control(t, row[:8], path, row[8:]) for t, row in zip(time.tolist(), z, strict=True)]
    )
    state = z[:, None, :8]
    return Trace(time=time, state=state, u=u[:, None], reference=path(time)[0], estimate=state)


def with_observer(cases: Sequence[Case], step: float = STEP) -> list[Trace]:
    """The closed loops of several cases with their seeds, as one batch."""
    case = cases[0]
    estimator = case.estimator()
    assert estimator is not None
    paths = Paths(tuple(each.path() for each in cases), case.seeds)
    rigs = case.seeds * len(cases)
    noise = None
    if case.noise_hold:
        noise = repeated(draw(case.duration, case.seeds, case.noise_hold), len(cases))
    loop = Loop(
        law=Fleet(laws(cases), case.seeds),
        reference=paths,
        rigs=rigs,
        estimator=estimator,
        dead_time=case.dead_time,
        predicted=case.predicted,
        noise=noise,
        step=step,
    )
    with np.errstate(over="ignore", invalid="ignore"):
        x, estimate, u = loop.run(case.duration)
    time = step * np.arange(len(x))
    wished = paths(time)[0]
    groups = [slice(case.seeds * i, case.seeds * (i + 1)) for i in range(len(cases))]
    return [
        Trace(
            time=time,
            state=x[:, own],
            u=u[:, own],
            reference=wished[:, own.start],
            estimate=estimate[:, own],
            ended="" if np.isfinite(x[:, own]).all() else "at least one run diverged",
        )
        for index, own in enumerate(groups)
    ]
