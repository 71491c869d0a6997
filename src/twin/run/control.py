"""From scenarios to the controller of N rigs."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.catalog import AnswerError, blamed, wrong_answer
from controllers.controller import (
    Controller,
    HeldLaw,
    PerRigLaw,
    PerRigObserver,
    PerRigReference,
    needed,
)
from controllers.interfaces import DelayedObserver, Law, Observer, Reference
from controllers.smith import Smith
from twin.errors import LawError, ScenarioError, TwinError
from twin.scenario.schema import Choice, ControllerChoice, Scenario, checked_settings, choices

Made = TypeVar("Made")


@contextmanager
def own_errors() -> Iterator[None]:
    """Errors of laws, observers and references as one line within the context.

    There is no input to be had in it: who asks for some gets the end of it.

    Raises:
        LawError: What came out of one of them: file, line and error; also an exit.
    """
    stdin, sys.stdin = sys.stdin, io.StringIO()
    try:
        yield
    except TwinError:
        raise
    except (Exception, SystemExit) as error:
        line = str(error) if isinstance(error, AnswerError) else blamed(error)
        if isinstance(error, IndexError) and line:
            line += " (x is a state of shape (1, 8), or (N, 8) of N rigs: x[..., 4] is its fifth)"
        line = None if sys.flags.dev_mode else line
        if line is None:
            raise
        raise LawError(line) from error
    finally:
        sys.stdin = stdin


def build_controllers(scenarios: Sequence[Scenario]) -> Controller:
    """The controllers of N scenarios as one, each designed on the ball its designer knows.

    Equal laws, observers and references are made once and shared.

    Raises:
        ScenarioError: If a law, observer or reference refuses its settings.
    """
    period = scenarios[0].rig.period
    laws = _each(scenarios, law_of, build_law)
    observers = _each(scenarios, _observed, _observer)
    references = _each(scenarios, _referred, build_reference)
    for law, observer in zip(laws, observers, strict=True):
        try:
            needed(law, observer)
        except ValueError as error:
            raise ScenarioError(f"controller: {error}") from error
    if len(scenarios) == 1:
        return Controller(laws[0], observers[0], references[0], period)
    return Controller(
        laws[0] if len(set(map(id, laws))) == 1 else PerRigLaw(laws),
        observers[0] if len(set(map(id, observers))) == 1 else PerRigObserver(observers),
        PerRigReference(references, period),
        period,
    )


def build_controller(scenario: Scenario) -> Controller:
    """The controller of one scenario.

    Raises:
        ScenarioError: If its law, observer or reference refuses its settings.
    """
    return build_controllers([scenario])


def _each(
    scenarios: Sequence[Scenario], name: Callable[[Scenario], Hashable], make: Callable[..., Made]
) -> list[Made]:
    """What is made of each scenario, once for those of one name."""
    known: dict[Hashable, Made] = {}
    for scenario in scenarios:
        if name(scenario) not in known:
            known[name(scenario)] = make(scenario)
    return [known[name(scenario)] for scenario in scenarios]


def build_law(scenario: Scenario) -> Law:
    """The law of a scenario.

    Raises:
        ScenarioError: If it refuses its settings, or does not answer as a law does.
    """
    choice = scenario.controller
    cls = choices("controller")[choice.kind]
    return _designed(cls, choice.model_dump_json(), scenario.law_ticks, scenario.designed_on)


@lru_cache(maxsize=1024)
def _designed(cls: type, choice: str, ticks: int, model: BallPlate) -> Law:
    """A law has no state: one object serves all runs of this process."""
    chosen = ControllerChoice.model_validate_json(choice)
    law: Law = _build("controller", chosen, model=model)
    if problem := wrong_answer(law):
        raise ScenarioError(problem)
    return law if ticks == 1 else HeldLaw(law, ticks)


def law_of(scenario: Scenario) -> tuple[str, BallPlate]:
    """What tells a scenario's law from others."""
    return scenario.controller.model_dump_json(), scenario.designed_on


def _observed(scenario: Scenario) -> tuple[str, BallPlate]:
    return scenario.model_dump_json(include={"observer", "predictor"}), scenario.designed_on


def _observer(scenario: Scenario) -> Observer:
    """The observer with what makes up for the dead time: itself, or a predictor around it."""
    model, period, predictor = scenario.designed_on, scenario.rig.period, scenario.predictor
    choice, delay = scenario.observer, 0.0 if predictor is None else predictor.delay
    if issubclass(choices("observer")[choice.kind], DelayedObserver):
        if predictor is not None and predictor.kind is not None:
            raise ScenarioError(
                f"predictor.kind: observer '{choice.kind}' makes up for the dead time itself; "
                "leave kind out, predictor.delay then goes to the observer"
            )
        own: Observer = _build("observer", choice, model=model, period=period, delay=delay)
        return own
    observer: Observer = _build("observer", choice, model=model, period=period)
    if predictor is None:
        return observer
    return Smith(observer=observer, delay=delay, model=model, period=period)


def _referred(scenario: Scenario) -> str:
    return f"{scenario.reference.model_dump_json()} {scenario.rig.limits.area}"


def build_reference(scenario: Scenario) -> Reference:
    """The reference of a scenario, which must stay within the operating area.

    Raises:
        ScenarioError: If it leaves the area or refuses its settings.
    """
    area = np.asarray(scenario.rig.limits.area)
    times = np.linspace(0, scenario.duration, 2001)
    with np.errstate(over="ignore", invalid="ignore"):
        reference: Reference = _build("reference", scenario.reference)
        motion: Array = reference(times)
    if not np.isfinite(motion).all():
        raise ScenarioError("reference: it or a derivative of it is no finite number at some time")
    farthest = np.abs(motion[0]).max(axis=0)
    if (farthest > area + 1e-9).any():
        raise ScenarioError(
            f"reference: reaches |x|, |y| = {farthest[0]:.3f}, {farthest[1]:.3f} m; "
            f"rig.limits.area allows {area[0]:g}, {area[1]:g} m"
        )
    return reference


def _build(table: str, choice: Choice, **given: object) -> Any:
    cls = choices(table)[choice.kind]
    settings = checked_settings(cls, choice.settings)
    try:
        return cls(**settings, **given)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ScenarioError(f"{table}: {error}") from error
