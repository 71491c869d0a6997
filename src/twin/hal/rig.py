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
    """What the supervisor noted, and when, s."""

    time: float
    note: Note


class Rig:
    """N ball-and-plate rigs behind one seam: what is common to simulation and hardware.

    Use it as a context manager: entering switches the drives on and holds the plate, leaving
    levels the plate and switches off, whatever was raised inside. Within, once a period:
    ``read``, ``write``, ``wait``.

    Args:
        servos: The servo axes with the plate encoders.
        screen: The touch screen.
        clock: Time.
        transmission: Plate angles to motor angles.
        supervisor: States and limits.
        period: Control period in s.
        fault_sources: The devices that report faults; one rig only.
        anchor: Time in s after which the cams are looked up where the plate is measured to be,
            again, to the nearest whole number of periods; 0 for every period.
    """

    in_real_time = False
    """Whether its time passes while a controller computes."""
    LEVELLING_S = 2.0
    """Default of ``levelling_s``."""
    LEVEL = 5e-4
    """Plate angle in rad that counts as level, 0.03 deg."""
    LEVEL_FOR = 10
    """Periods for which it has to: the time constant of the supervisor's last way there."""
    ANCHOR = 0.02
    """Default time in s from one look at the measured plate angle to the next."""

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
        """Every condition that was detected, oldest first."""
        self.changes: Callable[[float], None] | None = None
        """Is told the time in s before each period passes; changes what the rig is made of."""
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
        """Let the devices go; the drives have no torque then."""

    def _hold(self) -> None:
        """Be ready, with the plate held where it is measured."""
        self.supervisor.powered(self._servos.plate())
        self._anchor()

    def __exit__(self, *_: object) -> None:
        try:
            self.level()
        finally:
            self._servos.command(np.zeros_like(self._motor))
            self.supervisor.handle(Event.SWITCH_OFF)
            self._power_off()

    def level(self) -> None:
        """Bring the plate level, as far as the drives can; the controller has no say any more."""
        self.supervisor.handle(Event.LEVEL)
        still, plate, level = np.zeros_like(self.supervisor.rate), self.supervisor.angle, 0
        for tick in range(round(self.levelling_s / self.period)):
            holding = self.supervisor.state == State.HOLDING
            # as it is measured, and not one that only passes its level or is seen there late
            level = level + 1 if (np.abs(plate)[holding] < self.LEVEL).all() else 0
            if level > self.LEVEL_FOR or not holding.any():
                break
            # the longer it takes, the later a plate may do what it is told
            self.supervisor.drift_time = max(Supervisor.DRIFT_TIME, tick * self.period / 4)
            self.write(still)
            self.wait()
            plate = self.read().y[:, 1::2]

    def meanwhile(self, work: Callable[[], None]) -> None:
        """Do what may take longer than a period, before the controller moves the plate."""
        work()

    def start(self) -> None:
        """Let the controller move the plate from now on."""
        self.supervisor.handle(Event.START)

    def read(self) -> Measurement:
        """What the sensors say now; a rig past a limit is stopped here."""
        touch = self._screen.read()
        plate = self._servos.plate()
        y = np.empty((len(plate), 4))
        y[..., 0::2] = touch.position
        y[..., 1::2] = plate
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
        applied = self.supervisor.clamp(rate)
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
        """Let some rigs go on as others that have just been started.

        What the rigs of a batch look at together they go on to look at together: when the plate is
        measured again (``anchor``), and over what times the speed of the ball is.

        Args:
            rigs: Which.
            other: As many rigs with the same limits, of the devices that these now have.
        """
        self.supervisor.adopt(rigs, other.supervisor)
        self._plate = put(self._plate, rigs, other._plate)
        self._motor = put(self._motor, rigs, other._motor)

    def replace_transmission(self, transmission: Transmission) -> None:
        """Look the cams up in another transmission from now on; the plate stays where it is."""
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
        """What there is to say of the run that has ended, for its record; empty if nothing."""
        return {}
