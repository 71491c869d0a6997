"""The control loop: one controller, one rig, until the time is up or all rigs have ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.hal.rig import Rig
from twin.hal.supervisor import State
from twin.run.record import Recorder


class Ending(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    FELL = "fell"
    LOST = "lost"
    FAULT = "fault"
    ABORTED = "aborted"
    DIVERGED = "diverged"


Begin = Callable[[Measurement], Measurement]
Keep = Callable[[int, Measurement], None]
INTERRUPTED = "interrupted"
"""The reason of a run that Ctrl-C ended."""
KILLED = "killed before its end; the record goes as far as it was written"
"""The reason of a run whose process or computer ended without a word."""
RAN_AWAY = "the simulation's numbers ran away"
"""The reason of a run that diverged."""


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


class RunMonitor:
    """Decides for each of N rigs whether and how its run has ended.

    Args:
        rig: The rigs.
    """

    STOP_WATCH = 2.0
    """Seconds a holding rig is watched further: its ball may come to rest or still fall."""

    def __init__(self, rig: Rig) -> None:
        self.outcomes: dict[int, Outcome] = {}
        self._rig = rig
        self._rigs = len(rig.supervisor.state)
        self._stopped = np.full(self._rigs, np.nan)

    def watch(self, measurement: Measurement) -> bool:
        """Take in a new period; return whether every rig has ended."""
        if self._rig.supervisor.all_running and not self._rig.any_fallen:
            return False
        self._note(measurement.time, self._rig.fallen)
        return len(self.outcomes) == self._rigs

    def examine(self, time: float) -> bool:
        """Look whose numbers have run away, whatever came of it; return whether all have ended."""
        for rig in np.flatnonzero(self._rig.diverged).tolist():
            known = self.outcomes.get(rig)
            if known is None or known.ending is not Ending.DIVERGED:
                self.outcomes[rig] = Outcome(Ending.DIVERGED, time, RAN_AWAY)
        return len(self.outcomes) == self._rigs

    def _note(self, time: float, fallen: NDArray[np.bool_]) -> None:
        supervisor = self._rig.supervisor
        stopped = (supervisor.state == State.HOLDING) | (supervisor.state == State.FAULT)
        self._stopped = np.where(stopped & np.isnan(self._stopped), time, self._stopped)
        lost = supervisor.lost
        for rig in range(self._rigs):
            reason = supervisor.reason[rig]
            if rig in self.outcomes:
                continue
            if fallen[rig]:
                self.outcomes[rig] = Outcome(Ending.FELL, time, reason or "ball left the plate")
            elif supervisor.state[rig] == State.FAULT:
                self.outcomes[rig] = Outcome(Ending.FAULT, time, reason)
            elif lost[rig] and not supervisor.by_device[rig]:
                self.outcomes[rig] = Outcome(Ending.LOST, time, "screen no longer feels the ball")
            elif time - self._stopped[rig] > self.STOP_WATCH:
                self.outcomes[rig] = self._stop(rig)

    def _stop(self, rig: int) -> Outcome:
        """The outcome of a rig that was stopped."""
        supervisor = self._rig.supervisor
        ending = Ending.FAULT if supervisor.by_device[rig] else Ending.ABORTED
        return Outcome(ending, float(self._stopped[rig]), supervisor.reason[rig])

    def final(self, time: float, otherwise: Ending, reason: str = "") -> list[Outcome]:
        """One outcome a rig; those that have not ended get the ending given."""
        self.examine(time)
        end = []
        for rig in range(self._rigs):
            stop = self._stopped[rig]
            if rig in self.outcomes:
                end.append(self.outcomes[rig])
            elif np.isnan(stop):
                end.append(Outcome(otherwise, time, reason))
            else:
                end.append(self._stop(rig))
        return end


def passed(
    rig: Rig,
    recorder: Recorder,
    measurement: Measurement,
    estimate: Array,
    requested: Array,
    applied: Array,
    further: Array,
    computing: Array | None = None,
) -> Measurement:
    """Record a control period whose rate is written, and wait for the next.

    Args:
        rig: The rigs.
        recorder: Takes the period in.
        measurement: The one that began it.
        estimate: State that was believed in, shape (N, 8).
        requested: Plate accelerations that were asked for, rad/s^2, shape (N, 2).
        applied: Those that came of it, shape (N, 2).
        further: What was estimated beyond the state, shape (N, k).
        computing: How long the command is computed and how late it is, s, shape (N, 2).

    Returns:
        The measurement that begins the next.
    """
    channels = {
        "measured": measurement.y,
        "age": measurement.age,
        "touched": measurement.touched,
        "estimate": estimate,
        "requested": requested,
        "applied": applied,
        "supervisor": rig.supervisor.state,
    }
    if recorder.further:
        channels["further"] = further
    if computing is not None:
        channels["computing"] = computing
    recorder.append(measurement.time, channels | rig.telemetry())
    rig.wait()
    return rig.read()


def drive(
    rig: Rig,
    controller: Controller,
    duration: float,
    recorder: Recorder,
    progress: Callable[[float], None] = lambda _: None,
    *,
    begin: Begin | None = None,
    keep: Keep | None = None,
) -> list[Outcome]:
    """Run the loop until a time in s and return one outcome per rig.

    A rig whose ball fell, was lost or passed a limit has ended; the loop goes on for the others.
    Ctrl-C ends all of them as aborted, with the plate levelled and the record kept.

    Args:
        rig: The rigs, not switched on.
        controller: Theirs.
        duration: Time of the run in s at which it ends.
        recorder: Takes every period in.
        progress: Called with the time in s now and then.
        begin: Begins in the middle of a run: puts rig and controller, just started, into another
            state and returns the measurement of that moment.
        keep: Shown number and measurement of every period before anything is done in it.
    """
    monitor = RunMonitor(rig)
    end, reason = Ending.FINISHED, ""
    with rig:
        measurement = rig.read()
        controller.start(measurement)
        if rig.in_real_time or controller.timed:
            # a first command takes longer than a period: plans are laid, memory is touched
            controller.command(measurement)
            controller.start(measurement)
        rig.start()
        if begin is not None:
            measurement = begin(measurement)
        try:
            for tick in range(round(measurement.time / rig.period), round(duration / rig.period)):
                if measurement.time > duration - rig.period / 2:
                    break
                if keep is not None:
                    keep(tick, measurement)
                step = controller.command(measurement)
                applied = controller.applied(rig.write(step.rate))
                decided = (step.estimate, step.acceleration, applied, *step[3:])
                measurement = passed(rig, recorder, measurement, *decided)
                if monitor.watch(measurement):
                    break
                if tick % 100 == 0:
                    progress(measurement.time)
                    if monitor.examine(measurement.time):
                        break
        except KeyboardInterrupt:
            end, reason = Ending.ABORTED, INTERRUPTED
    return monitor.final(recorder.end, end, reason)
