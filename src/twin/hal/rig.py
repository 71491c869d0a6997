"""The rig: the one seam between a controller and a mechanism, simulated or real."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask, constant, put, some
from controllers.interfaces import Measurement
from twin.hal.interface import Clock, FaultSource, Servos, TouchScreen, Transmission
from twin.hal.supervisor import Event, Note, State, Supervisor


class Entry(NamedTuple):
    """A note of the supervisor, and its time in s."""

    time: float
    note: Note


class Rig:
    """N ball-and-plate rigs behind one seam: the common part of simulation and hardware.

    Use it as a context manager: entering switches the drives on and holds the plate, leaving
    levels the plate and switches off, also after an error. Inside, once per period: ``read``,
    ``write``, ``wait``.

    Args:
        servos: The servo axes with the plate encoders.
        screen: The touch screen.
        clock: Time.
        transmission: Plate angles to motor angles.
        supervisor: States and limits.
        period: Control period in s.
        fault_sources: The devices that report faults; one rig only.
        anchor: Time in s from one look-up of the cams at the measured plate angle to the next, to
            the nearest whole number of periods; 0 for every period.
    """

    in_real_time = False
    """Whether its time passes while a controller computes."""
    LEVELLING_S = 2.0
    """Default of ``levelling_s``."""
    LEVEL_RAD = 5e-4
    """Plate angle in rad that counts as level, 0.03 deg."""
    LEVEL_PERIODS = 10
    """Periods for which it has to: the time constant of the supervisor's approach to level."""
    ANCHOR = 0.02
    """Default of ``anchor``, s."""

    def __init__(
        self,
        *,
        servos: Servos,
        screen: TouchScreen,
        clock: Clock,
        transmission: Transmission,
        supervisor: Supervisor,
        period: float,
        fault_sources: Sequence[FaultSource] = (),
        anchor: float = ANCHOR,
    ) -> None:
        self.period = period
        self._period = constant(period)
        self.levelling_s = self.LEVELLING_S
        """Longest time in s for levelling the plate when the rig is left; 0 for not levelling."""
        self.journal: list[Entry] = []
        """Every detected condition, oldest first."""
        self.changes: Callable[[float], None] | None = None
        """Called with the time in s before each period passes; changes the rig's parameters."""
        self.supervisor = supervisor
        self._servos = servos
        self._screen = screen
        self._clock = clock
        self._fault_sources = fault_sources
        self._transmission = transmission
        self._plate: Array = supervisor.angle
        self._motor: Array = supervisor.angle
        self._anchor_ticks = max(1, round(anchor / period))
        self._unanchored = 0

    def __enter__(self) -> Self:
        self.supervisor.handle(Event.INITIALISE)
        try:
            self._power_on()
            self._hold()
        except BaseException:
            self.supervisor.handle(Event.SWITCH_OFF)
            self._power_off()
            raise
        return self

    def _power_on(self) -> None:
        """Bring the devices up; the drives hold the plate then."""

    def _power_off(self) -> None:
        """Disconnect the devices; the drives have no torque then."""

    def _hold(self) -> None:
        """Be ready, with the plate held at its measured angle."""
        self.supervisor.powered(self._of_axes(self._servos.plate()))
        self._anchor()

    def _of_axes(self, pairs: Array) -> Array:
        """Numbers of (phi, theta) or (x, y), shape (N, 2), those of an axis that it lacks 0."""
        return np.where((True, False), pairs, 0.0) if self.supervisor.axes == 1 else pairs

    def __exit__(self, *_: object) -> None:
        try:
            self.level()
        finally:
            self._servos.command(np.zeros_like(self._motor))
            self.supervisor.handle(Event.SWITCH_OFF)
            self._power_off()

    def level(self) -> None:
        """Level the plate, as far as the drives can; the controller is ignored from here on."""
        self.supervisor.handle(Event.LEVEL)
        still, plate, level = np.zeros_like(self.supervisor.rate), self.supervisor.angle, 0
        for tick in range(round(self.levelling_s / self.period)):
            holding = self.supervisor.state == State.HOLDING
            # by the measured angle, and not a plate that only passes level or is measured late
            level = level + 1 if (np.abs(plate)[holding] < self.LEVEL_RAD).all() else 0
            if level > self.LEVEL_PERIODS or not holding.any():
                break
            # the longer it takes, the longer the delay of the plate may be
            self.supervisor.drift_time = max(Supervisor.DRIFT_TIME_S, tick * self.period / 4)
            self.write(still)
            self.wait()
            plate = self.read().y[:, 1::2]

    def meanwhile(self, work: Callable[[], None]) -> None:
        """Do work that may take longer than a period, before the controller moves the plate."""
        work()

    def start(self) -> None:
        """Let the controller move the plate from now on."""
        self.supervisor.handle(Event.START)

    def read(self) -> Measurement:
        """The present measurement; a rig past a limit is stopped here."""
        touch = self._screen.read()
        plate = self._servos.plate()
        y = np.empty((len(plate), 4))
        y[..., 0::2] = self._of_axes(touch.position)
        y[..., 1::2] = self._of_axes(plate)
        self.supervisor.watch(y, touch.touched)
        for device in self._fault_sources:
            for fault in device.faults():
                self.supervisor.report(fault)
        time = self._clock.time
        if self.supervisor.notes:
            self.journal += [Entry(time, note) for note in self.supervisor.notes]
            self.supervisor.notes.clear()
        return Measurement(time, y, touch.age, touch.touched, self.truth())

    def truth(self) -> Array | None:
        """The true state, shape (N, 8), of a simulated rig with ideal sensors; else None."""
        return None

    def write(self, rate: Array) -> Array:
        """Command plate rates (phi', theta') in rad/s, shape (N, 2); return those applied.

        The applied rates are the requested ones after every clamp of the supervisor.
        """
        self._unanchored += 1
        if self._unanchored >= self._anchor_ticks:
            self._anchor()
        applied = self.supervisor.clamp(self._of_axes(rate))
        self._plate = self._plate + self._period * applied
        motor = self._transmission.motor(self._plate)
        self._servos.command((motor - self._motor) / self._period)
        self._motor = motor
        return applied

    def _anchor(self) -> None:
        """Re-reference the commanded angle to the encoders, since integrated commands drift."""
        self._plate = self.supervisor.angle
        self._motor = self._transmission.motor(self._plate)
        self._unanchored = 0

    def adopt(self, rigs: NDArray[np.integer], other: Rig) -> None:
        """Replace some rigs by others that have just been started.

        The rigs of a batch keep their common times: those at which the cams are looked up again
        (``anchor``), and those over which the speed of the ball is measured.

        Args:
            rigs: Their indices.
            other: As many rigs with the same limits and the devices that these now have.
        """
        self.supervisor.adopt(rigs, other.supervisor)
        self._plate = put(self._plate, rigs, other._plate)
        self._motor = put(self._motor, rigs, other._motor)

    def replace_transmission(self, transmission: Transmission) -> None:
        """Use a new transmission from now on; the plate does not move."""
        self._transmission = transmission
        self._motor = transmission.motor(self._plate)

    def wait(self) -> None:
        """Return at the beginning of the next control period."""
        if self.changes is not None:
            self.changes(self._clock.time)
        self._clock.wait()

    @property
    def fallen(self) -> Mask:
        """Whether a ball is known to have left the plate, shape (N,); a real rig cannot know."""
        return np.zeros(len(self.supervisor.state), bool)

    @property
    def any_fallen(self) -> bool:
        """Whether any ball is known to have left the plate."""
        return some(self.fallen)

    @property
    def diverged(self) -> Mask:
        """Whether a rig's numbers have run away, shape (N,); those of a real one cannot."""
        return np.zeros(len(self.supervisor.state), bool)

    channels: tuple[str, ...] = ()
    """Names of the columns of the telemetry channel ``plant``, each ending in its unit."""

    def telemetry(self) -> dict[str, Array]:
        """Further channels for the record, each shape (N, columns); never for the controller."""
        return {}

    def account(self) -> dict[str, Any]:
        """Statistics of the run that has ended, for its record; empty if there are none."""
        return {}
