"""The cyclic exchange with two drives in operation: PDOs, SYNC and heartbeat, once per period."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from twin.devices.akd import frames
from twin.devices.akd.axis import Axis
from twin.devices.akd.cia402 import AxisRequest, DriveState
from twin.devices.akd.conditions import SECOND_MASTER, FaultReports
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.monitor import AxisMonitor
from twin.devices.akd.sdo_poll import SdoPolling
from twin.devices.akd.second_master import master_frames
from twin.devices.akd.transport import CanTransport

_STANDSTILL = 0.05
"""Motor rate in rad/s that counts as standstill."""
SHUTDOWN = 0.4
"""Longest time in s for each step of the shutdown."""


class SyncCycles(NamedTuple):
    """SYNCs sent since the start, and the ones that the newest positions answer."""

    sent: int
    of_data: tuple[int, int]


class CyclicExchange:
    """Frames of two drives, cycle by cycle, from the end of the bring-up until ``shut_down``.

    ``receive`` and ``send`` are called once per period, or the drives stop themselves: they
    monitor the host's heartbeat.

    Args:
        config: Axes and thresholds.
        axes: phi and theta, as they are after the bring-up.
        transport: The bus.
        reports: Where faults are reported.
        now: Monotonic time in s.
    """

    def __init__(
        self,
        config: AkdConfig,
        axes: tuple[Axis, Axis],
        transport: CanTransport,
        reports: FaultReports,
        now: Callable[[], float],
    ) -> None:
        self.heartbeat = True
        """Whether the host sends its heartbeat; off only to test that the drives then stop."""
        self.round_trip: float | None = None
        """Seconds from the last SYNC to the last of its answers; None while one is missing."""
        self._config = config
        self._axes = axes
        self._transport = transport
        self._reports = reports
        self._now = now
        at = now()
        self._monitors = {axis.config.node: AxisMonitor(axis, config, reports) for axis in axes}
        self._polling = SdoPolling(config, reports, at)
        self._master_frames = master_frames(config)
        self._cycle, self._synced, self._beat = 0, at, at

    @property
    def up(self) -> bool:
        """Whether the adapter works and the bus is open."""
        return self._transport.up

    @property
    def cycles(self) -> SyncCycles:
        """SYNCs sent, and those that the newest positions answer."""
        phi, theta = self._axes
        return SyncCycles(self._cycle, (phi.tpdo1.cycle, theta.tpdo1.cycle))

    def receive(self) -> bool:
        """Take in everything that has arrived; never waits.

        Returns:
            Whether both positions answer the last SYNC.
        """
        self._drain(0.0)
        return all(axis.tpdo1.cycle == self._cycle for axis in self._axes)

    def settle(self, limit: float) -> None:
        """Wait for the answers to the last SYNC, at most for a time in s; for idle time only.

        Without it frames are noticed at the next ``receive``, and ``round_trip`` counts to there.
        """
        deadline = self._now() + limit
        while self.round_trip is None and (left := deadline - self._now()) > 0 and self.up:
            self._drain(left)

    def send(self) -> None:
        """Judge the cycle that ends, then send the commands and the next SYNC; never waits."""
        self._drain(0.0)
        at = self._now()
        if self._cycle:
            for monitor in self._monitors.values():
                monitor.cycle(at)
        if self._reports.stopped:
            self.quick_stop()
        for axis in self._axes:
            axis.finish_quick_stop()
            self._transport.send(frames.RPDO1 + axis.config.node, axis.next_rpdo1())
        self._cycle += 1
        self.round_trip = None
        self._synced = self._now()
        self._transport.send(frames.SYNC, b"")
        self._send_heartbeat(at)
        request = self._polling.next_frame(at)
        if request is not None:
            self._transport.send(*request)
        self._transport.send_queued()

    def quick_stop(self) -> None:
        """Request target zero and quick stop, then no torque."""
        for axis in self._axes:
            axis.target = 0.0
            if axis.request is AxisRequest.ENABLE:
                axis.request = AxisRequest.QUICK_STOP

    def request_reset(self) -> None:
        """Request the reset of every fault in the drives, and forget what was counted."""
        at = self._now()
        self._polling.reset()
        for monitor in self._monitors.values():
            monitor.request_reset(at)

    def shut_down(self, sleep: Callable[[float], None]) -> None:
        """Target zero, quick stop, disable, and only then no more SYNC; close the bus.

        A drive that is not seen to be without torque goes on watching the host, whose heartbeat
        ends here: it stops itself. Blocks for about a second at most; never raises.

        Args:
            sleep: Waits for a number of s.
        """
        axes, period = self._axes, self._config.period
        cycles = round(SHUTDOWN / period)

        def run_until(done: Callable[[], bool], most: int = cycles) -> None:
            for _ in range(most):
                if not self.up or done():
                    return
                self.receive()
                self.send()
                sleep(period)

        for axis in axes:
            axis.target = 0.0
        run_until(lambda: all(abs(axis.rate) < _STANDSTILL for axis in axes))
        self.quick_stop()
        run_until(lambda: all(axis.request is not AxisRequest.QUICK_STOP for axis in axes))
        run_until(lambda: all(axis.state is DriveState.SWITCH_ON_DISABLED for axis in axes), 5)
        for axis in axes:
            node = axis.config.node
            if axis.powerless and axis.tpdo1.missed < self._config.watch.stale:
                monitoring_off = frames.encode_sdo_write(0x1016, 1, 0)
                self._transport.send(frames.SDO_REQUEST + node, monitoring_off)
            self._transport.send(frames.NMT, bytes((frames.PRE_OPERATIONAL, node)))
        sleep(self._config.heartbeat)
        self._transport.close()

    def _send_heartbeat(self, at: float) -> None:
        """Send the host's heartbeat when it is due, unless a drive ignores a quick stop."""
        due = at - self._beat >= self._config.heartbeat - self._config.period / 2
        if self.heartbeat and due:
            self._beat = at
            if not any(monitor.stop_ignored for monitor in self._monitors.values()):
                self._transport.send_heartbeat(self._config.host)

    def _drain(self, wait: float) -> None:
        for identifier, data in self._transport.receive(wait):
            at = self._now()
            node = identifier & frames.NODE_MASK
            service = identifier - node
            monitor = self._monitors.get(node)
            if identifier in self._master_frames:
                detail = f"sends {self._master_frames[identifier]}"
                self._reports.report(SECOND_MASTER, f"CAN {self._config.bus}", detail, at)
                continue
            if monitor is None:
                continue
            monitor.receive(service, data, self._cycle, self._synced, at)
            if service == frames.SDO_RESPONSE:
                self._polling.receive(node, data, at)
            elif self.round_trip is None and all(
                pdo.cycle == self._cycle for axis in self._axes for pdo in (axis.tpdo1, axis.tpdo2)
            ):
                self.round_trip = at - self._synced
