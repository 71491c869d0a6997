"""Frames that only a master of the network sends: whoever hears one is not the only master.

What the host sends itself does not come back to it.
"""

from __future__ import annotations

from twin.devices.akd import frames
from twin.devices.akd.config import AkdConfig

_RPDOS = 4


def master_frames(config: AkdConfig) -> dict[int, str]:
    """Identifiers of those frames, and what each is in words.

    Args:
        config: Nodes of the drives and of the host.
    """
    beat = frames.HEARTBEAT + config.host
    known = {
        frames.NMT: "NMT commands (000h)",
        frames.SYNC: "SYNC (080h)",
        beat: f"a heartbeat of node {config.host} ({beat:03X}h), "
        "so the drives would not notice that this host falls silent",
    }
    for axis in config.axes:
        for number in range(_RPDOS):
            command = frames.RPDO1 + 0x100 * number + axis.node
            known[command] = f"RPDO{number + 1} to {axis.where} ({command:03X}h)"
        request = frames.SDO_REQUEST + axis.node
        known[request] = f"SDO requests to {axis.where} ({request:03X}h)"
    return known
