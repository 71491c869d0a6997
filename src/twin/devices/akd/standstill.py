"""Taking the torque from a drive that is found with it, over SDO, before anything is set."""

from __future__ import annotations

from twin.devices.akd import cia402
from twin.devices.akd.axis import difference
from twin.devices.akd.cia402 import DriveState
from twin.devices.akd.conditions import WRONG_SETTING, DriveError
from twin.devices.akd.network import Remote

_PATIENCE = 3.0
"""Longest wait in s for a drive that was found turning."""
_POLL = 0.01
"""Time in s between two readings of the position."""
_STILL = 5e-5
"""Motion in rad between them that counts as none."""

_TORQUE = {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP, DriveState.FAULT_REACTION}


def take_torque_away(remote: Remote) -> None:
    """Bring a drive from any state to rest without torque, whatever its quick stop option says.

    With option 6 (605Ah), and by one reading of the manual with every option, a quick stop ends
    at rest with torque: then, and when it takes too long, the voltage is disabled.

    Raises:
        DriveError: If the drive does not answer, keeps its torque, or does not come to rest.
    """
    remote.write(0x60FF, 0, 0)
    network = remote.network
    deadline = network.now() + _PATIENCE
    while (state := cia402.state(remote.read(0x6041))) in _TORQUE and network.now() < deadline:
        resting = _moved(remote) < _STILL
        over = state is DriveState.QUICK_STOP and resting
        remote.write(0x6040, 0, cia402.DISABLE_VOLTAGE if over else cia402.QUICK_STOP)
    remote.write(0x6040, 0, cia402.DISABLE_VOLTAGE)
    status = remote.read(0x6041)
    if cia402.state(status) in _TORQUE:
        detail = f"keeps its torque (status word {status:04X}h); open the STO circuit, then look"
        raise DriveError(WRONG_SETTING, remote.axis.where, detail)
    deadline = network.now() + _PATIENCE
    while _moved(remote) >= _STILL:
        if network.now() > deadline:
            raise DriveError(WRONG_SETTING, remote.axis.where, "does not come to rest")


def _moved(remote: Remote) -> float:
    """Motion in rad at the cam shaft within the time between two readings."""
    before = remote.read(0x6064)
    remote.network.pump(_POLL)
    return abs(remote.axis.position.value(difference(remote.read(0x6064), before)))
