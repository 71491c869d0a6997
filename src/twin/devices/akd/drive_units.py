"""Units of a drive's own parameters, read from it and checked, never assumed in silence.

Velocities and accelerations among its own parameters (3xxxh), and what CiA 402 derives from them,
count in the unit chosen by UNIT.VROTARY and UNIT.ACCROTARY: rpm and rpm/s, or they are refused. How
many counts one of them has is not documented: 1000 fits the vendor's description of 60FFh, 1 fits
the defaults in its EDS. The values found in the drive show which of the two it is, as a motor has
neither 2.3 nor 2.3 million rpm.

Currents count in 0.001 A and the torque constant in 0.001 N m/A, which the defaults of the vendor's
EDS suggest (MOTOR.ICONT 9900, MOTOR.IPEAK 29 700). Their product, the motor's continuous torque, is
known from its datasheet: it shows whether both are read rightly, and whether the drive knows its
motor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.devices.akd.config import AkdConfig
from twin.devices.akd.protocol import RPM_RAD_S, table
from twin.devices.akd.remote import Remote

COUNTS_PER_RPM = 1000
"""Counts of 1 rpm, or 1 rpm/s, where the rig file gives no value; as for 60FFh (web help: float
1000:1)."""

_CUSTOM_VELOCITY = 1 << 4
"""Bit of FBUS.PARAM05 that replaces 0.001 rpm by the factor in 204Ch."""
_ROUNDING_DIGITS = 2
"""Significant digits to which a value is rounded up in the drive's unit."""
_MAX_ROUNDING_SHARE = 0.1
"""Share by which a value may pass the one wanted because it is rounded up."""


class DriveQuantity(NamedTuple):
    """A velocity or an acceleration as a drive's parameters have it.

    Attributes:
        unit: ``rpm`` or ``rpm/s``.
        scale: One count in rad/s or rad/s^2 at the motor.
        key: Key of the rig file that overrides it.
    """

    unit: str
    scale: float
    key: str

    def counts(self, value: float) -> int:
        """The fewest counts that are at least a value, round in the drive's unit.

        Rounded up: these are nets, and the host's own limits come first.

        Raises:
            ValueError: If the drive's counts are too coarse for it.
        """
        amount = value / RPM_RAD_S
        step = 10.0 ** (math.floor(math.log10(amount)) + 1 - _ROUNDING_DIGITS)
        wanted = math.ceil(amount / step - 1e-9) * step * RPM_RAD_S
        counts = math.ceil(wanted / self.scale - 1e-9)
        if counts * self.scale > (1 + _MAX_ROUNDING_SHARE) * value:
            raise ValueError(f"{self.words(1)} a count is too coarse for {value:.3g} in SI units")
        return counts

    def words(self, counts: int) -> str:
        """Counts as a person reads them."""
        return f"{counts * self.scale / RPM_RAD_S:.6g} {self.unit}"


SPEED_RANGE_RAD_S = (9 * RPM_RAD_S, 20_000 * RPM_RAD_S)
"""Speed limits that a motor may have, rad/s; the host sets none below 1 rad/s."""
RAMP_RANGE_RAD_S2 = (100 * RPM_RAD_S, 5e6 * RPM_RAD_S)
"""Ramps that a drive may have, rad/s^2."""


def read_units(remote: Remote) -> tuple[DriveQuantity, DriveQuantity]:
    """Units of velocity and acceleration; checks whatever else scales what is exchanged, too.

    Raises:
        DriveError: If anything scales otherwise than the host counts; it names the line to change.
    """
    axis = remote.axis
    counts = remote.read(0x608F, 1) / max(1, remote.read(0x608F, 2))
    if counts != axis.motor_counts:
        raise remote.wrong(
            f"{counts:g} counts per motor revolution (608Fh), configured are {axis.motor_counts}; "
            f"set {axis.name}.motor_counts = {counts:g}",
        )
    if remote.read(0x36E9) & _CUSTOM_VELOCITY:
        factor = f"{remote.read(0x204C, 1)}/{remote.read(0x204C, 2)}"
        detail = (
            f"velocity is scaled by 204Ch = {factor} (36E9h bit 4 is set); clear it in the drive"
        )
        raise remote.wrong(detail)
    for index, name in ((0x6091, "gear ratio"), (0x6092, "feed constant")):
        ratio = remote.read(index, 1), remote.read(index, 2)
        if ratio[0] != ratio[1]:
            text = f"{name} {index:04X}h is {ratio[0]}:{ratio[1]}; set it to 1:1 in the drive, "
            raise remote.wrong(f"{text}and name a real gear as {axis.name}.gear")
    speed = _quantity(remote, 0x365F, "UNIT.VROTARY", "rpm", "limit_unit")
    ramp = _quantity(remote, 0x3659, "UNIT.ACCROTARY", "rpm/s", "acceleration_unit")
    _check_plausible(remote, speed, "velocity", SPEED_RANGE_RAD_S)
    _check_plausible(remote, ramp, "acceleration", RAMP_RANGE_RAD_S2)
    return speed, ramp


def _quantity(remote: Remote, index: int, name: str, unit: str, key: str) -> DriveQuantity:
    if chosen := remote.read(index):
        text = f"{name} ({index:04X}h) is {chosen}; set it to 0 ({unit}) in the drive"
        raise remote.wrong(text)
    given: float | None = getattr(remote.axis, key)
    return DriveQuantity(unit, given if given is not None else RPM_RAD_S / COUNTS_PER_RPM, key)


def _check_plausible(
    remote: Remote, quantity: DriveQuantity, kind: str, range_: tuple[float, float]
) -> None:
    """Compare what the drive has been set to with what a motor can have."""
    low, high = range_
    axis, unit = remote.axis, quantity.unit
    for index, name in table()["scaled"][kind]:
        found = abs(remote.read(index))
        if not found or low <= found * quantity.scale <= high:
            continue
        allowed = f"{low / RPM_RAD_S:.3g} to {high / RPM_RAD_S:.3g} {unit} are plausible"
        text = f"{name} ({index:04X}h) holds {found}, which would be {quantity.words(found)}"
        fits = [
            size for size in (RPM_RAD_S, RPM_RAD_S / COUNTS_PER_RPM) if low <= found * size <= high
        ]
        advice = f"set {name} in the drive"
        if fits:
            in_unit = f"{found * fits[0] / RPM_RAD_S:g} {unit}"
            advice = f"if it is {in_unit}, set {axis.name}.{quantity.key} = {fits[0]:.9g}"
        raise remote.wrong(f"{text} ({allowed}); {advice}")


COUNTS_PER_AMPERE = 1000
"""Counts of a current per A, and of the torque constant per N m/A."""
_MAX_MOTOR_FACTOR = 1.5
"""Factor by which the drive's motor may differ from the datasheet's."""
_CURRENT_STEP_A = 0.1
"""Step in A to which the limit is rounded up."""


def current_limit(remote: Remote, config: AkdConfig) -> tuple[int, str]:
    """The current that gives the torque limit, in counts of IL.LIMITP (356Eh) and in words.

    Raises:
        DriveError: If the drive's motor is not the one configured, or its currents count unlike.
    """
    axis = remote.axis
    continuous, constant = remote.read(0x358E), remote.read(0x3593)
    motor = continuous * constant / COUNTS_PER_AMPERE**2
    known = (
        f"MOTOR.ICONT {continuous / COUNTS_PER_AMPERE:g} A "
        f"times MOTOR.KT {constant / COUNTS_PER_AMPERE:g} N m/A"
    )
    if (
        not config.motor_torque / _MAX_MOTOR_FACTOR
        <= motor
        <= config.motor_torque * _MAX_MOTOR_FACTOR
    ):
        detail = (
            f"{known} are {motor:.3g} N m, the motor's continuous torque is "
            f"{config.motor_torque:g}; choose the motor in the drive, or set drives.motor_torque"
        )
        raise remote.wrong(detail)
    found = remote.read(0x356E)
    if found and not continuous / 100 <= found <= 100 * continuous:
        detail = (
            f"IL.LIMITP (356Eh) holds {found} and MOTOR.ICONT (358Eh) {continuous}: they do not "
            "count alike; set IL.LIMITP to the motor's peak current in the drive"
        )
        raise remote.wrong(detail)
    amperes = config.torque_limit / axis.gear / (constant / COUNTS_PER_AMPERE)
    amperes = _CURRENT_STEP_A * math.ceil(amperes / _CURRENT_STEP_A - 1e-9)
    words = f"torque {amperes * axis.gear * constant / COUNTS_PER_AMPERE:.3g} N m ({amperes:.3g} A)"
    return round(amperes * COUNTS_PER_AMPERE), words
