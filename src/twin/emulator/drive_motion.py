"""The motion of an emulated motor: ramps with power, running out without."""

from __future__ import annotations

import math

from twin.emulator.drive_settings import DriveSettings

TURN = 2 * math.pi


def int32(counts: int) -> int:
    """Counts as a 32-bit counter shows them, wrapped."""
    return (counts + (1 << 31)) % (1 << 32) - (1 << 31)


class Motor:
    """Shaft and encoders of a drive.

    Args:
        settings: Encoders and how it runs out.
    """

    def __init__(self, settings: DriveSettings) -> None:
        self.rate = 0.0
        """Shaft rate in rad/s."""
        self.limited = False
        """Whether the velocity limit cut the target."""
        self.frozen = False
        self.frozen_plate = False
        self._settings = settings
        self._angle = self._plate = 0.0
        self._sensed = False
        self._offset = settings.start_counts
        self._plate_offset = settings.plate_start_counts
        self._shown = self._plate_shown = 0
        self._look()

    @property
    def position(self) -> int:
        """Motor counter."""
        return int32(self._shown + self._offset)

    @property
    def plate(self) -> int:
        """Second counter."""
        return int32(self._plate_shown + self._plate_offset)

    def jump(self, counts: int) -> None:
        """Let the motor counter jump."""
        self._offset += counts

    def jump_plate(self, counts: int) -> None:
        """Let the second counter jump."""
        self._plate_offset += counts

    def sense(self, motor: float, plate: float) -> None:
        """Where shaft and plate are, rad; from now on nothing is integrated here."""
        self._sensed = True
        self._angle, self._plate = motor, plate
        self._look()

    def follow(
        self, target: float, ramps: tuple[float, float], limits: MotionLimits, dt: float
    ) -> None:
        """Ramp towards a target in rad/s with (acceleration, deceleration) in rad/s^2."""
        clipped = max(limits[0], min(limits[1], target))
        self.limited = clipped != target
        faster = abs(clipped) > abs(self.rate) and clipped * self.rate >= 0
        step = ramps[0 if faster else 1] * dt
        self._go(self.rate + max(-step, min(step, clipped - self.rate)), dt)

    def coast(self, dt: float) -> None:
        """Run out without torque."""
        self.limited = False
        rate = self.rate * math.exp(-dt / self._settings.coasting)
        self._go(rate if abs(rate) > 1e-4 else 0.0, dt)

    def _go(self, rate: float, dt: float) -> None:
        if not self._sensed:
            self._angle += (self.rate + rate) / 2 * dt
            self._plate = self._settings.plate_per_motor * self._angle
        self.rate = rate
        self._look()

    def _look(self) -> None:
        settings = self._settings
        if not self.frozen:
            self._shown = math.floor(self._angle / TURN * settings.motor_counts)
        if not self.frozen_plate:
            self._plate_shown = math.floor(self._plate / TURN * settings.plate_counts)


MotionLimits = tuple[float, float]
"""Lowest and highest rate in rad/s."""
