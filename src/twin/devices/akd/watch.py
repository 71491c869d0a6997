"""Thresholds with which the drives are monitored."""

from __future__ import annotations

from dataclasses import dataclass

from twin.devices.nets import bounded, check_ranges, net


@dataclass(frozen=True, kw_only=True)
class MonitorConfig:
    """Thresholds of the monitoring; s, rad, rad/s, or cycles where said; each a `net`.

    Attributes:
        stale: Cycles without a PDO after which the axis counts as unknown.
        unsteady: Irregular cycles (missing, late, surplus, short) among the last 50 that level;
            51 never does.
        burst: Emergencies within 1 s that level.
        travel: Commanded motor travel without a single count of motion, rad, that is a fault.
        plate_travel: Motor travel without a count of the plate encoder, rad; with cams of ratio 5
            it moves the plate by 230 counts of 245760, or by three times the play of 0.1 deg.
        frozen: Time of fresh data without a count, s, that must have passed as well: answers lag.
        jump: Factor of the rate limit that no encoder can pass.
        plate_rate: Fastest plausible plate motion, rad/s.
        slack: Motion that is never a jump: motor rad, plate rad.
        lag: Motor rate error, rad/s, for longer than ``lag_time`` s that counts as not following.
        limit_time: Duration of an internal limit that levels, s.
        reset: Time a fault reset may take, s.
        stop: Time a quick stop may take before the heartbeat is withheld, s.
        enquiry: Pause between two readings of the drives' own monitoring, s.
        answer: Time an SDO answer may take, s.
        repeat: Shortest time between two reports of one warning, s.
    """

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
    reset: float = net(0.1, 0.02, 2)
    stop: float = net(0.3, 0.05, 2)
    enquiry: float = net(0.5, 0.05, 5)
    answer: float = net(0.1, 0.02, 10)
    repeat: float = bounded(1.0, 0.1, 60)

    def __post_init__(self) -> None:
        """Refuse what would be no threshold."""
        check_ranges(self, "drives.watch.")
