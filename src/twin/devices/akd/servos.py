"""Two servo axes with AKD drives on CAN, as a rig needs them: brought up, then cycle by cycle."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import can
import numpy as np

from controllers.arrays import Array
from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.axis import Axis
from twin.devices.akd.bringup import SettingsFound, bring_up, master_frames, monitoring
from twin.devices.akd.bus import BUS_ERRORS, CanTransport, open_bus
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import SHUTDOWN_STEP_LIMIT_S, AkdConfig, BusConfig
from twin.devices.akd.protocol import AxisRequest, DriveState, abort_words
from twin.devices.common import FaultReports
from twin.hal.interface import Fault

_MONITORED_HEARTBEAT = (0x1016, 1)
_FAULT_NUMBER = (0x2001, 1)
_STO_FAULT = 602
_FAULT_CONDITIONS = (c.DRIVE_FAULT, c.DRIVE_DISABLED, c.RESET_REFUSED)
"""Conditions after which a drive's fault number is read."""


class SdoPolling:
    """Polls the drives' monitoring of the host, and reads the fault number of one that is down.

    Args:
        config: Axes and thresholds.
        reports: Where faults are reported.
        at: Time now in s.
    """

    def __init__(self, config: AkdConfig, reports: FaultReports, at: float) -> None:
        self._config = config
        self._where = {axis.node: axis.where for axis in config.axes}
        self._reports = reports
        self._queue: deque[tuple[int, int, int]] = deque()
        """Node, index and subindex of what is to be read, one after the other."""
        self._pending: tuple[int, int, int] | None = None
        """What is being read."""
        self._sent = self._polled = at
        self._turn = 0
        self._number_read: set[int] = set()

    def next_frame(self, at: float) -> tuple[int, bytes] | None:
        """The frame to send at a time in s, identifier and data, if any."""
        for node, where in self._where.items():
            down = any(self._reports.latched(each, where) for each in _FAULT_CONDITIONS)
            if down and node not in self._number_read:
                self._number_read.add(node)
                self._queue.append((node, *_FAULT_NUMBER))
        if self._pending is not None and at - self._sent > self._config.watch.answer:
            node, *key = self._pending
            self._reports.report(c.SDO_TIMEOUT, self._where[node], _reading(*key), at)
            self._pending = None
        idle = self._pending is None and not self._queue
        if idle and at - self._polled > self._config.watch.enquiry:
            self._polled = at
            self._turn = 1 - self._turn
            self._queue.append((self._config.axes[self._turn].node, *_MONITORED_HEARTBEAT))
        if self._pending is not None or not self._queue:
            return None
        self._pending, self._sent = self._queue.popleft(), at
        node, *key = self._pending
        return protocol.SDO_REQUEST + node, protocol.encode_sdo_read(*key)

    def receive(self, node: int, data: bytes, at: float) -> None:
        """Take in what a drive answers, any bytes; what nobody has asked for is left out."""
        answer = protocol.decode_sdo(data)
        if self._pending is None or self._pending[0] != node or (answer and not answer.data):
            return
        (_, *asked), self._pending, where = self._pending, None, self._where[node]
        wrong = protocol.answers_otherwise((asked[0], asked[1]), answer)
        if answer is None or wrong:
            self._reports.report(c.SDO_WRONG, where, f"{_reading(*asked)}: {wrong}", at)
        elif answer.aborted:
            detail = f"{_reading(*answer.key)}: {abort_words(answer.value)}"
            self._reports.report(c.SDO_ABORT, where, detail, at)
        elif answer.key == _FAULT_NUMBER:
            if answer.value == _STO_FAULT:
                self._reports.report(c.STO_OPEN, where, "F602", at)
            elif answer.value:
                words = protocol.fault_words([answer.value])
                self._reports.report(c.FAULT_NUMBER, where, words, at)
        elif answer.value != monitoring(self._config):
            detail = f"1016h:1 holds {answer.value:08X}h: it would go on without the host"
            self._reports.report(c.MONITORING_OFF, where, detail, at)


def _reading(index: int, sub: int) -> str:
    return f"reading {index:04X}h:{sub}"


_MAX_STANDSTILL_RATE_RAD_S = 0.05
"""Motor rate in rad/s that counts as standstill."""


class AkdServos:
    """Two AKD drives.

    Between ``start`` and ``stop``, ``receive`` and ``send`` are called once per period, or the
    drives stop themselves: they monitor the host's heartbeat.

    Args:
        config: Bus, axes and thresholds.
        opener: Opens the bus.
        now: Monotonic time in s.
        sleep: Waits for seconds; used by ``stop`` only.
    """

    encoders = True
    """The drives read the encoders of the plate."""

    def __init__(
        self,
        config: AkdConfig,
        *,
        opener: Callable[[BusConfig], can.BusABC] = open_bus,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.config = config
        self.axes: tuple[Axis, ...] = ()
        """The axes phi and theta, since ``start``."""
        self.found: tuple[SettingsFound, ...] = ()
        """What phi's and theta's drive were found to be at the last start."""
        self.heartbeat = True
        """Whether the host sends its heartbeat; off only to test that the drives then stop."""
        self.round_trip: float | None = None
        """Seconds from the last command to the last answer; None while one is missing."""
        self.now, self.sleep = now, sleep
        self._where = f"CAN {config.bus}"
        self._motor_zero, self._plate_zero = np.zeros((1, 2)), np.zeros((1, 2))
        self._opener = opener
        self._master_frames = master_frames(config)
        self._transport: CanTransport | None = None
        """The bus, between ``start`` and ``stop``."""
        self._reports = FaultReports(config.watch.repeat)

    def start(self, *, reset: bool = False) -> None:
        """Open the bus and take both drives to operational, monitored and without torque.

        Blocks for some tenths of a second, and for as long as the adapter takes to open.

        Args:
            reset: Whether the drives' faults are then reset, as a person requests; what persists is
                reported.

        Raises:
            DriveError: If anything is not as it should be; the bus is closed again then.
        """
        self.stop()
        config = self.config
        self._reports = FaultReports(config.watch.repeat)
        bus = self._opener(config.bus)
        transport = CanTransport(bus, self._where, self._reports, self.now)
        try:
            self.found = bring_up(bus, config, now=self.now)
        except BaseException as error:
            transport.close()
            if isinstance(error, BUS_ERRORS) and not isinstance(error, DriveError):
                raise DriveError(c.ADAPTER_GONE, self._where, str(error)) from error
            raise
        transport.send_heartbeat(config.host)
        at = self.now()
        self.axes = tuple(Axis(axis, config, self._reports, at=at) for axis in config.axes)
        for axis, found in zip(self.axes, self.found, strict=True):
            axis.found_faults = found.faults
        self._polling = SdoPolling(config, self._reports, at)
        self._cycle, self._synced, self._beat = 0, at, at
        self.round_trip, self.heartbeat = None, True
        if reset:
            for axis in self.axes:
                axis.reset(at)
        self._transport = transport

    def stop(self) -> None:
        """Target zero, quick stop, disable, and only then no more SYNC; close the bus.

        A drive that was not seen to be without torque still monitors the host's heartbeat, which
        ends here: it stops itself. Blocks for about a second at most; idempotent; never raises.
        """
        transport, axes, period = self._transport, self.axes, self.config.period
        if transport is None:
            return
        cycles = round(SHUTDOWN_STEP_LIMIT_S / period)

        def run_until(done: Callable[[], bool], most: int = cycles) -> None:
            for _ in range(most):
                if not transport.up or done():
                    return
                self.receive()
                self.send()
                self.sleep(period)

        for axis in axes:
            axis.target = 0.0
        run_until(lambda: all(abs(axis.rate) < _MAX_STANDSTILL_RATE_RAD_S for axis in axes))
        self.quick_stop()
        run_until(lambda: all(axis.request is not AxisRequest.QUICK_STOP for axis in axes))
        run_until(lambda: all(axis.state is DriveState.SWITCH_ON_DISABLED for axis in axes), 5)
        for axis in axes:
            node = axis.config.node
            if axis.powerless and axis.motor.pdo.missed < self.config.watch.stale:
                monitoring_off = protocol.encode_sdo_write(0x1016, 1, bytes(4))
                transport.send(protocol.SDO_REQUEST + node, monitoring_off)
            transport.send(protocol.NMT, bytes((protocol.PRE_OPERATIONAL, node)))
        self.sleep(self.config.heartbeat)
        transport.close()
        self._transport = None

    def receive(self) -> None:
        """Take in everything that has arrived; never waits."""
        self._drain(0.0)

    def settle(self, limit: float) -> None:
        """Wait for the answers to the last SYNC, at most for a time in s; for idle time only.

        Without it frames are noticed at the next ``receive``, and ``round_trip`` counts to there.
        """
        deadline = self.now() + limit
        while self.round_trip is None and (left := deadline - self.now()) > 0 and self._up:
            self._drain(left)

    def send(self) -> None:
        """Judge the cycle that ends, then send the commands and the next SYNC; never waits."""
        transport = self._transport
        if transport is None:
            return
        self._drain(0.0)
        at = self.now()
        if self._cycle:
            for axis in self.axes:
                axis.cycle(at, self._synced)
        if self._reports.stopping:
            self.quick_stop()
        for axis in self.axes:
            axis.finish_quick_stop()
            transport.send(protocol.RPDO1 + axis.config.node, axis.next_rpdo1())
        self._cycle += 1
        self.round_trip = None
        self._synced = self.now()
        transport.send(protocol.SYNC, b"")
        self._send_heartbeat(transport, at)
        request = self._polling.next_frame(at)
        if request is not None:
            transport.send(*request)
        transport.send_queued()

    def quick_stop(self) -> None:
        """Request target zero and quick stop, then no torque."""
        for axis in self.axes:
            axis.target = 0.0
            if axis.request is AxisRequest.ENABLE:
                axis.request = AxisRequest.QUICK_STOP

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
        if self._reports.stopping:
            fault = self._reports.stopping[0]
            detail = f"{fault.condition.name} stands ({fault.detail}); reset the faults first"
            raise DriveError(fault.condition, fault.where, detail)
        if not self._up:
            raise DriveError(c.ADAPTER_GONE, self._where, "not started")
        for axis in self.axes:
            axis.target = 0.0
            axis.request = AxisRequest.ENABLE

    @property
    def lost(self) -> float:
        """Plate angle in rad that may be lost between motor and plate."""
        return self.config.lost

    @property
    def late(self) -> float:
        """Longest time in s from a command to the motion of the plate."""
        return self.config.late

    @property
    def enabled(self) -> bool:
        """Whether both drives follow their commands."""
        return self._up and all(axis.enabled for axis in self.axes)

    def plate(self) -> Array:
        """Newest plate angles (phi, theta) in rad, shape (1, 2)."""
        return self._plate_angles() - self._plate_zero

    def motor(self) -> Array:
        """Newest motor angles at the cam shafts in rad, shape (1, 2)."""
        return self._motor_angles() - self._motor_zero

    def turned(self) -> tuple[Array, Array] | None:
        """Plate and motor angles in rad, shape (2,) each, that one SYNC sampled; else None."""
        counters = [each for axis in self.axes for each in (axis.plate, axis.motor)]
        if len({each.sampled for each in counters}) != 1:
            return None
        return self.plate()[0], self.motor()[0]

    def age(self) -> Array:
        """Seconds since the older of plate and motor angle was sampled, shape (1, 2)."""
        oldest = [min(axis.motor.sampled, axis.plate.sampled) for axis in self.axes]
        return self.now() - np.array([oldest])

    def home(self, plate: Array, motor: Array) -> None:
        """Declare the present angles in rad, shape (1, 2) each: the encoders are incremental."""
        self._plate_zero = self._plate_angles() - plate
        self._motor_zero = self._motor_angles() - motor

    def warnings(self) -> tuple[Fault, ...]:
        """What every run is to be warned of, from its start: nothing."""
        return ()

    def faults(self) -> tuple[Fault, ...]:
        """Faults detected since the last call, oldest first; never waits."""
        return self._reports.take()

    @property
    def _up(self) -> bool:
        return self._transport is not None and self._transport.up

    def _motor_angles(self) -> Array:
        return np.array([[axis.motor.angle for axis in self.axes]])

    def _plate_angles(self) -> Array:
        return np.array([[axis.plate.angle for axis in self.axes]])

    def _send_heartbeat(self, transport: CanTransport, at: float) -> None:
        """Send the host's heartbeat when it is due, unless a drive ignores a quick stop."""
        due = at - self._beat >= self.config.heartbeat - self.config.period / 2
        if self.heartbeat and due:
            self._beat = at
            if not any(axis.stop_ignored for axis in self.axes):
                transport.send_heartbeat(self.config.host)

    def _drain(self, wait: float) -> None:
        if self._transport is None:
            return
        for identifier, data in self._transport.receive(wait):
            at = self.now()
            node = identifier & protocol.NODE_MASK
            service = identifier - node
            sender = next((axis for axis in self.axes if axis.config.node == node), None)
            if identifier in self._master_frames:
                detail = f"sends {self._master_frames[identifier]}"
                self._reports.report(c.SECOND_MASTER, self._where, detail, at)
                continue
            if sender is None:
                continue
            sender.receive(service, data, self._cycle, self._synced, at)
            if service == protocol.SDO_RESPONSE:
                self._polling.receive(node, data, at)
            elif self.round_trip is None and all(
                counter.pdo.cycle == self._cycle
                for axis in self.axes
                for counter in (axis.motor, axis.plate)
            ):
                self.round_trip = at - self._synced
