"""What a rig needs of servos that have power: the same for CAN and for analogue drives.

A backend for analogue drives (+-10 V velocity commands, plate encoders on a counter card) is one
file with one class that follows `PoweredServos`: `start` opens the card, `enable` closes the
drives' enable contact, `send` writes the voltages, `receive` reads the counters, `quick_stop`
writes zero and opens the contact, and `faults` reports what the card can see. Nothing else in the
twin knows how the servos are reached.
"""

from __future__ import annotations

from typing import Protocol

from controllers.arrays import Array
from twin.hal.faults import Fault, Watched
from twin.hal.interface import Servos


class PlateEncoders(Protocol):
    """The plate's own encoders, wherever they are wired; ordered (phi, theta)."""

    def plate(self) -> Array:
        """Newest plate angles in rad, shape (1, 2); never waits."""

    def age(self) -> Array:
        """Seconds since they were sampled, shape (1, 2)."""

    def home(self, plate: Array) -> None:
        """Declare the plate's present angles in rad, shape (1, 2)."""

    def faults(self) -> tuple[Fault, ...]:
        """What has been detected since the last call."""


class PoweredServos(Servos, Watched, Protocol):
    """Two servo axes with power, commanded once a period.

    Within a period: ``receive``, then ``plate`` and ``motor``, then ``command``, then ``send``.
    """

    def start(self) -> None:
        """Connect, check and configure; no torque yet; may block."""

    def stop(self) -> None:
        """Zero, stop, disable, disconnect; may block; idempotent, never raises."""

    def enable(self) -> None:
        """Ask for torque with zero rate; ``enabled`` tells when it is there."""

    def quick_stop(self) -> None:
        """Ask for the fastest stop, then no torque."""

    def reset_faults(self) -> None:
        """Ask, explicitly, that faults be reset; never enables."""

    def receive(self) -> None:
        """Take in what has arrived; never waits."""

    def send(self) -> None:
        """Send the commands; never waits."""

    def age(self) -> Array:
        """Seconds since ``plate`` and ``motor`` were sampled, shape (1, 2)."""

    def home(self, plate: Array, motor: Array) -> None:
        """Declare the present angles in rad, shape (1, 2) each."""

    @property
    def enabled(self) -> bool:
        """Whether both axes follow their commands."""
