"""The cycle of two AKD drives on CAN: started, exchanged once a period, stopped; never waits."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

import can

from twin.devices.akd import conditions as c
from twin.devices.akd import frames
from twin.devices.akd.axis import Axis, Counter
from twin.devices.akd.bringup import bring_up
from twin.devices.akd.cia402 import State, Wish
from twin.devices.akd.config import AkdConfig, BusConfig
from twin.devices.akd.errors import DriveError
from twin.devices.akd.guard import Guard
from twin.devices.akd.link import Link
from twin.devices.akd.lookout import Lookout
from twin.devices.akd.network import BUS_ERRORS
from twin.devices.akd.reports import Reports

_MONITORING_OFF = struct.pack("<BHBI", 0x23, 0x1016, 1, 0)
_STILL = 0.05
"""Motor rate in rad/s that counts as standstill."""
_SHUTDOWN = 0.4
"""Longest time in s for each step of the shutdown."""


class Cycle(NamedTuple):
    """SYNCs sent since the start, and the ones that the newest positions answer."""

    sent: int
    of_data: tuple[int, int]


class Cycling:
    """Frames of two drives, cycle by cycle.

    Between ``start`` and ``stop``, ``receive`` and ``send`` are called once a period, or the
    drives stop themselves: they watch the host's heartbeat.

    Args:
        config: Bus, axes and thresholds.
        with_plate: Whether the plate encoders are read through the drives.
        opener: Opens the bus.
        now: Monotonic time in s.
        sleep: Waits for seconds; used by ``stop`` only.
    """

    def __init__(
        self,
        config: AkdConfig,
        *,
        with_plate: bool,
        opener: Callable[[BusConfig], can.BusABC],
        now: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self.config = config
        self.axes: tuple[Axis, ...] = ()
        """phi and theta, since ``start``."""
        self.stale = 0
        """Cycles in which an older position than that of the last SYNC had to be used."""
        self.heartbeat = True
        """Whether the host says that it is alive; off only to test that the drives then stop."""
        self.now, self.sleep = now, sleep
        self._through_drives = with_plate
        self._opener = opener
        self._reports = Reports(config.watch.repeat)
        self._link: Link | None = None

    def start(self) -> None:
        """Open the bus and take both drives to operational, monitored and without torque.

        Blocks for some tenths of a second, and for as long as the adapter takes to open.

        Raises:
            DriveError: If anything is not as it should be; the bus is closed again then.
        """
        self.stop()
        config = self.config
        self._reports = Reports(config.watch.repeat)
        bus = self._opener(config.bus)
        link = Link(bus, f"CAN {config.bus}", self._reports, self.now)
        try:
            bring_up(bus, config, with_plate=self._through_drives, now=self.now)
        except BaseException as error:
            link.close()
            if isinstance(error, BUS_ERRORS) and not isinstance(error, DriveError):
                where = f"CAN {config.bus}"
                raise DriveError(c.ADAPTER_GONE, where, str(error)) from error
            raise
        link.heartbeat(config.host)
        self._link = link
        at = self.now()
        self.axes = tuple(self._axis(index, at) for index in (0, 1))
        self._guards = tuple(Guard(axis, config, self._reports) for axis in self.axes)
        nodes = (axis.node for axis in config.axes)
        self._by_node = dict(zip(nodes, self._guards, strict=True))
        self._lookout = Lookout(config, self._reports, at)
        self._sent, self._synced, self._beat = 0, at, at
        self._trip: float | None = None
        self.stale, self.heartbeat = 0, True

    def _axis(self, index: int, at: float) -> Axis:
        config, watch = self.config.axes[index], self.config.watch
        motor = Counter(config.position, watch.jump * self.config.rate_limit, watch.slack[0])
        plate = Counter(config.plate, watch.plate_rate, watch.slack[1])
        axis = Axis(config, motor, plate if self._through_drives else None)
        axis.heartbeat = at
        return axis

    def receive(self) -> None:
        """Take in everything that has arrived; never waits."""
        self._drain(0.0)
        if self._sent and any(axis.motion.cycle < self._sent for axis in self.axes):
            self.stale += 1

    def settle(self, limit: float) -> None:
        """Wait for the answers to the last SYNC, at most for a time in s; for idle time only.

        Without it frames are noticed at the next ``receive``, and ``round_trip`` counts to there.
        """
        deadline = self.now() + limit
        while self._trip is None and (left := deadline - self.now()) > 0 and self._up:
            self._drain(left)

    def send(self) -> None:
        """Judge the cycle that ends, then send the commands and the next SYNC; never waits."""
        link = self._link
        if link is None:
            return
        self._drain(0.0)
        at = self.now()
        if self._sent:
            for guard in self._guards:
                guard.cycle(at)
        if self._reports.stopped:
            self.quick_stop()
        for axis in self.axes:
            axis.settle_stop()
            link.send(frames.RPDO1 + axis.config.node, axis.output())
        self._sent += 1
        self._trip = None
        self._synced = self.now()
        link.send(frames.SYNC, b"")
        if self.heartbeat and at - self._beat >= self.config.heartbeat - self.config.period / 2:
            self._beat = at
            if not any(guard.stop_ignored for guard in self._guards):
                link.heartbeat(self.config.host)
        question = self._lookout.next(at)
        if question is not None:
            link.send(*question)
        link.flush()

    def exchange(self) -> None:
        """``receive`` and ``send``, where nothing is computed between them."""
        self.receive()
        self.send()

    def quick_stop(self) -> None:
        """Ask for target zero and quick stop, then no torque."""
        for axis in self.axes:
            axis.target = 0.0
            if axis.wish is Wish.ON:
                axis.wish = Wish.QUICK_STOP

    @property
    def cycle(self) -> Cycle:
        """SYNCs sent, and those that the newest positions answer."""
        phi, theta = self.axes
        return Cycle(self._sent, (phi.motion.cycle, theta.motion.cycle))

    @property
    def round_trip(self) -> float | None:
        """Seconds from the last SYNC to the last of its answers; None while one is missing."""
        return self._trip

    def stop(self) -> None:
        """Target zero, quick stop, disable, and only then no more SYNC; close the bus.

        Blocks for about a second at most; idempotent; never raises.
        """
        link = self._link
        if link is None:
            return
        for axis in self.axes:
            axis.target = 0.0
        self._go_on(lambda: all(abs(axis.rate) < _STILL for axis in self.axes))
        self.quick_stop()
        self._go_on(lambda: all(axis.wish is not Wish.QUICK_STOP for axis in self.axes))
        self._go_on(lambda: all(axis.state is State.SWITCH_ON_DISABLED for axis in self.axes), 5)
        for axis in self.axes:
            node = axis.config.node
            link.send(frames.REQUEST + node, _MONITORING_OFF)
            link.send(frames.NMT, bytes((frames.PRE_OPERATIONAL, node)))
        self.sleep(self.config.heartbeat)
        link.close()
        self._link = None

    def _go_on(self, done: Callable[[], bool], most: int | None = None) -> None:
        """Exchange until something is done, or for the longest time of a shutdown step."""
        for _ in range(most or round(_SHUTDOWN / self.config.period)):
            if not self._up or done():
                return
            self.exchange()
            self.sleep(self.config.period)

    @property
    def _up(self) -> bool:
        return self._link is not None and self._link.up

    def _drain(self, wait: float) -> None:
        if self._link is None:
            return
        for identifier, data in self._link.receive(wait):
            at = self.now()
            node, service = identifier & frames.NODE, identifier & ~frames.NODE
            guard = self._by_node.get(node)
            if guard is None:
                continue
            guard.frame(service, data, self._sent, self._synced, at)
            if service == frames.ANSWER:
                self._lookout.take(node, data, at)
            elif self._trip is None and all(
                stream.cycle == self._sent
                for axis in self.axes
                for stream in (axis.motion, axis.sensors)
            ):
                self._trip = at - self._synced
