"""What of a simulated rig changes while it runs: at a time, at once or along a ramp."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from twin.scenario.tables import Section

RAMPS = (
    "plant.friction.rolling_mm",
    "plant.friction.breakaway_ratio",
    "plant.friction.stribeck_speed",
    "plant.friction.dwell_time",
    "plant.friction.viscous_mm",
    "plant.level_deg",
    "plant.servo.bandwidth_hz",
    "plant.servo.backlash_deg",
    "plant.servo.hysteresis_deg",
    "plant.servo.resonance_hz",
    "plant.servo.resonance_damping",
    "plant.servo.vibration",
    "disturbance.variance",
    "sensors.touch.dead_time",
    "sensors.touch.variance",
    "sensors.encoders.variance",
    "rig.cam_error_percent",
    "rig.cam_coupling_percent",
)
"""What may change at once or along a ramp."""
JUMPS = (
    "plant.ball.mass",
    "plant.ball.inertia",
    "plant.friction.sliding",
    "plant.friction.spinning_mm",
    "plant.servo.torque_limit",
    "plant.servo.speed_limit",
    "plant.surface.spread_percent",
    "plant.surface.slope_deg",
    "plant.surface.patch_mm",
    "plant.surface.seed",
    "plant.surface.relative",
    "plant.surface.height_um",
)
"""What changes at once: another ball of the same size, another screen, other drives."""
FOLLOWED = 0.02
"""Time in s in whose steps a ramp is followed."""
SLACK = 1e-9
"""Times in s that are no further apart are one."""


class Change(Section):
    """One change of the plant, its drives or its sensors while they run."""

    at: Annotated[float, Field(ge=0)]
    """When it begins, time of the run in s; before the first period there is none."""
    over: Annotated[float, Field(ge=0)] = 0.0
    """How long the way to the new values takes, in s; 0 for at once."""
    set: Annotated[dict[str, Any], Field(min_length=1)]
    """The new values, each under its quoted key, as "plant.friction.rolling_mm"."""

    @property
    def end(self) -> float:
        """When the new values are reached, s."""
        return self.at + self.over

    def times(self) -> Iterator[float]:
        """When something has to be done for it, s."""
        for step in range(int((self.over - SLACK) / FOLLOWED) + 1 if self.over else 0):
            yield self.at + step * FOLLOWED
        yield self.end

    def problem(self) -> str:
        """What no plant can do of it, in one line; empty if all can be done."""
        for key in self.set:
            if key not in RAMPS + JUMPS:
                return (
                    f"{key}: cannot change while a plant runs (what can: "
                    f"{', '.join(RAMPS + JUMPS)})"
                )
            if self.over and key in JUMPS:
                return f"{key}: changes at once; leave out over = {self.over:g}"
        return ""
