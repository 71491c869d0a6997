"""The tables under continuous control: exact model, law, observer, dead time and held noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from controllers.arrays import Array
from controllers.controller import PerRigLaw
from controllers.interfaces import Law, Reference
from twin.thesis.reproduce.cases import HeldNoise, SimulationCase, draw, laws, paths, repeated
from twin.thesis.reproduce.estimators import OUTPUTS, Estimator
from twin.thesis.reproduce.measures import SimulationTrace

POSITION = (0, 4)
"""Where the ball's position stands in the state."""
GRID = 0.002
"""Seconds between the instants at which a solution for full state feedback is looked at."""
STEP = 0.01
"""Integration step in s with an observer: halving it changes no indicator by more than 0.05 %."""


@dataclass(frozen=True, kw_only=True)
class ContinuousLoop:
    """N closed loops, integrated by RK4 with a step that divides the noise's intervals.

    The delayed ball position lies between two steps; there the cubic through both values and
    slopes is taken, which is as exact as the integration itself.

    Attributes:
        law: The law of all rigs.
        reference: The paths it follows, one per rig.
        estimator: The observer; None for full state feedback.
        dead_time: Delay of the measured ball position in s.
        predicted: Whether the observer knows: its own ball position is delayed alike (7.19).
        noise: Measurement noise and disturbance; None for none.
        step: Step of the integration in s.
    """

    law: Law
    reference: Reference
    rigs: int
    estimator: Estimator
    dead_time: float = 0.0
    predicted: bool = False
    noise: HeldNoise | None = None
    step: float = 0.005

    def run(self, duration: float) -> tuple[Array, Array, Array]:
        """State (K, N, 8), estimate (K, N, 8) and requested input (K, N, 2) at every step."""
        h, steps = self.step, round(duration / self.step)
        memory = self.estimator.start(self.rigs)
        z = np.concatenate((np.zeros((self.rigs, 16 + self.law.memory)), memory), axis=1)
        past = np.zeros((2, steps + 1, self.rigs, 2, 2))  # value and slope of whose ball, x and y
        x, xhat = (np.zeros((steps + 1, self.rigs, 8)) for _ in range(2))
        u = np.zeros((steps + 1, self.rigs, 2))
        for k in range(steps + 1):
            t = k * h
            v, w = self._noise(k)
            x[k], xhat[k] = z[:, :8], z[:, 8:16]
            past[0, k] = z[:, :16].reshape(-1, 2, 8)[..., POSITION]
            k1, u[k] = self._rate(t, z, self._late(past, t), v, w)
            past[1, k] = k1[:, :16].reshape(-1, 2, 8)[..., POSITION]
            middle = self._late(past, t + h / 2)
            k2, _ = self._rate(t + h / 2, z + h / 2 * k1, middle, v, w)
            k3, _ = self._rate(t + h / 2, z + h / 2 * k2, middle, v, w)
            k4, _ = self._rate(t + h, z + h * k3, self._late(past, t + h), v, w)
            z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return x, xhat, u

    def _noise(self, step: int) -> tuple[Array, Array]:
        """Measurement noise (N, 4) and disturbance (N, 2) during a step."""
        if self.noise is None:
            return np.zeros(4), np.zeros(2)
        interval = step // round(self.noise.hold / self.step)
        return self.noise.measured[interval], self.noise.disturbance[interval]

    def _late(self, past: Array, t: float) -> Array | None:
        """Ball of plant and of estimate a dead time ago, shape (N, 2, 2); None without one."""
        if not self.dead_time:
            return None
        place = (t - self.dead_time) / self.step
        if place <= 0:
            return np.zeros((self.rigs, 2, 2))
        k = int(place + 1e-9)
        s = place - k
        value, slope = past[:, k : k + 2]
        a, b = self.step * s * (1 - s) ** 2, self.step * s**2 * (s - 1)
        rise = s * s * (3 - 2 * s)
        late: Array = value[0] + rise * (value[1] - value[0]) + a * slope[0] + b * slope[1]
        return late

    def _rate(
        self, t: float, z: Array, late: Array | None, v: Array, w: Array
    ) -> tuple[Array, Array]:
        """Slope of everything, and the input."""
        q_end = 16 + self.law.memory
        x, xhat, q, memory = z[:, :8], z[:, 8:16], z[:, 16:q_end], z[:, q_end:]
        u = self.law.control(t, xhat, self.reference, q)
        y, yhat = x[:, OUTPUTS] + v, xhat[:, OUTPUTS]
        if late is not None:
            y[:, 0::2] = late[:, 0] + v[..., 0::2]
            if self.predicted:
                yhat = yhat.copy()
                yhat[:, 0::2] = late[:, 1]
        slope = np.empty_like(z)
        slope[:, :8] = self.estimator.model.derivative(x, u + w)
        slope[:, 8:16], slope[:, q_end:] = self.estimator.rate(xhat, memory, u, y - yhat)
        slope[:, 16:q_end] = self.law.memory_rate(t, xhat, self.reference, q)
        return slope, u


def exact(cases: Sequence[SimulationCase]) -> list[SimulationTrace]:
    """One trace per case; cases with an observer must differ in law and reference only."""
    if cases[0].observer is None:
        return [full_state(case) for case in cases]
    return with_observer(cases)


def full_state(case: SimulationCase, tolerance: float = 1e-9) -> SimulationTrace:
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
    return SimulationTrace(
        time=time, state=state, u=u[:, None], reference=path(time)[0], estimate=state
    )


def with_observer(cases: Sequence[SimulationCase], step: float = STEP) -> list[SimulationTrace]:
    """The closed loops of several cases with their seeds, as one batch."""
    case = cases[0]
    estimator = case.estimator()
    assert estimator is not None
    reference = paths(cases, step)
    rigs = case.seeds * len(cases)
    noise = None
    if case.noise_hold:
        noise = repeated(draw(case.duration, case.seeds, case.noise_hold), len(cases))
    loop = ContinuousLoop(
        law=PerRigLaw(laws(cases)),
        reference=reference,
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
    desired = reference(time)[0]
    groups = [slice(case.seeds * i, case.seeds * (i + 1)) for i in range(len(cases))]
    return [
        SimulationTrace(
            time=time,
            state=x[:, own],
            u=u[:, own],
            reference=desired[:, own.start],
            estimate=estimate[:, own],
            ended="" if np.isfinite(x[:, own]).all() else "at least one run diverged",
        )
        for own in groups
    ]
