"""The current limit in the drive: the second net for torque, computed from the motor it names.

Currents count in 0.001 A and the torque constant in 0.001 N m/A, which the defaults of the vendor's
EDS suggest (MOTOR.ICONT 9900, MOTOR.IPEAK 29 700). Their product, the motor's continuous torque, is
known from its datasheet: it tells whether both are read rightly, and whether the drive knows its
motor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.devices.akd.conditions import WRONG_SETTING, DriveError
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.network import Remote

_PER_UNIT = 1000
_TRUST = 1.5
"""Factor by which the drive's motor may differ from the datasheet's."""
_STEP = 0.1
"""Step in A to which the limit is rounded up."""


class CurrentLimit(NamedTuple):
    """A current that the drive's controller does not pass.

    Attributes:
        counts: In the drive's counts.
        words: What it means.
    """

    counts: int
    words: str


def current_limit(remote: Remote, config: AkdConfig) -> CurrentLimit:
    """The current that gives the torque limit, in the counts of IL.LIMITP (356Eh).

    Raises:
        DriveError: If the drive's motor is not the one configured, or its currents count unlike.
    """
    axis = remote.axis
    continuous, constant = remote.read(0x358E), remote.read(0x3593)
    motor = continuous * constant / _PER_UNIT**2
    known = (
        f"MOTOR.ICONT {continuous / _PER_UNIT:g} A times MOTOR.KT {constant / _PER_UNIT:g} N m/A"
    )
    if not config.motor_torque / _TRUST <= motor <= config.motor_torque * _TRUST:
        detail = (
            f"{known} are {motor:.3g} N m, the motor's continuous torque is "
            f"{config.motor_torque:g}; choose the motor in the drive, or set drives.motor_torque"
        )
        raise DriveError(WRONG_SETTING, axis.where, detail)
    found = remote.read(0x356E)
    if found and not continuous / 100 <= found <= 100 * continuous:
        detail = (
            f"IL.LIMITP (356Eh) holds {found} and MOTOR.ICONT (358Eh) {continuous}: they do not "
            "count alike; set IL.LIMITP to the motor's peak current in the drive"
        )
        raise DriveError(WRONG_SETTING, axis.where, detail)
    amperes = config.torque_limit / axis.gear / (constant / _PER_UNIT)
    amperes = _STEP * math.ceil(amperes / _STEP - 1e-9)
    words = f"torque {amperes * axis.gear * constant / _PER_UNIT:.3g} N m ({amperes:.3g} A)"
    return CurrentLimit(round(amperes * _PER_UNIT), words)
