"""The control loop: one controller, one rig, until the time is up or all rigs have ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from controllers.interfaces import Measurement
from controllers.stack import Controller
from twin.hal.rig import Rig
from twin.hal.supervisor import State
from twin.record import Recorder


class Ending(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    FELL = "fell"
    LOST = "lost"
    FAULT = "fault"
    ABORTED = "aborted"


INTERRUPTED = "interrupted"
"""The reason of a run that Ctrl-C ended."""


@dataclass(frozen=True)
class Outcome:
    """How one rig's run ended, at what time in s, and why in words."""

    ending: Ending
    time: float
    reason: str = ""

    @property
    def interrupted(self) -> bool:
        """Whether a person ended the run."""
        return self.reason == INTERRUPTED


class Referee:
    """Decides for each of N rigs whether and how its run has ended.

    Args:
        rig: The rigs.
    """

    LOST_AFTER = 0.1
    """Seconds without touch after which the ball counts as lost."""
    STOP_WATCH = 2.0
    """Seconds a stopped rig is watched further: its ball may come to rest or still fall."""

    def __init__(self, rig: Rig) -> None:
        self.outcomes: dict[int, Outcome] = {}
        self._rig = rig
        self._rigs = len(rig.supervisor.state)
        self._unseen: float | NDArray[np.floating] = 0.0
        self._stopped = np.full(self._rigs, np.nan)

    def watch(self, measurement: Measurement) -> bool:
        """Take in a new period; return whether every rig has ended."""
        fallen = self._rig.fallen
        if self._rig.supervisor.all_running and measurement.touched.all() and not fallen.any():
            self._unseen = 0.0
            return False
        stopped = self._rig.supervisor.state == State.STOPPED
        self._note(measurement.time, measurement.touched, fallen, stopped)
        return len(self.outcomes) == self._rigs

    def _note(
        self,
        time: float,
        touched: NDArray[np.bool_],
        fallen: NDArray[np.bool_],
        stopped: NDArray[np.bool_],
    ) -> None:
        unseen = np.where(touched, 0.0, self._unseen + self._rig.period)
        self._unseen = unseen
        self._stopped = np.where(stopped & np.isnan(self._stopped), time, self._stopped)
        for rig in range(self._rigs):
            reason = self._rig.supervisor.reason[rig]
            if rig in self.outcomes:
                continue
            if fallen[rig]:
                self.outcomes[rig] = Outcome(Ending.FELL, time, reason or "ball left the plate")
            elif unseen[rig] > self.LOST_AFTER:
                self.outcomes[rig] = Outcome(Ending.LOST, time, "screen no longer feels the ball")
            elif time - self._stopped[rig] > self.STOP_WATCH:
                self.outcomes[rig] = Outcome(Ending.ABORTED, float(self._stopped[rig]), reason)

    def final(self, time: float, otherwise: Ending, reason: str = "") -> list[Outcome]:
        """One outcome a rig; those that have not ended get the ending given."""
        end = []
        for rig in range(self._rigs):
            stop = self._stopped[rig]
            if rig in self.outcomes:
                end.append(self.outcomes[rig])
            elif np.isnan(stop):
                end.append(Outcome(otherwise, time, reason))
            else:
                stopped = self._rig.supervisor.reason[rig]
                end.append(Outcome(Ending.ABORTED, float(stop), stopped))
        return end


def drive(
    rig: Rig,
    controller: Controller,
    duration: float,
    recorder: Recorder,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Outcome]:
    """Run the loop for a duration in s and return one outcome a rig.

    A rig whose ball fell, was lost or passed a limit has ended; the loop goes on for the others.
    Ctrl-C ends all of them as aborted, with the plate levelled and the record kept.
    """
    referee = Referee(rig)
    end, reason = Ending.FINISHED, ""
    with rig:
        measurement = rig.read()
        controller.start(measurement)
        rig.start()
        try:
            for tick in range(round(duration / rig.period)):
                wished = controller.command(measurement)
                before = controller.rate
                rate = rig.write(wished)
                controller.applied(rate)
                recorder.append(
                    measured=measurement.y,
                    age=measurement.age,
                    touched=measurement.touched,
                    estimate=controller.observer.x,
                    wished=controller.u,
                    applied=(rate - before) / rig.period,
                    supervisor=rig.supervisor.state,
                    **rig.telemetry(),
                )
                rig.wait()
                measurement = rig.read()
                if referee.watch(measurement):
                    break
                if tick % 100 == 0:
                    progress(measurement.time)
        except KeyboardInterrupt:
            end, reason = Ending.ABORTED, INTERRUPTED
    return referee.final(recorder.length * rig.period, end, reason)
