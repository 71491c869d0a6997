"""What a count means in a drive: read from the drive and checked, never assumed in silence.

Velocities and accelerations among the drive's own parameters (3xxxh), and what CiA 402 derives
from them, count in the unit chosen by UNIT.VROTARY and UNIT.ACCROTARY: rpm and rpm/s, or they are
refused. How many counts one of them has is not documented: 1000 fits what the vendor says of 60FFh,
1 what its EDS gives as defaults. The values found in the drive tell the two apart, as a motor has
neither 2.3 nor 2.3 million rpm.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from twin.devices.akd.config import RPM
from twin.devices.akd.dictionary import table
from twin.devices.akd.network import Remote

PER_UNIT = 1000
"""Counts of one unit unless the rig file says otherwise; as for 60FFh (web help: float 1000:1)."""

_CUSTOM_VELOCITY = 1 << 4
"""Bit of FBUS.PARAM05 that replaces 0.001 rpm by the factor in 204Ch."""
_DIGITS = 2
_COARSEST = 0.1
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
        amount = value / RPM
        step = 10.0 ** (math.floor(math.log10(amount)) + 1 - _DIGITS)
        wanted = math.ceil(amount / step - 1e-9) * step * RPM
        counts = math.ceil(wanted / self.scale - 1e-9)
        if counts * self.scale > (1 + _COARSEST) * value:
            raise ValueError(f"{self.words(1)} a count is too coarse for {value:.3g} in SI units")
        return counts

    def words(self, counts: int) -> str:
        """Counts as a person reads them."""
        return f"{counts * self.scale / RPM:.6g} {self.unit}"


class DriveUnits(NamedTuple):
    """What a drive says of its units."""

    velocity: DriveQuantity
    acceleration: DriveQuantity

    @property
    def words(self) -> str:
        """In one line, for the doctor."""
        speed, ramp = self.velocity, self.acceleration
        return (
            f"target velocity in 0.001 rpm; limits in {speed.unit} (365Fh), {speed.words(1)} "
            f"a count; ramps in {ramp.unit} (3659h), {ramp.words(1)} a count"
        )


SPEEDS = (9 * RPM, 20_000 * RPM)
"""Speed limits that a motor may have, rad/s; the host sets none below 1 rad/s."""
RAMPS = (100 * RPM, 5e6 * RPM)
"""Ramps that a drive may have, rad/s^2."""


def read_units(remote: Remote) -> DriveUnits:
    """Read a drive's units, and check whatever else scales what is exchanged with it.

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
    speed = _quantity(remote, 0x365F, "UNIT.VROTARY", "rpm", axis.limit_unit, "limit_unit")
    given = axis.acceleration_unit
    ramp = _quantity(remote, 0x3659, "UNIT.ACCROTARY", "rpm/s", given, "acceleration_unit")
    _check_plausible(remote, speed, "velocity", SPEEDS)
    _check_plausible(remote, ramp, "acceleration", RAMPS)
    return DriveUnits(speed, ramp)


def _quantity(
    remote: Remote, index: int, name: str, unit: str, given: float | None, key: str
) -> DriveQuantity:
    if chosen := remote.read(index):
        text = f"{name} ({index:04X}h) is {chosen}; set it to 0 ({unit}) in the drive"
        raise remote.wrong(text)
    return DriveQuantity(unit, given if given is not None else RPM / PER_UNIT, key)


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
        allowed = f"{low / RPM:.3g} to {high / RPM:.3g} {unit} are plausible"
        text = f"{name} ({index:04X}h) holds {found}, which would be {quantity.words(found)}"
        fits = [size for size in (RPM, RPM / PER_UNIT) if low <= found * size <= high]
        advice = f"set {name} in the drive"
        if fits:
            in_unit = f"{found * fits[0] / RPM:g} {unit}"
            advice = f"if it is {in_unit}, set {axis.name}.{quantity.key} = {fits[0]:.9g}"
        raise remote.wrong(f"{text} ({allowed}); {advice}")
