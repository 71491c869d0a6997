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
from twin.hal.limits import Limits
from twin.run.assemble import build_limits, build_plant
from twin.scenario.rig import RigFile
from twin.scenario.schema import Scenario


def connect(scenario: Scenario, rig: RigFile, *, reset: bool = False) -> HardwareRig:
    """The rig of a file, to run a scenario's controller on; nothing is opened yet.

    Args:
        scenario: Period, cams and limits.
        rig: What is connected where.
        reset: Whether faults found in the drives are reset when they are switched on.

    Raises:
        TwinError: If the settings do not go together.
    """
    period = scenario.rig.period
    return HardwareRig(
        servos=AkdServos(rig.servos(period)),
        screen=LumioScreen(rig.screen()),
        clock=RealTimeClock(period, allowed=rig.late_periods),
        transmission=CamTable.from_file(Path(rig.cams)) if rig.cams else build_plant(scenario)[1],
        limits=narrower(build_limits(scenario.rig.limits), build_limits(rig.limits)),
        home=(radians(rig.home_deg[0]), radians(rig.home_deg[1])),
        patience=rig.patience,
        reset=reset,
    )


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
