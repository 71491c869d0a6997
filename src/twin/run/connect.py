"""From a rig file to a rig: the real one, or whatever speaks its bytes."""

from __future__ import annotations

from math import radians
from pathlib import Path
from typing import Any

import numpy as np

from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.screen import LumioScreen
from twin.devices.realtime import RealTimeClock
from twin.devices.rig import HardwareRig
from twin.hal.cams import CamTable
from twin.hal.interface import Limits, Transmission
from twin.run.assemble import build_limits
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario


def connect(
    scenario: Scenario,
    rig: RigFile,
    *,
    reset: bool = False,
    transmission: Transmission | None = None,
) -> HardwareRig:
    """The rig of a file, to run a scenario's controller on; nothing is opened yet.

    Args:
        scenario: Period and limits.
        rig: What is connected where.
        reset: Whether faults found in the drives are reset when they are switched on.
        transmission: Of a virtual rig that has another; that of the rig file by default.

    Raises:
        TwinError: If the settings do not go together.
    """
    period = scenario.rig.period
    return HardwareRig(
        servos=AkdServos(rig.servos(period)),
        screen=LumioScreen(rig.screen()),
        clock=RealTimeClock(period, allowed=rig.late_periods),
        transmission=transmission or cams_of(rig),
        limits=narrower(build_limits(scenario.rig.limits), build_limits(rig.limits)),
        home=(radians(rig.home_deg[0]), radians(rig.home_deg[1])),
        patience=rig.patience,
        reset=reset,
        relaxed=rig.relaxed(period),
    )


def cams_of(rig: RigFile) -> CamTable:
    """The cam table of a real rig: the one its file names, or the one of the packaged model.

    Raises:
        ModelError: If it cannot be used.
    """
    return CamTable.from_file(Path(rig.cams)) if rig.cams else CamTable.packaged()


def narrower(one: Limits, other: Limits) -> Limits:
    """Limits that keep both."""
    pairs = vars(other)
    kept: dict[str, Any] = {
        name: tuple(np.minimum(value, pairs[name]).tolist())
        if name == "area"
        else min(value, pairs[name])
        for name, value in vars(one).items()
    }
    return Limits(**kept)
