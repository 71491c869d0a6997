"""The sampled loop through the seam: the same controller that drives a rig, at 2 ms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.interfaces import Measurement
from controllers.per_rig import Fleet, Paths
from controllers.stack import Controller
from twin.hal.cams import CamTable, Direct
from twin.hal.limits import Limits
from twin.hal.rig import Transmission
from twin.paths import model_path
from twin.run.loop import Ending, Outcome, drive
from twin.run.record import Recorder
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.interface import Plant
from twin.sim.plant.mechanism import Mechanism
from twin.sim.rig import SimulatedRig
from twin.sim.sensors import EncoderModel, TouchModel
from twin.thesis.reproduce.cases import Case, laws
from twin.thesis.reproduce.measures import Trace
from twin.thesis.reproduce.noise import BALL, DISTURBANCE, PLATE, SeededBench, streams

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
        super().start(replace(measurement, y=np.zeros_like(measurement.y)))

    def command(self, measurement: Measurement) -> Array:
        """Wished plate rates; the estimate that they follow from is left in ``estimate``."""
        wished = super().command(measurement)
        self.estimate = self.observer.x
        return wished


class EndlessPlate(ExactPlant):
    """The exact model as the thesis simulates it: its plate has no edge."""

    @property
    def on_plate(self) -> NDArray[np.bool_]:
        """Always, shape (N,)."""
        return np.ones(self.rigs, bool)


class AtMeasuredAngle(SimulatedRig):
    """A rig that looks up its cams where the plate is measured to be.

    The drives of these tables drift, by the disturbance: the sum of all commands goes astray.
    """

    def write(self, rate: Array) -> Array:
        """Command plate rates in rad/s, shape (N, 2); return those applied."""
        plate = self.supervisor.angle
        applied = self.supervisor.clamp(rate)
        way = np.stack((plate, plate + self.period * applied))
        before, after = self._transmission.motor(way)
        self._servos.command((after - before) / self.period)
        return applied


@dataclass(kw_only=True)
class Excerpt(Recorder):
    """A record of what the tables are made from, and nothing else.

    Attributes:
        controller: Whose estimate is kept: that of the tick, not the prediction for the next.
    """

    controller: FromOrigin

    def append(self, time: float, **channels: NDArray[Any]) -> None:
        """Add one control period."""
        super().append(
            time,
            state=channels["state"],
            applied=channels["applied"],
            estimate=self.controller.estimate,
        )


def sampled(
    cases: Sequence[Case], *, mechanism: bool = False, period: float = PERIOD
) -> list[Trace]:
    """One trace a case; the cases must differ in law and reference only.

    Args:
        cases: What to run, side by side.
        mechanism: Whether on the MuJoCo mechanism without rolling friction, or on the exact model.
        period: Control period in s.
    """
    case = cases[0]
    rigs = case.seeds * len(cases)
    paths = Paths(tuple(each.path() for each in cases), case.seeds)
    controller = FromOrigin(
        Fleet(laws(cases), case.seeds),
        case.sampled_observer(period),
        paths,
        period,
    )
    ticks = round(case.duration / period) + 1
    record = Excerpt(ticks=ticks, rigs=rigs, period=period, controller=controller)
    outcomes = drive(_rig(case, len(cases), period, mechanism), controller, ticks * period, record)
    if any(outcome.reason == "interrupted" for outcome in outcomes):
        raise KeyboardInterrupt
    wished = paths(record.time)[0]
    traces = []
    for index in range(len(cases)):
        own = slice(case.seeds * index, case.seeds * (index + 1))
        traces.append(
            Trace(
                time=record.time,
                state=record["state"][:, own],
                u=record["applied"][:, own],
                reference=wished[:, own.start],
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


def _rig(case: Case, cases: int, period: float, mechanism: bool) -> AtMeasuredAngle:
    """Rigs with the imperfections the thesis simulated, and no others."""
    rigs = case.seeds * cases
    noisy = case.noise_hold > 0
    plant: Plant
    transmission: Transmission
    if mechanism:
        step = min(COARSE if noisy else FINE, period)
        plant = Mechanism(rigs=rigs, threads=1, rolling=0.0, step=step)
        transmission = CamTable.from_file(model_path("cams.json"))
        transmission.check(model_path())
    else:
        plant, transmission = EndlessPlate(case.model, rigs=rigs, step=period), Direct()
    none = (0.0, 0.0)
    bench = SeededBench(
        plant,
        streams(case.seeds, cases),
        period=period,
        touch=TouchModel(dead_time=case.dead_time, grid=0, variance=BALL if noisy else none),
        encoders=EncoderModel(counts=0, variance=PLATE if noisy else none),
        disturbance=DISTURBANCE if noisy else none,
        hold=max(1, round(case.noise_hold / period)),
    )
    return AtMeasuredAngle(
        bench,
        transmission=transmission,
        limits=UNLIMITED,
        period=period,
        ideal=case.observer is None,
    )
