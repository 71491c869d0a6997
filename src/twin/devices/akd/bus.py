"""Opening a CAN bus by name, with one clear line when it cannot be."""

from __future__ import annotations

import difflib
import errno
import logging
import sys
from collections.abc import Iterable
from pathlib import Path

import can
from serial.tools.list_ports import comports

from twin.devices.akd.conditions import BAD_BUS, DriveError
from twin.devices.akd.config import BusConfig
from twin.devices.akd.slcan_bus import PromptSlcanBus

# The library logs to stderr what becomes one line here.
logging.getLogger("can").addHandler(logging.NullHandler())

_CAN_DEVICE = "280"
"""ARPHRD_CAN, as the kernel writes it under /sys/class/net."""


def open_bus(config: BusConfig) -> can.BusABC:
    """Open a bus through python-can.

    Raises:
        DriveError: If there is no such interface or channel, or it may not or cannot be used.
    """
    if config.interface not in can.VALID_INTERFACES:
        near = _nearest(config.interface, can.VALID_INTERFACES)
        raise _bad(config, f"unknown CAN interface {config.interface!r}; {near}")
    try:
        # On Windows a serial port has no file descriptor: the library's own slcan has to do.
        if config.interface == "slcan" and sys.platform != "win32":
            return PromptSlcanBus(config.channel, config.bitrate, **config.options)
        # SocketCAN's bit rate is set by the operating system, and python-can warns if it is given.
        options = dict(config.options)
        if config.interface not in {"socketcan", "virtual"}:
            options["bitrate"] = config.bitrate
        return can.Bus(interface=config.interface, channel=config.channel, **options)
    except Exception as error:  # drivers of adapters raise anything, even NameError
        raise _bad(config, _reason(config, error)) from error


def _reason(config: BusConfig, error: Exception) -> str:
    channel = config.channel
    missing = f"no channel {channel!r}; {_nearest(channel, _channels(config))}"
    reasons = {
        errno.EACCES: f"no permission for {channel}; join the group that owns it (often dialout)",
        errno.EPERM: f"no permission for {channel}",
        errno.ENOTTY: f"{channel} is no serial port",
        errno.EBUSY: f"{channel} is used by another program",
        errno.EAFNOSUPPORT: "this kernel has no SocketCAN; use an slcan or vendor adapter",
        errno.ENOENT: missing,
        errno.ENODEV: missing,
        errno.ENXIO: missing,
        errno.ENETDOWN: f"{channel} is down; `ip link set {channel} up type can bitrate ...`",
    }
    known = reasons.get(_errno(error) or 0)
    if known is not None:
        return known
    if isinstance(error, (can.CanInterfaceNotImplementedError, ImportError, NameError)):
        return f"the driver of {config.interface} is not installed ({_line(error)})"
    return _line(error)


def _errno(error: BaseException | None) -> int | None:
    """The system's error number, wherever the libraries have wrapped it."""
    while error is not None:
        candidates = getattr(error, "errno", None), getattr(error, "error_code", None), *error.args
        number = next((each for each in candidates if isinstance(each, int)), None)
        if number is not None:
            return number
        error = error.__cause__ or error.__context__
    return None


def _channels(config: BusConfig) -> list[str]:
    if config.interface == "slcan":
        return [port.device for port in comports()]
    devices = Path("/sys/class/net").glob("*/type")
    return [each.parent.name for each in devices if each.read_text().strip() == _CAN_DEVICE]


def _nearest(wrong: str, right: Iterable[str]) -> str:
    names = sorted(right)
    near = difflib.get_close_matches(wrong, names, n=3, cutoff=0.5)
    if near:
        return "nearest: " + ", ".join(near)
    return "there are: " + ", ".join(names) if names else "there is none here"


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _bad(config: BusConfig, detail: str) -> DriveError:
    return DriveError(BAD_BUS, f"CAN {config}", detail)
