"""Connects a rig of a rig file: the real one, or any program that speaks its bytes.

Besides how long a controller computes on this computer, and a log of a rig that any program drove,
from a trace of its bus.
"""

from __future__ import annotations

import time
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.base.errors import LogError
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.decoding import Conversation
from twin.devices.kinds import Surroundings, build_device
from twin.devices.own import OwnScreen, OwnServos
from twin.devices.own_loading import load_backend
from twin.devices.realtime import LatencyHistogram, Paused, RealTimeClock, never, real_time
from twin.devices.rig import HardwareRig
from twin.hal.cams import CamTable, FixedRatio
from twin.hal.interface import AXIS_NAMES, PoweredScreen, PoweredServos, Transmission
from twin.run.assemble import assemble
from twin.run.controller_building import build_limits, own_errors
from twin.run.logs import COLUMN_UNITS, read_csv
from twin.scenario.passed import has_passed
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario

if TYPE_CHECKING:
    from twin.devices.akd.recording import Hear

UNPASSED_REASON = "`ballplate doctor --move` has not passed under this configuration"
"""Why the first motion of a rig is slow."""


def connect(
    scenario: Scenario,
    rig: RigFile,
    *,
    reset: bool = False,
    transmission: Transmission | None = None,
    paused: Paused = never,
    hear: Hear | None = None,
) -> HardwareRig:
    """The rig of a file, to run a scenario's controller on; nothing is opened yet.

    Args:
        scenario: Period, limits and number of axes.
        rig: What is connected where.
        reset: Whether faults found in the drives are reset when they are switched on.
        transmission: Of a virtual rig; the rig file's by default.
        paused: Tells how long this computer paused, for which a virtual rig's time stands still.
        hear: Is given every frame on the bus of the drives; must not wait.

    Raises:
        TwinError: If the settings do not go together.
    """
    period, allowed = scenario.rig.period, rig.late_periods
    limits = build_limits(rig.limited(scenario))
    common: dict[str, Any] = {
        "limits": limits,
        "home": (radians(rig.home_deg[0]), radians(rig.home_deg[1])),
        "patience": rig.patience,
        "reset": reset,
        "relaxed": rig.relaxed(period),
        "plate_lag": scenario.rig.plate_lag,
        "axes": scenario.plant.axes,
        "unchecked": "" if transmission is not None or has_passed(rig) else UNPASSED_REASON,
    }
    servos, screen = _devices(rig, Surroundings(period=period, limits=limits, hear=hear))
    if servos.sleep is time.sleep:
        clock = RealTimeClock(period, allowed=allowed, paused=paused, now=servos.now)
    else:  # its time may pass only while it sleeps
        clock = RealTimeClock(period, allowed=allowed, spin=0.0, now=servos.now, sleep=servos.sleep)
    return HardwareRig(
        servos=servos,
        screen=screen,
        clock=clock,
        transmission=transmission or transmission_of(rig),
        **common,
    )


def _devices(rig: RigFile, around: Surroundings) -> tuple[PoweredServos, PoweredScreen]:
    """The devices of a rig file, of the kinds that it names; nothing is opened yet.

    Raises:
        TwinError: If the settings do not go together, or a device cannot be made.
    """
    if rig.backend is not None:
        hardware = load_backend(rig.backend, rig.own)
        own = OwnServos(hardware, rig.own, around.limits, around.period)
        return own, OwnScreen(own)
    servos = build_device(
        "drives", rig.kinds["drives"], rig.settings("drives", around.period), around
    )
    around = replace(around, now=servos.now)
    touch = rig.settings("touch", around.period)
    return servos, build_device("touch", rig.kinds["touch"], touch, around)


MAX_COMPUTING_SHARE = 0.8
"""Share of a period that a controller may take: reading, writing and recording need the rest."""
WARN_COMPUTING_SHARE = 0.5
"""Share above which the median leaves too little for what else a computer does."""


class ComputingTime(NamedTuple):
    """How long a controller computes for a period, on this computer.

    Attributes:
        law: The law.
        period: Control period in s.
        median: In s.
        worst: Exceeded by one period of a thousand, s.
    """

    law: str
    period: float
    median: float
    worst: float

    @classmethod
    def measured(cls, scenario: Scenario, seconds: float = 2.0) -> ComputingTime:
        """Run a scenario's controller on its simulated rig, with the priority of a real one.

        Args:
            scenario: The scenario with law and observer.
            seconds: Simulated time, after a tenth of it.

        Raises:
            TwinError: If the scenario cannot be assembled.
        """
        rig, controller = assemble(scenario.without_computing_time)
        times, ticks = LatencyHistogram(), round(seconds / rig.period)
        with own_errors(), real_time(), rig:
            measurement = rig.read()
            controller.start(measurement)
            rig.start()
            for tick in range(ticks + ticks // 10):
                begin = time.perf_counter()
                step = controller.command(measurement)
                passed = time.perf_counter() - begin
                rate = rig.write(step.rate)
                begin = time.perf_counter()
                controller.applied(rate)
                if tick >= ticks // 10:
                    times.add(passed + time.perf_counter() - begin)
                rig.wait()
                measurement = rig.read()
        return cls(scenario.controller.kind, rig.period, times.quantile(0.5), times.quantile(0.999))

    @property
    def never(self) -> bool:
        """Whether no run in real time can keep its periods."""
        return self.median > MAX_COMPUTING_SHARE * self.period

    @property
    def enough(self) -> bool:
        """Whether a run in real time can be expected to keep its periods."""
        return (
            self.median <= WARN_COMPUTING_SHARE * self.period
            and self.worst <= MAX_COMPUTING_SHARE * self.period
        )

    @property
    def text(self) -> str:
        """The shares of a period in words."""
        return (
            f"{self.law} computes for {self.median / self.period:.2f} of the period of "
            f"{1e3 * self.period:g} ms on this computer, {self.worst / self.period:.2f} at worst"
        )

    @property
    def advice(self) -> str:
        """What to do where that is too much."""
        return "close other programs, or choose a law and an observer that compute for less long"


def cams_of(rig: RigFile) -> CamTable:
    """The cam table of a real rig: the one its file names, or the one of the packaged model.

    Raises:
        ModelError: If it cannot be used.
    """
    return CamTable.from_file(Path(rig.cams)) if rig.cams else CamTable.packaged()


def transmission_of(rig: RigFile) -> Transmission:
    """Transmission of a real rig from commanded motors to its plate.

    Raises:
        ModelError: If its cam table cannot be used.
    """
    return cams_of(rig) if rig.has_cams else FixedRatio()


TOUCH_COLUMNS = {"time": "s", "measured_x": "m", "measured_y": "m"}
"""Columns of a file of touch screen data."""
TOUCH_TIMEOUT_S = 0.1
"""Silence of a screen in s after which nothing touches it."""
TRACE_COLUMNS = {"motor_{}": "rad", "motor_{}_rate": "rad/s", "applied_{}_rate": "rad/s"}
"""Columns of a trace, by axis, that a run does not have, and their units."""
TRACE_UNITS = COLUMN_UNITS | {
    name.format(axis): unit for axis in AXIS_NAMES for name, unit in TRACE_COLUMNS.items()
}


def log_of_trace(
    conversation: Conversation, drives: AkdConfig, cams: Transmission, home: Array, touch: Path
) -> dict[str, Array]:
    """A log of a rig that any program drove, from a trace of its drives and its touch data.

    One row for each SYNC while both drives have torque: the newest values of encoders and screen,
    and what is commanded with it. The plate stands at ``home`` in the first row.

    Args:
        conversation: The trace.
        drives: Nodes, scales and signs.
        cams: Plate angles to motor angles.
        home: Plate angles (phi, theta) in rad, shape (2,).
        touch: CSV file with ``time``, ``measured_x`` and ``measured_y``; its clock is the clock
            of the trace, or counts from the first frame.

    Returns:
        Columns, shape (K,) each; ``TRACE_UNITS`` has their units.

    Raises:
        LogError: If the trace or the file lacks what is needed.
    """

    def carried(index: int | None, *, commanded: bool = False) -> Array:
        """What PDOs have carried before each SYNC, both axes side by side, shape (K, 2).

        What a SYNC is answered with belongs to the next, what is commanded goes with its own.
        """
        both = []
        side: Literal["left", "right"] = "right" if commanded else "left"
        for axis in drives.axes:
            key = axis.plate_object if index is None else (index, 0)
            series = conversation.series.get((axis.node, key))
            if series is None:
                raise LogError(
                    f"{conversation.called(axis.node)}: no PDO in the trace carries {key[0]:04X}h"
                )
            newest = np.searchsorted(series.time, sync, side) - 1
            counts = np.unwrap(np.asarray(series.counts, float), period=2.0**32)
            both.append(
                counts[np.maximum(newest, 0)] * conversation.objects.scale(axis.node, key)[0]
            )
        return np.stack(both, axis=1)

    sync = np.asarray(conversation.sync)
    torque = np.flatnonzero((carried(0x6041).astype(int) & 0x6F == 0x27).all(axis=1))
    if len(torque) < 2:
        raise LogError("the trace has no two SYNCs at which both drives have torque")
    sync = sync[torque[0] : torque[-1] + 1]
    plate, motor = carried(None), carried(0x6064)
    plate += home - plate[0]
    motor += cams.motor(home) - motor[0]
    near = 1e-4 * np.eye(2)
    slope = [(cams.motor(plate + each) - cams.motor(plate - each)) / 2e-4 for each in near]
    rate = np.linalg.solve(np.stack(slope, axis=-1), carried(0x60FF, commanded=True)[..., None])[
        ..., 0
    ]
    known = {
        "measured_{}": plate,
        "motor_{}": motor,
        "motor_{}_rate": carried(0x606C),
        "applied_{}_rate": rate,
        "applied_{}_acc": np.diff(rate, axis=0, prepend=0) / np.median(np.diff(sync)),
    }
    rows = {
        name.format(axis): of[:, k]
        for name, of in known.items()
        for k, axis in enumerate(AXIS_NAMES)
    }
    try:
        seen = read_csv(touch, TOUCH_COLUMNS, tuple(TOUCH_COLUMNS))
    except OSError as error:
        raise LogError(f"--touch {touch}: cannot be read: {error.strerror or error}") from error
    known_time = np.isfinite(seen["time"])
    seen = {name: values[known_time] for name, values in seen.items()}
    when = seen["time"]
    if (np.diff(when) < 0).any():
        raise LogError(f"{touch.name}: time must increase from row to row")
    if len(when) and abs(when[0] - conversation.begin) < abs(when[0]):
        when = when - conversation.begin
    newest = np.searchsorted(when, sync, side="right") - 1
    age = sync - when[newest] if len(when) else np.full(len(sync), np.inf)
    there = (newest >= 0) & (age < TOUCH_TIMEOUT_S)
    if not there.any():
        raise LogError(f"{touch.name}: has no row while the drives have torque")
    for name in tuple(TOUCH_COLUMNS)[1:]:
        rows[name] = np.where(there, seen[name][newest], np.nan)
    return {"time": sync - sync[0], "age": np.where(there, age, 0.0), **rows}
