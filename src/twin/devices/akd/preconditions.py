"""Settings of a drive that the host does not write, and what is known of them."""

from __future__ import annotations

from typing import NamedTuple

from twin.devices.akd.config import AkdConfig
from twin.devices.akd.network import Remote

BY_HAND = (
    "DRV.TYPE is CANopen",
    "DRV.CMDSOURCE is 1 (fieldbus)",
    "with everything off there are 60 ohm between CANH and CANL: a terminator at either end",
)
"""What no object of the drive tells: to be looked at in WorkBench, and measured."""


class Precondition(NamedTuple):
    """One setting.

    Attributes:
        name: What it is called in the drive.
        seen: Its value in words.
        advice: What to do; empty if it is as it should be.
    """

    name: str
    seen: str
    advice: str


def read_preconditions(remote: Remote, config: AkdConfig) -> tuple[Precondition, ...]:
    """What the drive says; a setting that this drive does not have is left out.

    Raises:
        DriveError: If the drive does not answer.
    """
    checks = (
        (0x36E5, lambda value: _bit_rate(value, config.bus.bitrate // 1000)),
        (0x3506, _hardware_enable),
        (0x3498, _protection),
    )
    values = ((remote.read_if_there(index), judge) for index, judge in checks)
    return tuple(judge(value) for value, judge in values if value is not None)


def _bit_rate(value: int, configured: int) -> Precondition:
    name = "FBUS.PARAM01 (bit rate)"
    if value == configured:
        return Precondition(name, f"{value} kbit/s", "")
    advice = f"set it to {configured} in the drive and power-cycle it"
    if value == 0:
        return Precondition(name, "automatic: found from the first frames at power-up", advice)
    return Precondition(name, f"{value} kbit/s from the next power-up on", advice)


def _hardware_enable(value: int) -> Precondition:
    name = "DRV.HWENMODE"
    if value:
        return Precondition(name, "the hardware enable clears no faults", "")
    seen = "an edge of the hardware enable clears faults, though nobody asked for --reset"
    return Precondition(name, seen, "set it to 1 in the drive")


def _protection(value: int) -> Precondition:
    name = "FBUS.PROTECTION"
    if value:
        return Precondition(name, "other tools cannot write while the bus runs", "")
    seen = "WorkBench can write while the bus runs"
    return Precondition(name, seen, "set it to 1 in the drive, or keep WorkBench closed")
