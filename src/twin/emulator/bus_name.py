"""Names of CAN buses as python-can has them; nothing here loads python-can.

python-can imports asammdf where that is installed, which takes seconds.
"""

from __future__ import annotations

import ast
import ipaddress
import re
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from twin.base.errors import RigError, nearest

PSEUDO_TERMINAL = "slcan"
"""Name of the bus that is an adapter of the emulator's own, on a pseudo-terminal."""


class BusName(NamedTuple):
    """A bus as python-can names it.

    Attributes:
        interface: Its interface, as ``socketcan``.
        channel: Its channel; empty for the interface's own.
        port: IP port of ``udp_multicast``; None for its own.
    """

    interface: str
    channel: str = ""
    port: int | None = None

    def __str__(self) -> str:
        port = "" if self.port is None else f"@{self.port}"
        return f"{self.interface}:{self.channel}{port}" if self.channel else self.interface


def parse_bus(text: str) -> BusName:
    """The bus of a text: ``INTERFACE:CHANNEL``, an interface alone, or ``vcan0``.

    The channel of ``udp_multicast`` is an address, or an address and a port, ``ADDRESS@PORT``:
    on one computer groups of the same port hear each other.

    Raises:
        RigError: python-can has no such interface, or the channel cannot be one of it.
    """
    if re.fullmatch(r"v?can\d+", text):
        return BusName("socketcan", text)
    interface, _, channel = text.partition(":")
    if interface not in (known := interface_names()):
        near = nearest(interface, sorted(known))
        raise RigError(f"--bus {text}: unknown CAN interface {interface!r}{near}")
    if interface != "udp_multicast" or not channel:
        return BusName(interface, channel)
    group, at, port = channel.partition("@")
    if not _is_multicast(group):
        raise RigError(f"--bus {text}: not an IP multicast address; one is 239.74.163.2")
    if at and not (port.isdecimal() and 1024 <= int(port) <= 65535):
        raise RigError(f"--bus {text}: the port must be 1024 to 65535")
    return BusName(interface, group, int(port) if at else None)


def interface_names() -> set[str]:
    """Interfaces that python-can offers, its own and those of other packages.

    Its own are read in its source, where they stand as a table; the table of an unknown version of
    it is taken from the loaded library.

    Raises:
        AbsentPartError: python-can is not installed.
    """
    found = find_spec("can")
    for folder in (found and found.submodule_search_locations) or ():
        source = Path(folder, "interfaces", "__init__.py")
        if not source.exists():
            continue
        for node in ast.parse(source.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "BACKENDS":
                others = {each.name for each in entry_points(group="can.interface")}
                return others.union(ast.literal_eval(node.value) if node.value else ())
    import can  # noqa: PLC0415  takes seconds

    return {*can.VALID_INTERFACES}


def _is_multicast(text: str) -> bool:
    try:
        return ipaddress.ip_address(text).is_multicast
    except ValueError:
        return False
