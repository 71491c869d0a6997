"""What a rig needs of its devices: the same for CAN and analogue drives, and any touch screen.

A backend for analogue drives (+-10 V velocity commands, plate encoders on a counter card) is one
file with one class that follows `PoweredServos`: `start` opens the card, `enable` closes the
drives' enable contact, `send` writes the voltages, `receive` reads the counters, `settle` does
nothing, `quick_stop` writes zero and opens the contact, and `faults` reports what the card can see.
Nothing else in the twin knows how the servos are reached.
"""

from __future__ import annotations

from typing import Protocol

from controllers.arrays import Array
from twin.hal.interface import Fault, FaultSource, Servos, TouchScreen


class PoweredServos(Servos, FaultSource, Protocol):
    """Two servo axes with power, commanded once per period.

    Within a period: ``receive``, then ``plate`` and ``motor``, then ``command``, ``send`` and, in
    the idle time that is left, ``settle``.
    """

    def start(self, *, reset: bool = False) -> None:
        """Connect, check and configure, on request also reset faults; no torque yet; may block."""

    def stop(self) -> None:
        """Zero, stop, disable, disconnect; may block; idempotent, never raises."""

    def enable(self) -> None:
        """Request torque at zero rate; ``enabled`` tells when it is there."""

    def quick_stop(self) -> None:
        """Request the fastest stop, then no torque."""

    def warnings(self) -> tuple[Fault, ...]:
        """What every run is to be warned of, from its start."""

    def receive(self) -> None:
        """Take in what has arrived; never waits."""

    def send(self) -> None:
        """Send the commands; never waits."""

    def settle(self, limit: float) -> None:
        """Wait for the answers to what was sent last, at most for a time in s."""

    def age(self) -> Array:
        """Seconds since ``plate`` and ``motor`` were sampled, shape (1, 2)."""

    def home(self, plate: Array, motor: Array) -> None:
        """Declare the present angles in rad, shape (1, 2) each."""

    @property
    def enabled(self) -> bool:
        """Whether both axes follow their commands."""

    @property
    def round_trip(self) -> float | None:
        """Seconds from the last command to the last answer; None while one is missing."""


class ListeningScreen(TouchScreen, FaultSource, Protocol):
    """A touch screen that is read in a thread of its own."""

    def start(self) -> None:
        """Open the port and begin to read it."""

    def stop(self) -> None:
        """Close it; harmless if closed already."""

    def note_plate(self, plate: Array) -> None:
        """Take in the measured plate angles (phi, theta), rad, shape (1, 2)."""
