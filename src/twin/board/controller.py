"""A controller that is a compiled program, in the place of the one in Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.catalog import EXECUTION_LOG
from controllers.controller import Controller, ControlStep, HeldCommand
from controllers.interfaces import ControlLaw, Measurement, Observer, Reference
from twin.base.errors import ScenarioError
from twin.board.control import Control
from twin.board.process import BoardProcess
from twin.board.program import TARGETS, check_program, compile_controller


@dataclass(frozen=True, kw_only=True)
class Board:
    """The processor that has a controller, and how it is found.

    Raises:
        ScenarioError: If there is no such program.
    """

    program: str
    """A target for which the controller is compiled, or the file of a program, an ``.elf``."""
    real: str
    """Type of its numbers, ``double`` or ``float``, if it is compiled."""
    clock_hz: float | None
    """Instructions that it could do in a second if each took a cycle; None for no time at all."""
    cycles_per_instruction: tuple[float, float]
    """Minimum and maximum of an instruction's mean number of cycles; times use the maximum."""
    time_limit: float
    """Maximum time in s that the program may take for an answer."""
    control: Callable[[], Control]
    """Makes the controller that the program is compiled from."""

    def __post_init__(self) -> None:
        """Check that there is such a program."""
        check_program(self.program, "board.program")

    def begin(self, period: float) -> BoardProcess:
        """The process of its program, for a control period in s.

        Raises:
            TwinError: If the program cannot be made or found.
            AnswerError: If it does not begin as one that speaks the protocol.
        """
        if self.program in TARGETS:
            file = compile_controller(self.control(), self.program, self.real)
        else:
            file = Path(self.program)
            EXECUTION_LOG.info("runs the program %s, a controller for a board", file.resolve())
        return BoardProcess(file, f"board.program {self.program}", period, self.time_limit)

    def computing_time(self, instructions: float) -> float:
        """How long a number of instructions takes, s.

        Raises:
            ScenarioError: If it is not known how many they are.
        """
        if self.clock_hz is None:
            return 0.0
        if not instructions:
            raise ScenarioError(
                f"board.clock_hz: program {self.program} counts no instructions; remove the key"
            )
        return instructions * self.cycles_per_instruction[1] / self.clock_hz


class BoardController(Controller):
    """The controller of a board, run in lockstep with the same controller in Python.

    The controller in Python gets the same measurements and the applied rates. Its requested rates
    are recorded and command nothing.

    A board that computes for longer than a period misses the measurements of the periods meanwhile.
    Its command is applied so many periods later, a started period counted as one; until then the
    previous rate is held. The observer of the board knows nothing of the periods that it missed.

    Args:
        law: The law in Python.
        observer: The observer in Python.
        reference: The path of the ball.
        period: Control period in s.
        boards: One per rig.
    """

    def __init__(
        self,
        law: ControlLaw,
        observer: Observer,
        reference: Reference,
        period: float,
        boards: Sequence[Board],
    ) -> None:
        super().__init__(law, observer, reference, period)
        self._boards = boards

    def start(self, measurement: Measurement) -> None:
        """Begin with the ball and the plate where the measurement sees them, at rest."""
        super().start(measurement)
        self._processes = [each.begin(self.period) for each in self._boards]
        self._held = [HeldCommand(None, self.period, 1, np.zeros(2)) for _ in self._boards]
        self._estimate = np.full((len(self._boards), 8), np.nan)

    def command(self, measurement: Measurement) -> ControlStep:
        """The boards' estimates for a measurement, and their requests to the rigs."""
        python = super().command(measurement)
        t, count = measurement.time, len(self._boards)
        path = np.broadcast_to(self.reference(t).reshape(5, -1, 2), (5, count, 2))
        rate, instructions = np.empty((count, 2)), np.full((count, 1), np.nan)
        acceleration = np.full((count, 2), np.nan)
        for rig, (board, process, held) in enumerate(
            zip(self._boards, self._processes, self._held, strict=True)
        ):
            held.timing = math.nan, 0.0
            if held.due(t) and held.free(t):
                seen = t, *measurement.y[rig], measurement.age[rig], measurement.touched[rig]
                answer = process.ask([*map(float, seen), *path[:, rig].ravel().tolist()])
                took = board.computing_time(answer.instructions)
                held.take(t, answer.rate, took)
                self._estimate[rig], instructions[rig] = answer.estimate, answer.instructions
                if took <= self.period:
                    acceleration[rig] = answer.acceleration
            rate[rig] = held.hold(t)
        plain = (rate - self.rate) / self.period
        timed = any(board.clock_hz is not None for board in self._boards)
        return ControlStep(
            self._estimate.copy(),
            np.where(np.isnan(acceleration), plain, acceleration),
            rate,
            np.full_like(python.further, np.nan),
            np.array([held.timing for held in self._held]) if timed else python.computing,
            np.hstack((np.where(instructions > 0, instructions, np.nan), python.acceleration)),
        )
