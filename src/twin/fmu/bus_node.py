"""An emulated drive as an FMU that is a node of a simulated CAN bus, as FMI-LS-BUS 1.0 has it.

Low cut: frames go over the bus as operations in bytes. The objects are those of ``emulator``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.base.data_file import read_packaged
from twin.base.errors import TwinError, nearest
from twin.base.page import render_template
from twin.emulator import drive
from twin.emulator.drive_objects import AKD_MODES, PDO_ENTRIES, drive_objects, emergency_code
from twin.fmu.export import (
    TEMPLATE_FOLDER,
    Bus,
    Variable,
    add_token,
    read_sources,
    write_fmu,
)
from twin.sim.sensors import ENCODER_COUNTS_PER_TURN

DRIVE_KINDS = ("akd",)
"""Drives that can be exported."""
MIME_TYPE = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
"""Type of the operations of a CAN bus."""
CAN_BUS = Bus("can", MIME_TYPE, 8192)
"""The bus of a drive; ``OPERATION_BYTES`` of the C source is its largest size."""
DESCRIPTION = "AKD-like CiA 402 drive on CANopen, a node of a simulated CAN bus (FMI-LS-BUS 1.0)."
"""Description of the FMU."""
STEP_S = 0.001
"""Communication step in s that the description proposes: an answer is one step delayed."""
DURATION_S = 1.0
"""Simulated time in s that the description proposes."""
NODE_SOURCES = (
    *("fmi.h", "fmi3.h", "fmi3_absent.c"),
    *("can_bus.h", "can_bus.c", "drive.h", "drive.c", "bus_node.c"),
)
"""The C source that no template makes."""
ACCESS_NAMES = {
    "const": "READ_ONLY_ACCESS",
    "ro": "READ_ONLY_ACCESS",
    "rw": "WRITE_ACCESS",
    "rww": "PDO_WRITE_ACCESS",
}
"""What the C source calls the access of an object."""
FAULT_NUMBERS = (129, 247, 502, 602)
"""Faults that the node can have: a silent master, no voltage, lost voltage, open STO."""
UNKNOWN_FAULT = 0
"""Number that no fault has: all faults without an emergency code of their own use its code."""
MANIFEST_FOLDER = "extra/org.fmi-standard.fmi-ls-bus"
"""Where an importer sees that an FMU is a node or a bus."""


def export_drive(path: Path, kind: str) -> str:
    """Write an emulated drive as an FMU of FMI 3.0 that is a node of a simulated CAN bus.

    Args:
        path: The file.
        kind: One of `DRIVE_KINDS`.

    Returns:
        Why there is no binary in it, in words; empty if there is one.

    Raises:
        TwinError: If there is no such kind of drive, or the file cannot be written.
    """
    if kind not in DRIVE_KINDS:
        raise TwinError(f"{kind}: no drive that can be exported{nearest(kind, DRIVE_KINDS)}")
    variables = [Variable(**each) for each in read_packaged("twin.fmu", "drive.toml")["variable"]]
    terminals = render_template(TEMPLATE_FOLDER / "terminalsAndIcons.xml.j2", bus=CAN_BUS)
    manifest = (TEMPLATE_FOLDER / "bus-manifest.xml").read_text(encoding="utf-8")
    more = {
        "terminalsAndIcons/terminalsAndIcons.xml": terminals,
        f"{MANIFEST_FOLDER}/fmi-ls-manifest.xml": manifest,
    }
    return write_fmu(
        path,
        variables,
        *make_sources(variables),
        more,
        fmi=3,
        bus=CAN_BUS,
        description=DESCRIPTION,
        independent=(),
        step=STEP_S,
        duration=DURATION_S,
    )


def make_sources(variables: Sequence[Variable]) -> tuple[dict[str, str], str]:
    """The C source of the node by the names of its files, and its token, a hash of it.

    Args:
        variables: In the order of their value references.
    """
    return add_token(read_sources(*NODE_SOURCES) | _object_sources(), variables)


def _object_sources() -> dict[str, str]:
    """The two files with the objects and constants of the emulated drive, by name."""
    plain, of_node_1 = drive_objects(0), drive_objects(1)
    given: dict[str, Any] = {
        "access": ACCESS_NAMES,
        "objects": [
            (key, plain[key], plain[key].default != of_node_1[key].default) for key in sorted(plain)
        ],
        "emergencies": [(number, emergency_code(number)) for number in FAULT_NUMBERS],
        "other_emergency": emergency_code(UNKNOWN_FAULT),
        "pdo_entries": PDO_ENTRIES,
        "modes": sum(1 << mode + 3 for mode in AKD_MODES),
        "constants": {
            "RPM": drive.RPM,
            "TURN_RAD": drive.TURN_RAD,
            "VELOCITY_UNIT": drive.VELOCITY_UNIT,
            "STOP_RAMP": drive.STOP_RAMP,
            "PLATE_PER_MOTOR": drive.PLATE_PER_MOTOR,
            "MOTOR_COUNTS": float(drive.MOTOR_COUNTS),
            "PLATE_COUNTS": float(ENCODER_COUNTS_PER_TURN),
        },
    }
    names = ("drive_objects.h", "drive_objects.c")
    return {name: render_template(TEMPLATE_FOLDER / f"{name}.j2", **given) for name in names}
