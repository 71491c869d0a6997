"""Two servo axes with AKD drives on CAN, as a rig needs them."""

from __future__ import annotations

import time
from collections.abc import Callable

import can
import numpy as np

from controllers.arrays import Array
from twin.devices.akd import conditions as c
from twin.devices.akd.axis import Axis, DriveEncoders
from twin.devices.akd.bringup import SettingsFound, bring_up
from twin.devices.akd.bus import open_bus
from twin.devices.akd.cia402 import AxisRequest
from twin.devices.akd.conditions import DriveError, FaultReports
from twin.devices.akd.config import AkdConfig, BusConfig
from twin.devices.akd.exchange import CyclicExchange, SyncCycles
from twin.devices.akd.network import BUS_ERRORS
from twin.devices.akd.transport import CanTransport
from twin.devices.interface import PlateEncoders
from twin.hal.faults import Fault, Severity


class AkdServos:
    """Two AKD drives; a `PoweredServos`.

    Between ``start`` and ``stop``, ``receive`` and ``send`` are called once per period, or the
    drives stop themselves: they monitor the host's heartbeat.

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
        self.config = config
        self.axes: tuple[Axis, ...] = ()
        """phi and theta, since ``start``."""
        self.stale = 0
        """Cycles in which an older position than that of the last SYNC had to be used."""
        self.found: tuple[SettingsFound, ...] = ()
        """What phi's and theta's drive were found to be at the last start."""
        self.now, self.sleep = now, sleep
        self._through_drives = plate is None
        self._plate: PlateEncoders = plate or DriveEncoders(lambda: self.axes, now)
        self._motor_zero = np.zeros((1, 2))
        self._opener = opener
        self._reports = FaultReports(config.watch.repeat)
        self._exchange: CyclicExchange | None = None

    def start(self) -> None:
        """Open the bus and take both drives to operational, monitored and without torque.

        Blocks for some tenths of a second, and for as long as the adapter takes to open.

        Raises:
            DriveError: If anything is not as it should be; the bus is closed again then.
        """
        self.stop()
        config, where = self.config, f"CAN {self.config.bus}"
        self._reports = FaultReports(config.watch.repeat)
        bus = self._opener(config.bus)
        transport = CanTransport(bus, where, self._reports, self.now)
        try:
            self.found = bring_up(bus, config, with_plate=self._through_drives, now=self.now)
        except BaseException as error:
            transport.close()
            if isinstance(error, BUS_ERRORS) and not isinstance(error, DriveError):
                raise DriveError(c.ADAPTER_GONE, where, str(error)) from error
            raise
        transport.send_heartbeat(config.host)
        at = self.now()
        phi, theta = (
            Axis(axis, config, with_plate=self._through_drives, at=at) for axis in config.axes
        )
        self.axes, self.stale = (phi, theta), 0
        for axis, found in zip(self.axes, self.found, strict=True):
            axis.found_faults = found.faults
        self._exchange = CyclicExchange(config, (phi, theta), transport, self._reports, self.now)

    def stop(self) -> None:
        """Target zero, quick stop, disable, and only then no more SYNC; close the bus.

        Blocks for about a second at most; idempotent; never raises.
        """
        if self._exchange is not None:
            self._exchange.shut_down(self.sleep)
            self._exchange = None

    def receive(self) -> None:
        """Take in everything that has arrived; never waits."""
        if self._exchange is not None:
            self.stale += not self._exchange.receive()

    def settle(self, limit: float) -> None:
        """Wait for the answers to what was sent last, at most for a time in s."""
        if self._exchange is not None:
            self._exchange.settle(limit)

    def send(self) -> None:
        """Send the commands and the next SYNC; never waits."""
        if self._exchange is not None:
            self._exchange.send()

    def exchange(self) -> None:
        """``receive`` and ``send``, where nothing is computed between them."""
        self.receive()
        self.send()

    def quick_stop(self) -> None:
        """Request target zero and quick stop, then no torque."""
        if self._exchange is not None:
            self._exchange.quick_stop()

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
        """Request torque at zero rate, one state per cycle; ``enabled`` tells when it is there.

        Raises:
            DriveError: If a fault stands that forbids it; it must be reset first.
        """
        standing = [f for f in self._reports.standing if f.condition.severity is Severity.STOP]
        if standing:
            fault = standing[0]
            detail = f"{fault.condition.name} stands ({fault.detail}); reset the faults first"
            raise DriveError(fault.condition, fault.where, detail)
        if not self._up:
            raise DriveError(c.ADAPTER_GONE, f"CAN {self.config.bus}", "not started")
        for axis in self.axes:
            axis.target = 0.0
            axis.request = AxisRequest.ENABLE

    def reset_faults(self) -> None:
        """Request, explicitly, the reset of all faults; never enables.

        What persists is reported again; where ``needs_restart`` is set, only ``stop`` and
        ``start`` help, and nothing is reset.
        """
        if self._exchange is not None and self._up and not self.needs_restart:
            self._reports.reset()
            self._exchange.request_reset()

    @property
    def enabled(self) -> bool:
        """Whether both drives follow their commands."""
        return self._up and all(axis.enabled for axis in self.axes)

    @property
    def needs_restart(self) -> bool:
        """Whether a fault stands that only ``stop`` and ``start`` can clear."""
        return self._reports.needs_restart

    @property
    def heartbeat(self) -> bool:
        """Whether the host sends its heartbeat; set it to False only to test that drives stop."""
        return self._exchange is not None and self._exchange.heartbeat

    @heartbeat.setter
    def heartbeat(self, on: bool) -> None:
        if self._exchange is not None:
            self._exchange.heartbeat = on

    @property
    def cycles(self) -> SyncCycles:
        """SYNCs sent since ``start``, and those that the newest positions answer."""
        return self._exchange.cycles if self._exchange is not None else SyncCycles(0, (0, 0))

    @property
    def round_trip(self) -> float | None:
        """Seconds from the last SYNC to the last of its answers; None while one is missing."""
        return self._exchange.round_trip if self._exchange is not None else None

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
        """Faults detected since the last call, oldest first; never waits."""
        return self._reports.take() + self._plate.faults()

    @property
    def _up(self) -> bool:
        return self._exchange is not None and self._exchange.up

    def _motor_angles(self) -> Array:
        return np.array([[axis.motor.angle for axis in self.axes]])
