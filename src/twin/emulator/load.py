"""Loads of an emulated drive: an inertia with friction of its own, or the shaft of a plant.

Angles in rad, rates in rad/s, torques in N m, at the motor shaft.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class LoadGains:
    """Gains of the drive's controllers: of the angle, and of the rate with its integral.

    Attributes:
        angle: 1/s.
        rate: 1/s, acceleration per rate error.
        integral: 1/s^2.
    """

    angle: float = 40.0
    rate: float = 300.0
    integral: float = 5000.0


@dataclass(frozen=True)
class Inertia:
    """A rotor with its load.

    Attributes:
        inertia: kg m^2.
        coulomb: Coulomb friction in N m, which also holds the shaft at rest.
        viscous: Viscous friction in N m s.
    """

    inertia: float = 1e-3
    coulomb: float = 0.05
    viscous: float = 1e-4


class InertiaLoad:
    """J rate' = torque + external - coulomb sign(rate) - viscous rate.

    Args:
        gains: Of the drive's controllers.
    """

    def __init__(self, gains: LoadGains | None = None) -> None:
        self.body = Inertia()
        """What turns."""
        self.angle = self.rate = self.torque = 0.0
        self.external = 0.0
        """Torque in N m that somebody else exerts on the shaft."""
        self.jammed = False
        """Whether the shaft is held fast."""
        self._gains = gains or LoadGains()
        self._integral = 0.0

    def drive(
        self, angle: float | None, rate: float, acceleration: float, most: float, dt: float
    ) -> None:
        """Control the shaft for dt s: a cascade with feed-forward.

        Args:
            angle: Demanded angle in rad after dt, None where only the rate is controlled.
            rate: Demanded rate in rad/s.
            acceleration: Demanded acceleration in rad/s^2.
            most: Largest torque in N m.
            dt: Time in s.
        """
        gains, inertia = self._gains, self.body.inertia
        lag = 0.0 if angle is None else angle - rate * dt - self.angle
        error = rate + gains.angle * lag - self.rate
        integral = self._integral + gains.integral * error * dt
        wanted = inertia * (acceleration + gains.rate * error + integral)
        self.torque = max(-most, min(most, wanted))
        if wanted == self.torque:  # a limited torque winds nothing up
            self._integral = integral
        self._turn(dt)

    def coast(self, dt: float) -> None:
        """Run out without torque for dt s."""
        self.torque = self._integral = 0.0
        self._turn(dt)

    def _turn(self, dt: float) -> None:
        body, before = self.body, self.rate
        driving = self.torque + self.external - body.viscous * before
        free = before + driving / body.inertia * dt
        friction = body.coulomb / body.inertia * dt
        # friction stops a shaft, and never turns it
        self.rate = math.copysign(max(0.0, abs(free) - friction), free)
        if self.rate * before < 0:
            self.rate = 0.0
        if self.jammed:
            self.rate = 0.0
        self.angle += (before + self.rate) / 2 * dt if not self.jammed else 0.0


class ShaftLoad:
    """The shaft of a plant, which follows rates and reports angles.

    Args:
        gain: Of the drive's controller of the angle, 1/s.
        run_out: Time constant in s with which it runs out without torque.
    """

    def __init__(self, gain: float = LoadGains.angle, run_out: float = 0.2) -> None:
        self.angle = self.rate = self.torque = 0.0
        self.forced = 0.0
        """Rate in rad/s that somebody gives the shaft in addition."""
        self._gain, self._run_out = gain, run_out

    def sense(self, motor: float, plate: float) -> None:
        """Take the angle of the shaft in rad; the plate has no encoder here."""
        del plate
        self.angle = motor

    def drive(
        self, angle: float | None, rate: float, acceleration: float, most: float, dt: float
    ) -> None:
        """Demand a rate of the plant for dt s.

        Args:
            angle: Demanded angle in rad after dt, None where only the rate is controlled.
            rate: Demanded rate in rad/s.
            acceleration: Not needed.
            most: Not needed.
            dt: Time in s.
        """
        del acceleration, most
        lag = 0.0 if angle is None else angle - rate * dt - self.angle
        self.rate = rate + self._gain * lag

    def coast(self, dt: float) -> None:
        """Run out without torque for dt s."""
        self.rate *= math.exp(-dt / self._run_out)
