"""How the drives are wired, scaled, set and watched, with the source of every uncertain number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from twin.base.errors import ScenarioError
from twin.devices.akd.protocol import RPM_RAD_S, TURN_RAD
from twin.devices.common import Ranged, net, range_field
from twin.hal.interface import NOMINAL_PERIOD


@dataclass(frozen=True, kw_only=True)
class MonitorConfig(Ranged):
    """Thresholds of the monitoring; s, rad, rad/s, or cycles where stated; each a `net`.

    Attributes:
        stale: Cycles without a PDO after which the axis counts as unknown.
        unsteady: Irregular cycles (missing, late, surplus, short) among the last 50 that level;
            51 never does.
        burst: Emergencies within 1 s that level.
        travel: Commanded motor travel without a single count of motion, rad, that is a fault; twice
            as much is allowed between position and added-up velocity.
        plate_travel: Motor travel without a count of the plate encoder, rad; with cams of ratio 5
            it moves the plate by 230 counts of 245760, or by three times the play of 0.1 deg.
        frozen: Time of fresh data without a count, s, that must have passed as well: answers lag.
        jump: Factor of the rate limit that no encoder can pass.
        plate_rate: Fastest plausible plate motion, rad/s.
        slack: Motion that is never a jump: motor rad, plate rad.
        lag: Motor rate error, rad/s, for longer than ``lag_time`` s that counts as not following.
        limit_time: Duration of an internal limit that levels, s.
        lost_deg: Plate angle that play and elastic parts may take between motor and plate, deg.
        reset: Time a fault reset may take, s.
        stop: Time a quick stop may take before the heartbeat is withheld, s.
        enquiry: Pause between two readings of the drives' own monitoring, s.
        answer: Time an SDO answer may take, s.
        repeat: Shortest time between two reports of one warning, s.
    """

    keys = "drives.watch."
    stale: int = net(10, 2, 250)
    unsteady: int = net(12, 1, 51)
    burst: int = net(10, 2, 100)
    travel: float = net(0.005, 0.0005, 0.1)
    plate_travel: float = net(0.03, 0.003, 0.5)
    frozen: float = net(0.02, 0.004, 10)
    jump: float = net(3.0, 1, 10)
    plate_rate: float = net(6.0, 0.5, 20)
    slack: tuple[float, float] = net((0.01, 0.01), 0.001, 0.1)
    lag: float = net(1.0, 0.1, 8)
    lag_time: float = net(0.06, 0.01, 2)
    limit_time: float = net(0.02, 0.002, 1)
    lost_deg: float = net(0.6, 0.1, 5)
    reset: float = net(0.1, 0.02, 2)
    stop: float = net(0.3, 0.05, 2)
    enquiry: float = net(0.5, 0.05, 5)
    answer: float = net(0.1, 0.02, 10)
    repeat: float = range_field(1.0, 0.1, 60)


INT32_MIN, INT32_MAX = -(1 << 31), (1 << 31) - 1


def counts32(value: float, unit: float) -> int:
    """The nearest counts of a unit that a signed 32-bit object can hold, for a finite quantity."""
    return max(INT32_MIN, min(INT32_MAX, round(value / unit)))


AKD_BITRATES = Literal[125_000, 250_000, 500_000, 1_000_000]
"""Bit rates that an AKD knows (CAN manual, p. 19)."""
_PERIOD_FRAME_BYTES = (0, 6, 6, 7, 7, 8, 8)
"""Bytes of the frames of one period: SYNC, two RPDO1, two TPDO1, two TPDO2."""


_UNCONFIRMED_METADATA = {"unconfirmed": True}
"""Metadata of a setting with a default that was never confirmed on the rig. The attribute gives its
source, and whether that is indirect (M) or inferred (L)."""


SHUTDOWN_STEP_LIMIT_S = 0.4
"""Longest time in s for each step of a shutdown of the drives."""


@dataclass(frozen=True, kw_only=True)
class BusConfig:
    """The CAN bus, as python-can names it.

    Attributes:
        interface: Any python-can interface: socketcan, slcan, pcan, virtual, ...
        channel: Its channel, as ``can0`` or ``/dev/ttyACM0``.
        bitrate: Bit/s; two drives at 2 ms need 1 Mbit/s (40 % load).
        options: Further keywords for python-can.
    """

    interface: str = "socketcan"
    channel: str = "can0"
    bitrate: AKD_BITRATES = 1_000_000
    options: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.interface} {self.channel}"


@dataclass(frozen=True, kw_only=True)
class AxisConfig(Ranged):
    """One servo axis and the plate encoder wired to its drive.

    Attributes:
        name: ``phi`` or ``theta``.
        node: CANopen node, 1 to 126.
        motor_counts: Position counts per motor revolution (6064h), checked against 608Fh.
        gear: Motor revolutions per revolution of the cam shaft; cartridge motor on the cam: none
            (M).
        motor_sign: 1, or -1 if the drive counts against the cam's sense; never checked (L).
        plate_counts: Plate encoder counts per revolution, as the drive gives them; 360/245760 deg
            divides all angles of Tables 9.2 to 9.9 (M).
        plate_sign: 1 or -1; never checked (L).
        plate_object: Index and subindex of the plate encoder's position in the drive; EDS; which
            input is not known (L).
        velocity_unit: One count of 60FFh and 606Ch in rad/s at the motor.
        acceleration_unit: One count of 6083h and 6084h in rad/s^2 at the motor; None for 0.001 of
            the unit that the drive names, UNIT.ACCROTARY, as 60FFh (L).
        limit_unit: One count of 207Fh, 3622h and 3623h in rad/s at the motor; None likewise, of
            UNIT.VROTARY, as 60FFh (M).
        product: Product code (1018h:2), or None for any AKD.
    """

    keys = "{0.name}."
    name: str
    node: int = field(metadata={"range": (1, 126)})
    motor_counts: int = range_field(1 << 20, 16, 1 << 32)
    gear: float = range_field(1.0, 0.01, 1000, **_UNCONFIRMED_METADATA)
    motor_sign: Literal[1, -1] = field(default=1, metadata=_UNCONFIRMED_METADATA)
    plate_counts: int = range_field(245760, 16, 1 << 32, **_UNCONFIRMED_METADATA)
    plate_sign: Literal[1, -1] = field(default=1, metadata=_UNCONFIRMED_METADATA)
    plate_object: tuple[int, int] = field(default=(0x2050, 0), metadata=_UNCONFIRMED_METADATA)
    velocity_unit: float = range_field(0.001 * RPM_RAD_S, 1e-9, 1)
    acceleration_unit: float | None = range_field(None, 1e-6, 1e4, **_UNCONFIRMED_METADATA)
    limit_unit: float | None = range_field(None, 1e-6, 10, **_UNCONFIRMED_METADATA)
    product: int | None = None

    @property
    def where(self) -> str:
        """Name of the drive in messages."""
        return f"drive {self.name} (node {self.node})"

    @property
    def position(self) -> float:
        """One count of the motor encoder in rad at the cam shaft; negative where signs differ."""
        return TURN_RAD / (self.motor_counts * self.gear * self.motor_sign)

    @property
    def plate(self) -> float:
        """One count of the plate encoder in rad; negative likewise."""
        return TURN_RAD / (self.plate_counts * self.plate_sign)

    @property
    def velocity(self) -> float:
        """One count of velocity in rad/s at the cam shaft; negative likewise."""
        return self.velocity_unit / (self.gear * self.motor_sign)


@dataclass(frozen=True, kw_only=True)
class DriveSettings(Ranged):
    """Settings and monitoring of both drives of a rig.

    Attributes:
        host: Node of the host; the drives monitor its heartbeat.
        heartbeat: Period of every heartbeat in s.
        silence: Silence after which either side acts, in s.
        answer: Time an SDO answer may take before the cycle runs, s.
        rate_limit: Second net in the drives: motor rate at the cam shaft, rad/s; 0.6 rad/s of the
            plate, cam ratio 6, slack (L).
        ramp: Profile acceleration at the cam shaft, rad/s^2; far above what the plate needs
            (7 rad/s^2 times a cam ratio of 5), so that the ramp is no part of the plant; own
            choice: 8 rad/s in 4 ms (L).
        torque_limit: Second net in the drives: torque at the cam shaft, N m, as a current limit;
            model: the hardest motion takes 2.8 (L).
        motor_torque: The motors' continuous torque, N m, compared with what the drives know;
            datasheet of the C041A (M).
        shaft_lag: Time constant in s with which a shaft follows the velocity that its drive
            reports, as of an emulated servo; 0 for a drive that measures it.
        watch: Thresholds.
    """

    keys = "drives."
    host: int = 127
    heartbeat: float = range_field(0.02, 0.001, 1)
    silence: float = net(0.06, 0.01, 1.0)
    answer: float = range_field(2.0, 0.001, 60)
    rate_limit: float = net(8.0, 1, 20, **_UNCONFIRMED_METADATA)
    ramp: float = range_field(2000.0, 50, 1e5, **_UNCONFIRMED_METADATA)
    torque_limit: float = net(4.5, 0.5, 12.3, **_UNCONFIRMED_METADATA)
    motor_torque: float = range_field(4.57, 0.1, 50, **_UNCONFIRMED_METADATA)
    shaft_lag: float = net(0.0, 0, 0.5)
    watch: MonitorConfig = field(default_factory=MonitorConfig)


@dataclass(frozen=True, kw_only=True)
class AkdConfig(DriveSettings):
    """Two AKD drives on one CAN bus.

    Attributes:
        bus: The bus.
        axes: phi, then theta.
        period: SYNC period in s, a whole number of ms.
    """

    bus: BusConfig = field(default_factory=BusConfig)
    axes: tuple[AxisConfig, AxisConfig] = (
        AxisConfig(name="phi", node=1),
        AxisConfig(name="theta", node=2),
    )
    period: float = NOMINAL_PERIOD

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        phi, theta = self.axes
        if (phi.name, theta.name) != ("phi", "theta"):
            raise ScenarioError("axes must be phi, then theta")
        if len({phi.node, theta.node, self.host}) < 3:
            raise ScenarioError("phi.node, theta.node, drives.host: must differ")
        if round(self.period * 1e3) < 1 or abs(self.period * 1e3 % 1) > 1e-9:
            raise ScenarioError(f"rig.period = {self.period} s: drives take whole ms")
        super().__post_init__()
        if self.heartbeat >= self.silence:
            raise ScenarioError("drives.heartbeat must be below drives.silence")
        if self.watch.lag >= self.rate_limit:
            raise ScenarioError(
                f"drives.watch.lag = {self.watch.lag}: must be below drives.rate_limit = "
                f"{self.rate_limit}; otherwise a motor at standstill counts as following"
            )
        if self.bus_load >= 1:
            raise ScenarioError(
                f"bus.bitrate = {self.bus.bitrate}: the frames of a period take "
                f"{100 * self.bus_load:.0f} % of its {1e3 * self.period:g} ms"
            )

    @property
    def lost(self) -> float:
        """Plate angle in rad that may be lost between motor and plate."""
        return math.radians(self.watch.lost_deg)

    @property
    def late(self) -> float:
        """Longest time in s from a command to the motion of the plate."""
        return 0.01 + 2 * self.period

    @property
    def bus_load(self) -> float:
        """Share of a period that its frames take on the bus, stuffed as badly as can be."""
        bits = sum(47 + 8 * size + (33 + 8 * size) // 4 for size in _PERIOD_FRAME_BYTES)
        return bits / (self.bus.bitrate * self.period)

    @property
    def relaxed(self) -> tuple[str, ...]:
        """Every safety net that is wider than by default, in words."""
        return (*super().relaxed, *self.watch.relaxed)


def list_unconfirmed() -> list[str]:
    """Every setting with a default that was never confirmed on the rig."""
    of_both = [*fields(AkdConfig), *fields(AxisConfig)]
    return sorted(each.name for each in of_both if "unconfirmed" in each.metadata)
