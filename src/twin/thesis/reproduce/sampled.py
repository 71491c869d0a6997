"""The sampled loop through the seam: the same controller that drives a rig, at 2 ms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.arrays import Mask
from controllers.controller import Controller, PerRigLaw
from controllers.interfaces import Measurement
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
    PLATE,
    SimulationCase,
    laws,
    paths,
    streams,
)
from twin.thesis.reproduce.measures import SimulationTrace

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
