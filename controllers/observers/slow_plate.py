"""Plate angle and rate for feedback: what was commanded, drawn slowly to what is measured."""

from __future__ import annotations

from controllers.arrays import Array


class SlowPlate:
    """Angle and rate of N plates from the commanded rate, with a bias learnt from the encoders.

    phi' = w + b with the commanded rate w, both corrected by the measured angle with two equal
    poles. The measured rate would feed the resonance of plate and spring (13 and 19 Hz) back; the
    commanded one alone drifts, as disturbances of the motors add up.

    Args:
        pole: Both poles of the error, as a rate in 1/s.
        period: Control period in s.
        x: States to begin with, shape (N, 8).
    """

    def __init__(self, pole: float, period: float, x: Array) -> None:
        self.angle: Array = x[:, 2::4].copy()
        self.commanded: Array = x[:, 3::4].copy()
        """Plate rates commanded last, rad/s, shape (N, 2)."""
        self._bias: Array = 0 * self.angle
        self._period = period
        self._gain = 2 * pole * period, pole * pole * period

    def correct(self, measured: Array) -> tuple[Array, Array]:
        """Angles in rad and rates in rad/s, shape (N, 2), once the angles have been measured."""
        error = measured - self.angle
        self.angle = self.angle + self._gain[0] * error
        self._bias = self._bias + self._gain[1] * error
        return self.angle, self.commanded + self._bias

    def predict(self, u: Array) -> None:
        """One period under the applied accelerations in rad/s^2, shape (N, 2)."""
        before = self.commanded
        self.commanded = before + self._period * u
        self.angle = self.angle + self._period * (before + self.commanded) / 2
        self.angle += self._period * self._bias
