"""From a row's settings to the law, observer and reference that the thesis simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from controllers.ballplate import BallPlate
from controllers.interfaces import Law, Observer, Reference
from controllers.smith import Smith
from twin.scenario.schema import checked_settings, choices
from twin.thesis.reproduce.estimators import ConstantGain, Estimator, continuous, kalman_gain


@dataclass(frozen=True, kw_only=True)
class Case:
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


def laws(cases: Sequence[Case]) -> list[Law]:
    """The laws of the cases: the same object where the settings are the same."""
    made: list[tuple[Case, Law]] = []
    for case in cases:
        same = [law for other, law in made if other.controller == case.controller]
        made.append((case, same[0] if same else case.law()))
    return [law for _, law in made]


def _build(table: str, choice: Mapping[str, Any], **given: object):  # type: ignore[no-untyped-def]
    settings = dict(choice)
    cls = choices(table)[settings.pop("kind")]
    return cls(**checked_settings(cls, settings), **given)
