"""What is special about one emulated drive."""

from __future__ import annotations

import math
from dataclasses import dataclass

from twin.sim.sensors import COUNTS

RPM = math.pi / 30


@dataclass(frozen=True, kw_only=True)
class DriveSettings:
    """One drive with its motor and its second encoder.

    Attributes:
        node: CANopen node, 1 to 127.
        serial: Serial number.
        motor_counts: Counts per motor revolution, a power of 2.
        plate_counts: Counts per revolution of the second encoder.
        plate_per_motor: How the second encoder turns with the motor where no plant says.
        start_counts: Motor position at power-up; near 2^31 it soon wraps.
        plate_start_counts: Second position at power-up.
        coasting: Time constant in s with which the motor runs out without power.
        velocity_unit: One count of 60FFh and 606Ch in rad/s.
        parameter_count: One count of velocity limits and ramps, in the units of 365Fh and 3659h.
        coarse: Counts to a multiple of which velocity limits and ramps are kept, as those are
            floating-point numbers inside.
        shows_bit_30: Whether COB-IDs are shown with bit 30 set.
        stop_ramp: Deceleration of quick stop and fault reaction in rad/s^2; assumed.
        emergency_codes: Emergency code for a fault number; others give 1081h. That of F129 is
            CiA 301's for a heartbeat; AKD's own was not found.
    """

    node: int
    serial: int = 0
    motor_counts: int = 1 << 20
    plate_counts: int = COUNTS
    plate_per_motor: float = 0.2
    start_counts: int = 0
    plate_start_counts: int = 0
    coasting: float = 0.2
    velocity_unit: float = 0.001 * RPM
    parameter_count: float = 0.001
    coarse: int = 1
    shows_bit_30: bool = False
    stop_ramp: float = 1000.0
    emergency_codes: tuple[tuple[int, int], ...] = (
        (129, 0x8130),
        (234, 0x4210),
        (235, 0x4310),
        (247, 0x3120),
        (501, 0x3210),
        (502, 0x3220),
        (503, 0x3130),
    )

    def emergency_code(self, number: int) -> int:
        """The code in the emergency message of a fault."""
        return dict(self.emergency_codes).get(number, 0x1081)
