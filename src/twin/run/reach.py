"""References that the plate cannot give: beyond its area, or with too large accelerations."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from controllers.controller import HeldLaw
from controllers.stable_inversion import AboutMotion
from twin.run import controller_building
from twin.scenario.schema import Scenario, choices

MIN_MENTIONED_SPEED_M_S = 0.01
"""Speed in m/s at the start that is worth a word."""
MIN_WARNED_DISTANCE_M = 0.02
"""Distance in m of the path that a law lays from the reference that is worth a warning."""


def beyond_area(scenario: Scenario) -> str | None:
    """One line if a length of the reference is beyond the operating area; else None.

    A reference that reaches it within the run is refused by ``build_reference``; one that
    only ends earlier is not.
    """
    choice, axes = scenario.reference, scenario.plant.axes
    area = scenario.rig.limits.area[:axes]
    cls: Any = choices("reference")[choice.kind]
    for name in cls.lengths:
        length = choice.settings.get(name, getattr(cls, name, None))
        # a goal has its time first, and on one axis a y that is not used
        for place in np.atleast_2d(np.asarray(length, float))[:, -2:][:, :axes]:
            limits = area if len(place) == len(area) else max(area)
            if np.any(np.abs(place) > limits):
                stated, allowed = (
                    ", ".join(f"{each:g}" for each in some) for some in (place, area)
                )
                return (
                    f"reference.{name}: {stated} m is beyond rig.limits.area = {allowed} m; "
                    f"in {scenario.duration:g} s the reference does not get there"
                )
    return None


def out_of_reach(scenario: Scenario) -> str | None:
    """One line if the plate cannot give a scenario's reference, with the figures; else None.

    For a law that plans a path of its own: the distance of that path from the reference, if more
    than ``MIN_WARNED_DISTANCE_M``; for any other: the requested acceleration.

    Raises:
        ScenarioError: If law or reference refuse their settings.
    """
    reference, law = (
        controller_building.build_reference(scenario),
        controller_building.build_law(scenario),
    )
    period, start, limits = scenario.rig.period, scenario.plant.start, scenario.rig.limits
    if isinstance(law, HeldLaw):
        period, law = law.ticks * period, law.law
    count = math.ceil(scenario.duration / period)
    desired = reference(period * np.arange(count))
    asked, most = np.abs(desired[2]).max(), law.model.k1 * math.sin(math.radians(limits.angle_deg))
    if not isinstance(law, AboutMotion):
        beyond = f"up to {asked:.3g} m/s^2, a plate at {limits.angle_deg:g} deg gives {most:.3g}"
        return f"reference: it asks for {beyond}: no law can follow it" if asked > most else None
    x = np.zeros(8)
    x[0::4] = start.x, start.y
    laid = law.planned_path(x, reference, period, count)
    away = np.hypot(*(laid - desired[0]).T)
    far = 0.0 if np.isnan(away).all() else float(np.nanmax(away))
    if far < MIN_WARNED_DISTANCE_M:
        return None
    speed, why = np.abs(desired[1, 0]).max(), []
    if speed > MIN_MENTIONED_SPEED_M_S:
        why.append(f"{speed:.2g} m/s at the start, from rest")
    if asked > (given := law.model.k1 * law.slope):
        why.append(f"up to {asked:.3g} m/s^2, where {given:.2g} are planned with")
    asks = f" (it asks for {', and for '.join(why)})" if why else ""
    seconds = period * np.isfinite(away).sum()
    return (
        f"reference: the plate cannot give it{asks}: for {seconds:.2g} s the ball is led along "
        f"a different path, up to {1e3 * far:.0f} mm away"
    )
