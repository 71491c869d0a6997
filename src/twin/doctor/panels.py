"""The USB panels plugged in, and whether the screen's calibration is that of its panel."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from twin.devices.lumio.calibration import Calibration, read_calibration
from twin.devices.lumio.config import LumioConfig
from twin.devices.lumio.mounting import Mounting
from twin.devices.lumio.panels import HIDRAW_CLASS, Interface, panels
from twin.doctor.check import CheckResult, passed, warned
from twin.scenario.rig import RigFile

ALIKE = 0.05
"""Share by which the size in a panel's descriptor and the measured one may differ: its frame."""
CALIBRATE = "run `ballplate calibrate touch`, name its file as touch.calibration_file"


def plugged_in(config: LumioConfig, root: Path = HIDRAW_CLASS) -> Iterator[CheckResult]:
    """A line for each interface of the Lumio panels on USB, also if another port is read.

    Args:
        config: The screen's settings.
        root: Where the kernel describes raw HID devices.
    """
    port = str(Path(config.port).resolve())
    for each in panels(root):
        what = f"touch panel {each.port}"
        seen = f"{each.identity.text}: {each.what}{_size(each)}"
        chosen = config.protocol
        if each.port != port or config.transport != "hidraw":
            yield passed(what, seen)
        elif chosen in {"auto", each.identity.protocol} or not each.identity.protocol:
            yield passed(what, f"{seen}; this one is read, by its own descriptor")
        else:
            advice = f"it is read by its descriptor, not as {chosen}: set touch.protocol to auto"
            yield warned(what, seen, advice)


def _size(interface: Interface) -> str:
    layout = interface.layout
    if layout is None:
        return ""
    number = len(layout.contacts)
    contacts = f", {number} contact{'s' if number > 1 else ''} per report"
    return f", {_area(layout.extent)}{contacts}" if layout.extent else contacts


def calibrated(rig: RigFile, extent: tuple[float, float] | None) -> CheckResult:
    """Whether the screen's calibration was measured, and fits what the panel says of its size.

    Args:
        rig: The rig file.
        extent: Sides of the sensing area along the screen's x and y, m, if the panel tells.
    """
    what = "touch calibration"
    known = rig.screen().calibration
    if known is None:
        size = f"{_area(extent)} that the panel says" if extent else _area(_nominal())
        return warned(what, f"never measured; square, centred, {size}: assumed", CALIBRATE)
    mounting = Mounting.of(known)
    width, height = mounting.size
    sides = (height, width) if mounting.swapped else (width, height)
    seen = _source(rig)
    if extent and any(abs(a / b - 1) > ALIKE for a, b in zip(sides, extent, strict=True)):
        differ = f"{seen}: the sensing area is {_area(sides)}, but the panel says {_area(extent)}"
        return warned(what, differ, f"is it of another panel? {CALIBRATE}")
    return passed(what, f"{seen}: the sensing area is {_area(sides)}")


def _source(rig: RigFile) -> str:
    file = rig.touch.calibration_file
    if file is None:
        return "in the rig file"
    made = read_calibration(Path(file))[1]
    number, rms, date = (made.get(name, "unknown") for name in ("points", "rms_mm", "date"))
    return f"{Path(file).name}, made {date}, {number} points, {rms} mm RMS"


def _nominal() -> tuple[float, float]:
    return Mounting.of(Calibration.nominal()).size


def _area(sides: tuple[float, float]) -> str:
    return f"{100 * sides[0]:.1f} x {100 * sides[1]:.1f} cm"
