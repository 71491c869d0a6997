"""Two servo axes with AKD drives on CAN, as a rig needs them."""

from __future__ import annotations

import time
from collections.abc import Callable

import can
import numpy as np

from controllers.arrays import Array
from twin.devices.akd import conditions as c
from twin.devices.akd.bus import open_bus
from twin.devices.akd.cia402 import Wish
from twin.devices.akd.config import AkdConfig, BusConfig
from twin.devices.akd.cycling import Cycling
from twin.devices.akd.encoders import DriveEncoders
from twin.devices.akd.errors import DriveError
from twin.devices.akd.seam import PlateEncoders
from twin.hal.faults import Fault


class AkdServos(Cycling):
    """Two AKD drives; a `PoweredServos`.

    Between ``start`` and ``stop``, ``receive`` and ``send`` are called once a period, or the
    drives stop themselves: they watch the host's heartbeat.

    Args:
        config: Bus, axes and thresholds.
        plate: Plate encoders; None for those wired to the drives.
        opener: Opens the bus.
        now: Monotonic time in s.
        sleep: Waits for seconds; used by ``stop`` only.
    """

    def __init__(
        self,
        config: AkdConfig,
        *,
        plate: PlateEncoders | None = None,
        opener: Callable[[BusConfig], can.BusABC] = open_bus,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__(config, with_plate=plate is None, opener=opener, now=now, sleep=sleep)
        self._plate: PlateEncoders = plate or DriveEncoders(lambda: self.axes, now)
        self._motor_zero = np.zeros((1, 2))

    def command(self, motor_rate: Array) -> None:
        """Motor rates in rad/s at the cam shafts, shape (1, 2), until the next command.

        They are kept within the rate limit; what is not finite becomes zero and a fault.
        """
        limit = self.config.rate_limit
        for axis, rate in zip(self.axes, np.asarray(motor_rate).reshape(2).tolist(), strict=True):
            axis.target = max(-limit, min(limit, rate))
            if not np.isfinite(rate):
                axis.target = 0.0
                detail = f"{rate} rad/s"
                self._reports.report(c.BAD_COMMAND, axis.config.where, detail, self.now())

    def enable(self) -> None:
        """Ask for torque at zero rate, one state a cycle; ``enabled`` tells when it is there.

        Raises:
            DriveError: If a fault stands that forbids it; it must be reset first.
        """
        standing = [f for f in self._reports.standing if f.condition.severity == "stop"]
        if standing or not self._up:
            if not standing:
                raise DriveError(c.ADAPTER_GONE, f"CAN {self.config.bus}", "not started")
            fault = standing[0]
            detail = f"{fault.condition.name} stands ({fault.detail}); reset the faults first"
            raise DriveError(fault.condition, fault.where, detail)
        for axis in self.axes:
            axis.target = 0.0
            axis.wish = Wish.ON

    def reset_faults(self) -> None:
        """Ask, explicitly, for the reset of all faults; never enables.

        What persists is reported again; where ``needs_restart`` is set, only ``stop`` and
        ``start`` help, and nothing is reset.
        """
        if self.needs_restart or not self._up:
            return
        at = self.now()
        self._reports.reset()
        self._lookout.forget()
        for guard in self._guards:
            guard.ask_reset(at)

    @property
    def enabled(self) -> bool:
        """Whether both drives follow their commands."""
        return self._up and all(axis.enabled for axis in self.axes)

    @property
    def needs_restart(self) -> bool:
        """Whether a fault stands that only ``stop`` and ``start`` can clear."""
        return self._reports.needs_restart

    def plate(self) -> Array:
        """Newest plate angles (phi, theta) in rad, shape (1, 2)."""
        return self._plate.plate()

    def motor(self) -> Array:
        """Newest motor angles at the cam shafts in rad, shape (1, 2)."""
        return self._motor_angles() - self._motor_zero

    def rate(self) -> Array:
        """Measured motor rates at the cam shafts in rad/s, shape (1, 2)."""
        return np.array([[axis.rate for axis in self.axes]])

    def age(self) -> Array:
        """Seconds since the older of plate and motor angle was sampled, shape (1, 2)."""
        motor = self.now() - np.array([[axis.sampled for axis in self.axes]])
        return np.asarray(np.maximum(motor, self._plate.age()))

    def home(self, plate: Array, motor: Array) -> None:
        """Declare the present angles in rad, shape (1, 2) each: the encoders are incremental."""
        self._plate.home(plate)
        self._motor_zero = self._motor_angles() - motor

    def faults(self) -> tuple[Fault, ...]:
        """What has been detected since the last call, oldest first; never waits."""
        return self._reports.take() + self._plate.faults()

    def _motor_angles(self) -> Array:
        return np.array([[axis.motor.scale.value(axis.motor.counts) for axis in self.axes]])
