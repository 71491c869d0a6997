"""Warnings of a scenario before it runs: of its loop, its delays, its dither and its path."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter
from twin.base.shipped import shipped_in

if TYPE_CHECKING:
    from twin.scenario.schema import Scenario


UNSTABLE_ADVICE = (
    "; with these gains the ball may be lost: `ballplate run cure{on}{more}` has a law that knows "
    "how late the plate is, and `ballplate tune {law}{on}` searches other gains"
)
LATER_WARNING = (
    "drives and dead time are {:.0f} ms later than rig.plate_lag and predictor.delay say",
    30,
)
EARLIER_WARNING = "the dead time is {:.0f} ms shorter than predictor.delay", 15
"""How a rig may differ from what the cure assumes, and from how many ms on its error may double."""


def warn_of_dangers(scenario: Scenario, reporter: Reporter, label: str = "") -> None:
    """Warn of an unstable loop, a slow observer, a dither or a delay that is too large.

    Args:
        scenario: What is to run.
        reporter: Receives progress and warnings.
        label: Which of several runs it is.
    """
    from controllers.analysis import instability, slow_observer
    from controllers.ballplate import LONGEST_LAG
    from twin.run.controller_building import build_controller, own_errors

    with own_errors():
        controller = build_controller(scenario)
    (late, lag), knows = scenario.lateness, scenario.predictor
    assumed = scenario.rig.plate_lag
    unstable = instability(controller.law, controller.observer, dead_time=late, lag=lag)
    if unstable and (law := scenario.controller.kind) in shipped_in("tunes"):
        untold = lag > LONGEST_LAG and not assumed
        more = f" --set rig.plate_lag={lag:.2g}" if untold else ""
        unstable += UNSTABLE_ADVICE.format(law=law, on=_option_of_rig(scenario), more=more)
    dangers = [unstable]
    dangers.append(slow_observer(controller.law, controller.observer))
    dangers.append(weakened_dither(controller.law, scenario))
    dead = scenario.sensors.touch.dead_time - (knows.delay if knows else 0.0)
    encoders = getattr(scenario.observer, "plate", "") != "modelled"
    unknown = lag - assumed if assumed or not encoders else max(0.0, lag - LONGEST_LAG)
    drives = scenario.plant.servo.dead_time  # no assumed value contains it where there are encoders
    dead, unknown = (dead, unknown + drives) if encoders else (dead + drives, unknown)
    for (message, most), by in (
        (LATER_WARNING, 1000 * (dead + unknown)),
        (EARLIER_WARNING, -1000 * dead),
    ):
        if scenario.controller.kind == "stable_inversion" and by > most:
            dangers.append(f"{message.format(by)}: above {most} ms the cure may err twice as much")
    for danger in dangers:
        if danger:
            reporter.warn(f"{label}: {danger}" if label else danger)


def _option_of_rig(scenario: Scenario) -> str:
    """The options by which a command runs on the rig of a scenario; empty of the thesis's rig."""
    from twin.identify import logs
    from twin.scenario.rig_tables import PlantTable

    plant, usual = (each.model_dump(mode="json") for each in (scenario.plant, PlantTable()))
    if name := logs.rig_of({"plant": plant}):
        return f" --on {name}"
    others = (key for key in ("axes", "size") if plant[key] != usual[key])
    values = {key: json.dumps(plant[key], separators=(",", ":")) for key in others}
    return "".join(f" --set plant.{key}={value}" for key, value in values.items())


def weakened_dither(law: Any, scenario: Scenario) -> str:
    """Whether a dither needs more than the commands' limits, as one line; empty if not.

    Drives with a lag T are commanded sqrt(1 + (w T)^2) times the circle of the plate.
    """
    law, limits = getattr(law, "law", law), scenario.rig.limits
    w = 2 * math.pi * getattr(law, "dither_hz", 0.0)
    swing = getattr(law, "dither_deg", 0.0) * math.hypot(1, w * scenario.rig.plate_lag)
    rate, acceleration = swing * w, math.radians(swing) * w**2
    if rate <= limits.rate_deg and acceleration <= limits.acceleration:
        return ""
    return (
        f"controller.dither_deg: needs {rate:.3g} deg/s and {acceleration:.3g} rad/s^2 at "
        f"dither_hz = {law.dither_hz:g}; rig.limits allows {limits.rate_deg:g} and "
        f"{limits.acceleration:g}, so the plate swings less"
    )


def warn_of_path(scenario: Scenario, reporter: Reporter, label: str = "") -> None:
    """Warn of a reference that the plate cannot give, or that is to leave it after the run.

    Args:
        scenario: What is to run.
        reporter: Receives progress and warnings.
        label: Which of several runs it is.
    """
    from twin.run.reach import beyond_area, out_of_reach

    for line in (beyond_area(scenario), out_of_reach(scenario)):
        if line:
            reporter.warn(f"{label}: {line}" if label else line)
