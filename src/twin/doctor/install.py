"""What is here for what: extras, viewer, browser, real time, ports of devices."""

from __future__ import annotations

import os
import re
import webbrowser
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, requires, version

from serial.tools import list_ports

from twin import installation
from twin.devices.realtime import real_time
from twin.doctor.check import CheckResult, failed, noted, passed, scheduled, warned
from twin.errors import TwinError
from twin.view.viewer import has_display, program

EXTRAS = {
    "casadi": "the equations as symbols",
    "cluster": "study --scheduler, on other computers",
    "gym": "environments for Gymnasium",
    "mcap": "export to .mcap",
    "mpc": "the law mpc",
    "play": "ballplate play",
    "tune": "tune with a search by Optuna",
    "video": "export to .mp4",
}
"""What each extra is for."""


def examine_installation() -> Iterator[CheckResult]:
    """What an installation can do, and what it takes to do more."""
    problem = installation.problem()
    yield (
        failed("packages", problem, "install it again")
        if problem
        else passed("packages", f"ballplate {version('ballplate')}, found whole")
    )
    for extra, purpose in EXTRAS.items():
        missing = [name for name in _packages(extra) if not _is_here(name)]
        what, command = f"extra {extra} ({purpose})", f"pip install 'ballplate[{extra}]'"
        seen = f"{', '.join(missing)} missing" if missing else "installed"
        yield noted(what, seen, command if missing else "")
    yield from _pictures()
    with real_time() as obtained:
        yield from scheduled(obtained)
    yield from _ports()


def _packages(extra: str) -> list[str]:
    """The packages that an extra asks for."""
    marked = (line.partition(";") for line in requires("ballplate") or ())
    found = (re.match(r"[\w.-]+", line) for line, _, mark in marked if extra in mark)
    return [match.group() for match in found if match]


def _is_here(package: str) -> bool:
    with suppress(PackageNotFoundError):
        return bool(version(package))
    return False


def _pictures() -> Iterator[CheckResult]:
    """What shows a run."""
    try:
        program()
    except (ImportError, TwinError) as error:
        yield warned("viewer", str(error), "pip install rerun-sdk; or view RUN --rrd FILE")
    else:
        window = "opens a window" if has_display() else "no display: view RUN --serve, in a browser"
        yield passed("viewer", window)
    try:
        webbrowser.get()
    except webbrowser.Error:
        advice = "open the address that play prints in a browser of another computer"
        yield warned("browser (play, docs)", "none found", advice)
    else:
        yield passed("browser (play, docs)", "found")


def _ports() -> Iterator[CheckResult]:
    """Serial ports, to which CAN adapters and touch screens are connected."""
    found = sorted(port.device for port in list_ports.comports())
    if not found:
        yield warned(
            "serial ports", "none", "connect adapter or screen; the virtual rig needs none"
        )
    for port in found:
        permitted = os.access(port, os.R_OK | os.W_OK)
        seen = port if permitted else f"{port}: not permitted"
        yield noted("serial ports", seen, "" if permitted else "add yourself to group dialout")
