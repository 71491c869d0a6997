"""Builds the controllers of scenarios: law, observer, predictor and reference of each."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import FrozenInstanceError
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.catalog import AnswerError, locate_error, wrong_answer
from controllers.controller import MEASURED_TIME, Controller, HeldLaw, needed_columns
from controllers.interfaces import ControlLaw, DelayedObserver, Law, Observer, Reference
from controllers.per_rig import PerRigLaw, PerRigObserver, PerRigReference
from controllers.references import ALONG_X, AlongX
from controllers.smith import Smith
from twin.base.errors import LawError, ScenarioError, TwinError
from twin.base.settings import from_scenarios
from twin.hal.interface import Limits
from twin.scenario import schema
from twin.scenario.schema import Scenario, choices

if TYPE_CHECKING:
    from twin.board.control import Control
    from twin.board.controller import Board


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
        if line := line_of(error):
            raise LawError(line) from error
        raise
    finally:
        sys.stdin = stdin


def line_of(error: BaseException) -> str:
    """What came out of a law, observer or reference; empty if it came of something else."""
    line = str(error) if isinstance(error, AnswerError) else locate_error(error)
    if isinstance(error, IndexError) and line:
        line += " (x is a state of shape (1, 8), or (N, 8) of N rigs: x[..., 4] is its fifth)"
    if isinstance(error, FrozenInstanceError) and line:
        line += " (many rigs share one law: its state is `memory`, see memory_rate)"
    if sys.flags.dev_mode or not line:
        return ""
    return ", ".join((line, *getattr(error, "__notes__", ())))


def build_controllers(scenarios: Sequence[Scenario]) -> Controller:
    """The controllers of N scenarios as one, each designed on the ball its designer knows.

    Equal laws, observers and references are made once and shared.

    Raises:
        ScenarioError: If a law, observer or reference refuses its settings, or several are to be
            measured.
    """
    period = scenarios[0].rig.period
    if len(scenarios) > 1 and any(
        each.controller.computing_time == MEASURED_TIME for each in scenarios
    ):
        raise ScenarioError(
            "controller.computing_time: 'measured' works for a single run only, as the rigs of a "
            "batch share their computer; give seconds"
        )
    laws = _each(scenarios, [law_of(each) for each in scenarios], build_law)
    estimation = [each.model_dump_json(include={"observer", "predictor"}) for each in scenarios]
    needs = [(each.designed_on, law.needs) for each, law in zip(scenarios, laws, strict=True)]
    observers = _each(scenarios, list(zip(estimation, needs, strict=True)), _observer)
    ways = [(each.reference.model_dump_json(), str(each.rig.limits.area)) for each in scenarios]
    references = _each(scenarios, ways, build_reference)
    for law, observer in zip(laws, observers, strict=True):
        try:
            needed_columns(law, observer)
        except ValueError as error:
            raise ScenarioError(f"controller: {error}") from error
    parts: tuple[ControlLaw, Observer, Reference, float]
    if len(scenarios) == 1:
        parts = laws[0], observers[0], references[0], period
    else:
        parts = (
            laws[0] if len(set(map(id, laws))) == 1 else PerRigLaw(laws),
            observers[0] if len(set(map(id, observers))) == 1 else PerRigObserver(observers),
            PerRigReference(references, period),
            period,
        )
    if all(each.board is None for each in scenarios):
        return Controller(*parts)
    from twin.board.controller import BoardController  # noqa: PLC0415  loaded when needed

    return BoardController(*parts, [_board(each) for each in scenarios])


def _board(scenario: Scenario) -> Board:
    """The board of a scenario.

    Raises:
        ScenarioError: If it has none.
    """
    from twin.board.controller import Board  # noqa: PLC0415  loaded when needed

    if scenario.board is None:
        raise ScenarioError("board: either all rigs of a batch have a board, or none")
    return Board(**dict(scenario.board), control=partial(control_of, scenario))


def control_of(scenario: Scenario) -> Control:
    """What the controller of a scenario in C is made of.

    Raises:
        ScenarioError: If its law, observer or reference refuses its settings.
    """
    from twin.board.control import Control  # noqa: PLC0415  loaded when needed

    return Control(
        scenario.title,
        build_law(scenario),
        _observer(scenario),
        build_reference(scenario),
        build_limits(scenario),
        scenario.rig.period,
        scenario.duration,
        (scenario.plant.start.x, scenario.plant.start.y),
    )


def build_controller(scenario: Scenario) -> Controller:
    """The controller of one scenario.

    Raises:
        ScenarioError: If its law, observer or reference refuses its settings.
    """
    return build_controllers([scenario])


def _each(
    scenarios: Sequence[Scenario], names: Sequence[Hashable], make: Callable[..., Made]
) -> list[Made]:
    """What is made of each scenario, once for those of one name."""
    made = {name: make(one) for name, one in dict(zip(names, scenarios, strict=True)).items()}
    return [made[name] for name in names]


def build_law(scenario: Scenario) -> ControlLaw:
    """The law of a scenario.

    Raises:
        ScenarioError: If it refuses its settings, or does not answer as a law does.
    """
    choice = scenario.controller
    cls = choices("controller")[choice.kind]
    return _design_law(cls, choice.model_dump_json(), scenario.law_ticks, scenario.designed_on)


@lru_cache(maxsize=1024)
def _design_law(cls: type, choice: str, ticks: int, model: BallPlate) -> ControlLaw:
    """A law has no state: one object serves all runs of this process."""
    chosen = schema.ControllerChoice.model_validate_json(choice)
    law: Law = _build("controller", chosen, model=model)
    if problem := wrong_answer(law):
        raise ScenarioError(problem)
    time = chosen.computing_time
    return HeldLaw(law, ticks, time) if ticks > 1 or time else law


def law_of(scenario: Scenario) -> tuple[str, BallPlate]:
    """Key that differs between the laws of scenarios."""
    return scenario.controller.model_dump_json(), scenario.designed_on


def _observer(scenario: Scenario) -> Observer:
    """The observer with what makes up for the dead time: itself, or a predictor around it."""
    model, period, predictor = scenario.designed_on, scenario.rig.period, scenario.predictor
    choice, delay = scenario.observer, 0.0 if predictor is None else predictor.delay
    given: dict[str, Any] = {"model": model, "period": period}
    if issubclass(choices("observer")[choice.kind], DelayedObserver):
        if predictor is not None and predictor.kind is not None:
            raise ScenarioError(
                f"predictor.kind: observer '{choice.kind}' compensates the dead time itself; "
                "leave kind out, predictor.delay then goes to the observer"
            )
        given |= {"delay": delay, "needed": build_law(scenario).needs}
        predictor = None
    observer: Observer = _build("observer", choice, **given)
    if predictor is None:
        return observer
    return Smith(observer=observer, delay=delay + predictor.wait, model=model, period=period)


def build_reference(scenario: Scenario, allowed: ArrayLike | None = None) -> Reference:
    """The reference of a scenario, which must stay within the operating area.

    Args:
        scenario: The scenario with the reference.
        allowed: Operating area |x|, |y| of the rig that it runs on, m; the scenario's by default.

    Raises:
        ScenarioError: If it leaves the area or refuses its settings.
    """
    area = np.asarray(scenario.rig.limits.area if allowed is None else allowed)
    times = np.linspace(0, scenario.duration, 2001)
    with np.errstate(over="ignore", invalid="ignore"):
        reference: Reference = _build("reference", scenario.reference)
        motion: Array = reference(times)
    if not np.isfinite(motion).all():
        raise ScenarioError("reference: the path or a derivative of it is not finite at some time")
    if scenario.plant.axes == 1 and motion[..., 1].any():
        reference, motion = AlongX(reference), motion * ALONG_X
    farthest = np.abs(motion[0]).max(axis=0)
    if (farthest > area + 1e-9).any():
        fits = "; a smaller rig (--on) makes it smaller" if allowed is not None else ""
        raise ScenarioError(
            f"reference: reaches |x|, |y| = {farthest[0]:.3f}, {farthest[1]:.3f} m; "
            f"rig.limits.area allows {area[0]:g}, {area[1]:g} m{fits}"
        )
    return reference


def _build(table: str, choice: schema.Choice, **given: object) -> Any:
    cls = choices(table)[choice.kind]
    settings = schema.checked_settings(cls, choice.settings)
    try:
        return cls(**settings, **given)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ScenarioError(f"{table}: {error}") from error


def build_limits(scenario: Scenario) -> Limits:
    """Limits of the commands to the rig of a scenario, in SI units."""
    return from_scenarios(Limits, [scenario])
