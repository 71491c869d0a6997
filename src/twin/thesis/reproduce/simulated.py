"""A case simulated: sampled at 2 ms through the seam, or in continuous time as in the thesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from controllers.arrays import Array, Mask
from controllers.controller import Controller, PerRigLaw
from controllers.interfaces import Law, Measurement, Reference
from twin.hal.cams import CamTable, FixedRatio
from twin.hal.interface import Limits, Transmission
from twin.run.loop import Ending, Outcome, drive
from twin.run.record import Recorder
from twin.sim.drives import DriveModel
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Plant
from twin.sim.plant.mechanism import Mechanism
from twin.sim.rig import SimulatedDevices, SimulatedRig
from twin.sim.sensors import EncoderModel, TouchModel
from twin.thesis.reproduce.cases import (
    BALL,
    DISTURBANCE,
    OUTPUTS,
    PLATE,
    Estimator,
    HeldNoise,
    SimulationCase,
    SimulationTrace,
    draw,
    laws,
    paths,
    repeated,
    streams,
)

PERIOD = 0.002
FINE, COARSE = 0.0005, 0.002
"""Physics steps of the mechanism in s: the steady errors of full state feedback, 0.1 mm and less,
shrink with the step; with noise nothing changes by more than 0.01 % between 0.5 and 2 ms."""
UNLIMITED = Limits(angle=1.5, rate=100.0, acceleration=1e4, area=(10.0, 10.0))
"""The thesis's simulations saturate nothing."""


class FromOrigin(Controller):
    """A controller whose estimate begins where the thesis's does: at the origin."""

    def start(self, measurement: Measurement) -> None:
        """Begin with ball and plate at rest on the centre, whatever is measured."""
        super().start(measurement._replace(y=np.zeros_like(measurement.y)))


class EndlessPlate(ExactPlant):
    """The exact model as the thesis simulates it: its plate has no edge."""

    @property
    def on_plate(self) -> Mask:
        """Always, shape (N,)."""
        return np.ones(self.rigs, bool)


def sampled(
    cases: Sequence[SimulationCase], *, mechanism: bool = False, period: float = PERIOD
) -> list[SimulationTrace]:
    """One trace per case; the cases must differ in law and reference only.

    Args:
        cases: What to run, side by side.
        mechanism: Whether on the MuJoCo mechanism without rolling friction, or on the exact model.
        period: Control period in s.

    Raises:
        KeyboardInterrupt: If the user interrupts.
    """
    case = cases[0]
    reference = paths(cases, period)
    controller = FromOrigin(
        PerRigLaw(laws(cases)), case.sampled_observer(period), reference, period
    )
    ticks = round(case.duration / period) + 1
    rigs = case.seeds * len(cases)
    record = Recorder(ticks, rigs, period, keep=("state", "applied", "estimate"))
    outcomes = drive(_rig(case, len(cases), period, mechanism), controller, ticks * period, record)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    desired = reference(record.time)[0]
    traces = []
    for index in range(len(cases)):
        own = slice(case.seeds * index, case.seeds * (index + 1))
        traces.append(
            SimulationTrace(
                time=record.time,
                state=record["state"][:, own],
                u=record["applied"][:, own],
                reference=desired[:, own.start],
                estimate=record["estimate"][:, own],
                ended=_early(outcomes[own]),
                until=outcomes[own.start].time,
            )
        )
    return traces


def _early(outcomes: Sequence[Outcome]) -> str:
    """Which runs did not last, in words; empty if all did."""
    early = sorted((end.time, end.ending) for end in outcomes if end.ending != Ending.FINISHED)
    if not early:
        return ""
    time, ending = early[0]
    return f"{len(early)} of {len(outcomes)} runs ended early, the first {ending} at {time:.1f} s"


def _rig(case: SimulationCase, cases: int, period: float, mechanism: bool) -> SimulatedRig:
    """Rigs with the imperfections the thesis simulated, and no others."""
    rigs = case.seeds * cases
    noisy = case.noise_hold > 0
    plant: Plant
    transmission: Transmission
    if mechanism:
        step = min(COARSE if noisy else FINE, period)
        plant = Mechanism(rigs=rigs, threads=1, friction=Friction(), step=step)
        transmission = CamTable.packaged()
    else:
        plant, transmission = EndlessPlate(case.model, rigs=rigs, step=period), FixedRatio()
    none = (0.0, 0.0)
    devices = SimulatedDevices(
        plant,
        period=period,
        touch=TouchModel(dead_time=case.dead_time, grid=0, variance=BALL if noisy else none),
        encoders=EncoderModel(counts=0, variance=PLATE if noisy else none),
        drives=DriveModel(disturbance=DISTURBANCE if noisy else none),
        hold=max(1, round(case.noise_hold / period)),
        seeds=streams(case.seeds, cases),
    )
    return SimulatedRig(
        devices,
        transmission=transmission,
        limits=UNLIMITED,
        period=period,
        ideal=case.observer is None,
        # The disturbance makes the drives drift, so the sum of all commands goes astray.
        anchor=0.0,
    )


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
