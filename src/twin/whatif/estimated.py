"""A moment of a log: the twin is led along it and let go in the state that the log shows."""

from __future__ import annotations

from functools import partial

import numpy as np

from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import Measurement
from twin.run.assemble import assemble, build_controller
from twin.run.record import CHANNELS
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedRig
from twin.whatif.judge import Usable
from twin.whatif.moment import LOOK_BACK, Moment, Recorded
from twin.whatif.recorded import columns_of
from twin.whatif.smooth import path

LED = 0.6
"""Time in s for which the twin is led along the log before it is let go."""
CATCH_UP = 0.3
"""Time in s of it within which the plate gets from level to where the log has it."""
DRAWN = 0.1
"""Time constant in s with which the plate is kept on the log's angles."""
WARMED = 8.0
"""Longest time in s for which an observer is warmed; a law with a memory sees the whole log."""


def estimated(name: str, log: Usable, scenario: Scenario, at: float) -> Moment:
    """A moment of a log.

    Args:
        name: What the log is called.
        log: Fit for it, see ``judge``.
        scenario: What ran.
        at: The moment, s; a whole number of periods within the log.
    """
    columns = columns_of(log)
    ball, u = (
        np.stack([columns[name] for name in names], axis=1)
        for names in (("estimated_x", "estimated_y"), CHANNELS["applied"].columns)
    )
    return Moment(
        name=name,
        at=at,
        scenario=scenario,
        recorded=Recorded(log.time, ball, log.plate, u),
        columns=columns,
        exact=False,
        before_mm=_apart(log, scenario, at),
        controller=partial(_warmed, log, scenario, at),
        put=partial(_led, log, at),
        gaps=log.gaps,
        notes=log.notes,
    )


def _warmed(log: Usable, scenario: Scenario, at: float) -> Controller:
    """The controller of a scenario, having seen the log up to a moment and no gap."""
    controller = build_controller(scenario)
    since = log.unbroken_since(at)
    if not controller.law.memory:
        since = max(since, at - WARMED)
    rows = np.flatnonzero((log.time > since - 1e-9) & (log.time < at - 1e-9))
    for number, row in enumerate(rows.tolist()):
        measurement = log.measurement(row)
        if number == 0:
            controller.start(measurement)
            controller.rate = log.command[max(row - 1, 0)][None]
        controller.command(measurement)
        controller.applied(log.command[row : row + 1])
    return controller


def _led(log: Usable, at: float, rig: SimulatedRig, led: float = LED) -> Measurement:
    """Lead a rig along the log up to a moment and let it go there."""
    period = rig.period
    ticks = min(round(led / period), round((at - log.unbroken_since(at)) / period))
    begin = at - ticks * period
    rig.devices.begin_at(begin)
    times = begin + period * np.arange(ticks + 1)
    angle = _counted_less(
        np.stack([np.interp(times, log.time, log.plate[:, axis]) for axis in (0, 1)], axis=1)
    )
    rate = log.commanded(times)
    share = np.minimum(1.0, (times - begin) / min(CATCH_UP, max(led / 2, period)))
    blend = share**2 * (3 - 2 * share)
    ball, velocity = path(times, log.samples)
    state = np.stack((ball[:, 0], velocity[:, 0], ball[:, 1], velocity[:, 1]), axis=1)
    # right after a gap the path is not known yet: the ball is kept where it is known first
    known = np.isfinite(state).all(axis=1)
    state = state[np.maximum(np.arange(ticks + 1), int(np.argmax(known)))]
    rig.devices.place(state[:1])
    rig.devices.forget()
    rig.supervisor.forget_ball()
    for tick in range(ticks):
        rig.devices.place(state[tick : tick + 1])
        rig.read()
        # d/dt (blend angle), and what draws the plate there
        rising = (blend[tick + 1] - blend[tick]) / period
        steered = blend[tick] * rate[tick] + rising * angle[tick]
        lacking = blend[tick] * angle[tick] - rig.supervisor.angle[0]
        rig.write((steered + lacking / DRAWN)[None])
        rig.wait()
    rig.devices.place(state[ticks : ticks + 1])
    rig.supervisor.rate = log.commanded(np.array([at - period]))
    return rig.read()


def _counted_less(angle: Array, rows: int = 10) -> Array:
    """Angles of encoders, shape (K, 2), as means over some rows on both sides."""
    padded = np.pad(angle, ((rows, rows), (0, 0)), mode="reflect", reflect_type="odd")
    total = np.cumsum(np.concatenate((np.zeros((1, 2)), padded)), axis=0)
    mean: Array = (total[2 * rows + 1 :] - total[: -2 * rows - 1]) / (2 * rows + 1)
    return mean


def _apart(log: Usable, scenario: Scenario, at: float) -> float | None:
    """Largest distance in mm of twin and log over the last second, under the log's commands."""
    begin = at - LOOK_BACK
    period = scenario.rig.period
    if log.unbroken_since(at) > begin - LED / 2:
        return None
    rig, _ = assemble(scenario)
    rig.LEVELLING_TIME = 0.0
    times = begin + period * np.arange(round(LOOK_BACK / period))
    found: list[Array] = []
    with rig:
        rig.read()
        rig.start()
        _led(log, begin, rig)
        for rate in log.commanded(times):
            rig.write(rate[None])
            rig.wait()
            rig.read()
            found.append(rig.devices.state[0, 0::4])
    known, _ = path(times + period, log.samples)
    apart = np.hypot(*(np.array(found) - known).T)
    return float(1000 * np.nanmax(apart)) if np.isfinite(apart).any() else None
