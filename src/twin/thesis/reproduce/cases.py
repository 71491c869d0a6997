"""What the thesis simulated: from a row's settings to law, observer and reference; its noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.controller import PerRigReference
from controllers.interfaces import Law, Observer, Reference
from controllers.smith import Smith
from twin.scenario.schema import checked_settings, choices
from twin.thesis.reproduce.estimators import ConstantGain, Estimator, continuous, kalman_gain

BALL = (7.2538e-7, 1.7721e-7)
"""Variances of x and y in m^2, Table B.1."""
PLATE = (1.5433e-10, 1.1580e-10)
"""Variances of phi and theta in rad^2, Table B.1."""
DISTURBANCE = (1.0816e-4, 2.8090e-5)
"""Variances of the plate accelerations in (rad/s^2)^2, Table B.1."""


@dataclass(frozen=True, kw_only=True)
class SimulationCase:
    """One simulation of the thesis, the ball at rest on the centre at t = 0.

    Attributes:
        duration: Seconds.
        controller: Kind and settings of the law.
        reference: Kind and settings of the path.
        observer: Kind and settings of the observer; None for full state feedback.
        dead_time: Delay of the measured ball position in s.
        predicted: Whether a Smith predictor makes up for it.
        noise_hold: Seconds for which noise and disturbance of Table B.1 are held; 0 for none.
        seeds: Number of runs that differ in their noise.
        steady_from: Time in s from which steady tracking is judged.
        bands: Settling band in %, then the narrowest and the widest it may have been read with.
        constant_gain: Whether an EKF's gain stays at its value at the origin.
    """

    duration: float
    controller: Mapping[str, Any]
    reference: Mapping[str, Any]
    observer: Mapping[str, Any] | None = None
    dead_time: float = 0.0
    predicted: bool = False
    noise_hold: float = 0.0
    seeds: int = 1
    steady_from: float = 0.0
    bands: tuple[float, float, float] = (5.0, 5.0, 5.0)
    constant_gain: bool = False
    model: BallPlate = field(default_factory=BallPlate, repr=False)

    def law(self) -> Law:
        """The state feedback."""
        law: Law = _build("controller", self.controller, model=self.model)
        return law

    def path(self) -> Reference:
        """The reference."""
        path: Reference = _build("reference", self.reference)
        return path

    def sampled_observer(self, period: float) -> Observer:
        """The observer at a control period, in the predictor if there is one."""
        settings = self.observer or {"kind": "ideal"}
        observer: Observer = _build("observer", settings, model=self.model, period=period)
        if self.predicted:
            return Smith(observer=observer, delay=self.dead_time, model=self.model, period=period)
        return observer

    def estimator(self) -> Estimator | None:
        """The observer in continuous time; None for full state feedback."""
        if self.observer is None:
            return None
        observer: Observer = _build("observer", self.observer, model=self.model)
        if self.constant_gain:
            gain = kalman_gain(self.model, self.observer["Q"], self.observer["R"])
            return ConstantGain(self.model, gain, exact=True)
        return continuous(observer)


def laws(cases: Sequence[SimulationCase]) -> list[Law]:
    """The law of every run, case by case: the same object where the settings are the same."""
    made: list[tuple[Mapping[str, Any], Law]] = []
    found: list[Law] = []
    for case in cases:
        same = [law for settings, law in made if settings == case.controller]
        law = same[0] if same else case.law()
        made.append((case.controller, law))
        found += [law] * case.seeds
    return found


def paths(cases: Sequence[SimulationCase], period: float) -> PerRigReference:
    """The reference of every run, case by case."""
    members = [case.path() for case in cases]
    each = [path for case, path in zip(cases, members, strict=True) for _ in range(case.seeds)]
    return PerRigReference(each, period)


def _build(table: str, choice: Mapping[str, Any], **given: object) -> Any:
    settings = dict(choice)
    cls = choices(table)[settings.pop("kind")]
    return cls(**checked_settings(cls, settings), **given)


class HeldNoise(NamedTuple):
    """Draws of K intervals for N rigs."""

    hold: float
    """Length of an interval in s."""
    measured: Array
    """Added to x, phi, y, theta; shape (K, N, 4)."""
    disturbance: Array
    """Added to the plate accelerations in rad/s^2; shape (K, N, 2)."""


def streams(runs: int, cases: int = 1) -> list[np.random.SeedSequence]:
    """Seeds of the rigs: ``runs`` neighbouring ones per case, the same for every case."""
    return [
        np.random.SeedSequence(0, spawn_key=(run,)) for _ in range(cases) for run in range(runs)
    ]


def draw(duration: float, runs: int, hold: float) -> HeldNoise:
    """What simulated devices with these seeds draw, to the last bit.

    Each rig's seed has children: of the screen's noise (0) and of the phase of its frames (1), of
    the encoders (2) and of the disturbance (3).

    Args:
        duration: Seconds to be covered, both ends included.
        runs: Number of runs.
        hold: Seconds for which a draw is held.
    """
    intervals = math.floor(duration / hold + 1e-9) + 1

    def source(child: int, variance: tuple[float, float]) -> Array:
        seeds = [seed.spawn(child + 1)[child] for seed in streams(runs)]
        draws = [np.random.default_rng(s).standard_normal((intervals, 2)) for s in seeds]
        return np.stack(draws, axis=1) * np.sqrt(variance)

    measured = np.empty((intervals, runs, 4))
    measured[..., 0::2] = source(0, BALL)
    measured[..., 1::2] = source(2, PLATE)
    return HeldNoise(hold, measured, source(3, DISTURBANCE))


def repeated(noise: HeldNoise, cases: int) -> HeldNoise:
    """The same draws for several cases side by side."""
    times = (1, cases, 1)
    return HeldNoise(noise.hold, np.tile(noise.measured, times), np.tile(noise.disturbance, times))
