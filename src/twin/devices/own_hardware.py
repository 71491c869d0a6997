"""What a class has that is hardware of one's own: servos, a screen, or both behind the seam.

``ballplate.hardware`` is the public place of these classes.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from typing import NamedTuple, Self


class Reading(NamedTuple):
    """The newest measurement of own hardware.

    Attributes:
        x: Ball along the longer side in m, from the middle of the plate; NaN where it is not seen.
        y: The same along the shorter side.
        at: When that arrived, s of ``Hardware.time``, so never ahead of it.
        phi: Measured plate angle in rad, positive where it lets the ball roll to larger x; None
            where there is no encoder.
        theta: The same; positive where it lets the ball roll to smaller y.
    """

    x: float
    y: float
    at: float
    phi: float | None = None
    theta: float | None = None

    @classmethod
    def of_plate(cls, phi: float, theta: float, at: float) -> Self:
        """Measurement of servos without a screen: plate angles in rad, and when they arrived, s."""
        return cls(math.nan, math.nan, at, phi, theta)


class OwnDevice(ABC):
    """Common base of own servos and screens."""

    @abstractmethod
    def start(self) -> None:
        """Connect; may wait. Servos bring the plate level, with torque."""

    @abstractmethod
    def stop(self) -> None:
        """Disconnect; also called after any error. Servos stand still, then have no torque."""

    @abstractmethod
    def measure(self) -> Reading:
        """The newest measurement, or the previous one if there is none; must not wait."""

    def time(self) -> float:
        """Monotonic time in s."""
        return time.monotonic()

    def faults(self) -> tuple[str, ...]:
        """What the hardware reports of itself, in words; anything ends the run."""
        return ()


class ScreenHardware(OwnDevice):
    """A screen or camera of one's own: derive from it, and write ``start``, ``measure``, ``stop``.

    The loop calls ``measure`` once per control period from one thread. What is raised in it levels
    the plate; the servos are other devices, and continue.
    """


class ServoHardware(OwnDevice):
    """Servos of one's own: derive from it, and write ``start``, ``command``, ``stop``.

    The loop calls ``measure`` and ``command`` once per control period from one thread; neither may
    wait. What is raised in any of them stops the rig. ``measure`` is for a plate with encoders:
    ``Reading.of_plate(phi, theta, self.time())``.
    """

    watchdog = False
    """Whether the board itself holds the plate still when it hears nothing for a while."""

    def measure(self) -> Reading:
        """No encoder: nothing is measured."""
        return Reading(math.nan, math.nan, self.time())

    @abstractmethod
    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Move the plate until the next command.

        Args:
            rates: Plate rates (phi', theta') in rad/s, for drives that hold a speed.
            angles: Plate angles (phi, theta) in rad at the end of the period, for servos that go to
                a position. The rates add up to them.
        """

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        time.sleep(seconds)


class Hardware(ServoHardware, ScreenHardware):
    """A rig of one's own: derive from it, and write ``start``, ``measure``, ``command``, ``stop``.

    The loop calls ``measure`` and ``command`` once per control period from one thread; neither may
    wait. What is raised in any of them stops the rig.
    """

    @abstractmethod
    def measure(self) -> Reading:
        """The newest measurement, the one before again if there is none."""
