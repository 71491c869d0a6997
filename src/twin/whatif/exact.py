"""A moment of a simulated run: simulated again from the last snapshot before it, to the bit."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.errors import RecordError
from twin.run.assemble import assemble, build_controller
from twin.run.finished import Run
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.run.state import Snapshot, snapshots_of
from twin.scenario.schema import Scenario
from twin.whatif.moment import LOOK_BACK, Moment, Recorded

EXACTLY = 1e-9
"""Largest distance in m at which a run counts as simulated again."""


def exact(run: Run, file: Path, at: float) -> Moment:
    """A moment of a simulated run of this version.

    Args:
        run: The run, opened.
        file: Its record.
        at: The moment, s; a whole number of periods within the run.

    Raises:
        RecordError: If the run ends before the twin gets there.
    """
    before = [each for each in snapshots_of(file) if each.time < at + 1e-9]
    snapshot, times, ball = _simulated_again(run.scenario, before[-1] if before else None, at)
    motion = run.motion
    known = motion.ball[np.searchsorted(motion.time, times - 1e-9)]
    last = times > at - LOOK_BACK
    apart = float(np.hypot(*(ball - known)[last].T).max()) if last.any() else None
    return Moment(
        name=run.name,
        at=at,
        scenario=run.scenario,
        recorded=Recorded(motion.time, motion.ball, motion.plate, motion.u),
        columns=run.rows,
        exact=True,
        before_mm=None if apart is None else 1000 * apart,
        controller=partial(_controller, run.scenario, snapshot),
        put=snapshot.restore,
        notes=(
            ("simulated again, the run is another: the program has changed since it was recorded",)
            if apart is not None and apart > EXACTLY
            else ()
        ),
    )


def _controller(scenario: Scenario, snapshot: Snapshot) -> Controller:
    """The controller of a scenario in the state of a snapshot."""
    controller = build_controller(scenario)
    controller.start(snapshot.measured)
    snapshot.restore_controller(controller)
    return controller


def _simulated_again(
    scenario: Scenario, since: Snapshot | None, at: float
) -> tuple[Snapshot, Array, Array]:
    """The state at a moment; times in s, shape (K,), and places of the ball in m on the way there.

    Raises:
        RecordError: If the run ends before.
    """
    rig, controller = assemble(scenario)
    rig.LEVELLING_TIME = 0.0
    period = scenario.rig.period
    record = Recorder(round(at / period) + 1, 1, period, rig.channels, keep=("state",))
    kept: list[Snapshot] = []

    def keep(tick: int, measurement: Measurement) -> None:
        if tick == round(at / period):
            kept.append(Snapshot.take(rig, controller, measurement))

    begin = None if since is None else lambda _: since.restore(rig, controller)
    drive(rig, controller, at + period, record, begin=begin, keep=keep)
    if not kept:
        raise RecordError(f"--at {at:g}: the twin's run ended before, at {record.end:g} s")
    return kept[0], record.time[:-1], record["state"][:-1, 0, 0::4]
