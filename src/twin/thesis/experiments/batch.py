"""Experiments on rigs: every experiment with every set of parameters, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.interfaces import Law
from controllers.observers.luenberger import Luenberger
from controllers.per_rig import Fleet, Paths
from controllers.sliding_mode import SlidingMode
from twin.hal.cams import CamTable, Direct
from twin.hal.limits import Limits
from twin.hal.rig import Transmission
from twin.paths import model_path
from twin.run.loop import Outcome, drive
from twin.run.record import Recorder
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Plant
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.parts import Parts
from twin.sim.plant.surface import SurfaceMap
from twin.sim.rig import Bench, SimulatedRig
from twin.sim.sensors import EncoderModel, TouchModel
from twin.thesis.experiments.effects import Slow, Wrong
from twin.thesis.experiments.fleet import SomePredicted, Watched
from twin.thesis.experiments.rig import Rig
from twin.thesis.experiments.tables import Experiment

PERIOD = 0.002
EVERY = 5
"""Control periods from one recorded instant to the next."""
FROM, DURATION = 10.0, 35.12
"""Seconds: steady tracking is judged over two, three or four whole turns of the circle."""
FRICTION = ("rolling", "breakaway_ratio", "stribeck_speed", "dwell_time", "viscous")


@dataclass(frozen=True, kw_only=True)
class Trace:
    """What one rig did in one experiment, K instants.

    Attributes:
        time: Seconds, shape (K,).
        state: True state, shape (K, 8).
        estimate: The observer's, which the controller acts on, shape (K, 8).
        measured: The measurement as it arrived, shape (K, 4).
        reference: Wished ball position in m, shape (K, 2).
        u: Applied plate accelerations in rad/s^2, shape (K, 2): of each recorded stretch the
            largest by amount.
        outcome: How it ended.
    """

    time: Array
    state: Array
    estimate: Array
    measured: Array
    reference: Array
    u: Array
    outcome: Outcome


@dataclass(kw_only=True)
class Excerpt(Recorder):
    """A record of every few control periods."""

    controller: Watched
    _tick: int = 0
    _u: Array = field(default_factory=lambda: np.zeros(2))

    def append(self, time: float, **channels: NDArray[Any]) -> None:
        """Take in one control period."""
        u = channels["applied"]
        self._u = np.where(np.abs(u) > np.abs(self._u), u, self._u)
        if self._tick % EVERY == 0:
            super().append(
                time,
                state=channels["state"],
                estimate=self.controller.estimate,
                measured=channels["measured"],
                u=self._u,
            )
            self._u = np.zeros(2)
        self._tick += 1


def simulate(
    experiments: Sequence[Experiment],
    rigs: Sequence[Rig],
    *,
    mechanism: bool = True,
    duration: float = DURATION,
    seed: int = 0,
    parts: Parts | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[list[Trace]]:
    """For every experiment one trace a rig.

    Args:
        experiments: What to do.
        rigs: On which rigs.
        mechanism: Whether on the MuJoCo mechanism, or on the exact model (five times faster).
        duration: Seconds.
        seed: Root of the noise.
        parts: What of the mechanism differs from the model file.
        progress: Told the simulated seconds, times rigs.

    Raises:
        KeyboardInterrupt: If the user has enough.
    """
    batches: dict[tuple[object, ...], list[int]] = {}
    for index, rig in enumerate(rigs):
        batches.setdefault(rig.common, []).append(index)
    found: list[dict[int, Trace]] = [{} for _ in experiments]
    done = 0.0
    for indices in batches.values():
        share = len(indices)
        batch = _Batch(experiments, [rigs[i] for i in indices], mechanism, parts, seed)
        traces = batch.run(duration, onwards(progress, done, share))
        done += share * duration
        for own, mine in zip(found, traces, strict=True):
            own.update(zip(indices, mine, strict=True))
    return [[own[index] for index in range(len(rigs))] for own in found]


def onwards(
    progress: Callable[[float], None], before: float, share: float
) -> Callable[[float], None]:
    """Progress that goes on from what was done before."""
    return lambda now: progress(before + share * now)


class _Batch:
    """M experiments on N rigs that may differ in what a batch's rigs may differ in."""

    def __init__(
        self,
        experiments: Sequence[Experiment],
        rigs: Sequence[Rig],
        mechanism: bool,
        parts: Parts | None,
        seed: int,
    ) -> None:
        self.experiments, self.rigs = experiments, rigs
        self.mechanism, self.parts, self.seed = mechanism, parts, seed
        self.common = rigs[0]

    def run(self, duration: float, progress: Callable[[float], None]) -> list[list[Trace]]:
        """One list of N traces an experiment."""
        each = len(self.rigs)
        paths = Paths(tuple(experiment.path() for experiment in self.experiments), each)
        observer = SomePredicted(
            observer=Luenberger(poles=self.common.poles, period=PERIOD),
            delay=TouchModel.dead_time,
            predicted=np.repeat([each_.predicted for each_ in self.experiments], each),
        )
        law = Fleet([self._law(experiment) for experiment in self.experiments], each)
        controller = Watched(law, observer, paths, PERIOD)
        ticks = round(duration / PERIOD)
        record = Excerpt(
            ticks=ticks // EVERY + 1,
            rigs=each * len(self.experiments),
            period=PERIOD * EVERY,
            controller=controller,
        )
        outcomes = drive(self._rig(), controller, duration, record, progress)
        if any(outcome.interrupted for outcome in outcomes):
            raise KeyboardInterrupt
        wished = paths(record.time)[0]
        return [
            [
                Trace(
                    time=record.time,
                    reference=wished[:, each * i],
                    outcome=outcomes[k],
                    **{name: values[: record.length, k] for name, values in record.data.items()},
                )
                for k in range(each * i, each * (i + 1))
            ]
            for i in range(len(self.experiments))
        ]

    def _law(self, experiment: Experiment) -> Law:
        law = experiment.law()
        return replace(law, epsilon=self.common.epsilon) if isinstance(law, SlidingMode) else law

    def _stack(self, name: str) -> Array:
        """A parameter of every rig of the batch."""
        values = np.array([getattr(rig, name) for rig in self.rigs], float)
        return np.tile(values, (len(self.experiments),) + (1,) * (values.ndim - 1))

    def _plant(self) -> tuple[Plant, Transmission]:
        rigs = len(self.rigs) * len(self.experiments)
        friction = Friction(**{name: self._stack(name) for name in FRICTION}, map=self._map())
        level = self._stack("level")
        plant: Plant
        transmission: Transmission
        if self.mechanism:
            given = self.parts or Parts()
            parts = [_parts(given, rig) for rig in self.rigs] * len(self.experiments)
            plant = Mechanism(rigs=rigs, threads=1, friction=friction, parts=parts)
            transmission = CamTable.from_file(model_path("cams.json"))
        else:
            plant = ExactPlant(rigs=rigs, step=PERIOD, friction=friction, level=level)
            transmission = Direct()
        lag, dither = self._stack("servo_lag"), self._stack("dither")
        if lag.any() or dither.any():
            plant = Slow(plant, PERIOD, lag, dither, self.common.dither_frequency)
        coupling, error = self._stack("coupling"), self._stack("cam_error")
        if coupling.any() or error.any():
            transmission = Wrong(transmission, coupling, error)
        return plant, transmission

    def _map(self) -> SurfaceMap | None:
        """The screens' unevenness, if any has some."""
        if not any(rig.waves or rig.patches for rig in self.rigs):
            return None
        maps = [
            SurfaceMap.random(seed=rig.surface, spread=rig.patches, slope=rig.waves)
            for rig in self.rigs
        ] * len(self.experiments)
        return SurfaceMap(
            relative=np.stack([np.asarray(each.relative) for each in maps]),
            height=np.stack([np.asarray(each.height) for each in maps]),
        )

    def _rig(self) -> SimulatedRig:
        plant, transmission = self._plant()
        common = self.common
        ball, plate, push = common.variances()
        noisy = common.noise > 0
        bench = Bench(
            plant,
            period=PERIOD,
            touch=TouchModel(dead_time=common.dead_time, grid=4096 if noisy else 0, variance=ball),
            encoders=EncoderModel(counts=16384 if noisy else 0, variance=plate),
            disturbance=push,
            hold=common.hold,
            seed=self.seed,
        )
        # The thesis's rig had no guard of its area: an experiment ends where the screen does.
        limits = Limits(margin=0.1, rate=common.rate)
        return SimulatedRig(bench, transmission=transmission, limits=limits, period=PERIOD)


def _parts(given: Parts, rig: Rig) -> Parts:
    """What of a mechanism a rig's parameters change."""
    changes: dict[str, Any] = {}
    if any(rig.level):
        changes["level"] = rig.level
    if rig.offset:
        changes["offset"] = (rig.offset, 0.0, 0.0)
    if rig.oval:
        changes["oval"] = rig.oval
    return replace(given, **changes)
