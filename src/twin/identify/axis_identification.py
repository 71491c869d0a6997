"""What logs of any rig give: parameters, predictions, and the settings of a scenario."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from controllers.ballplate import BallPlate, corner_frequency
from twin.identify.suspicions import AXIS_SIGNS
from twin.identify.verdicts import GIVEN_VERDICT, Identification

MAX_SCALE_ERROR = 0.2
"""Largest error of the tilt per command that `rig.cam_error_percent` takes, as a share."""


@dataclass(frozen=True, kw_only=True)
class AxisIdentification(Identification):
    """Parameters and predictions that logs of any rig give.

    Attributes:
        factor: Share of gravity that accelerates the ball.
        ball: The ball of the rig; its radius scales the friction.
        height: Of the plate's surface above its axes, m, where it is taken from the levers that the
            log shows; None for that of the rig, or the one that was given.
    """

    factor: float
    ball: BallPlate
    height: float | None = None

    def settings(self, words: Collection[str]) -> dict[str, str]:
        """Scenario keys and their values in TOML, of the parameters with one of these verdicts.

        Friction, dead time and lag are the mean of the axes; a scenario has one of each. Dead time
        and lag are included as well where only their sum has such a verdict.
        """
        known: dict[str, dict[str, float]] = {}
        accepted = {each.name: each.word in words for each in self.verdicts}
        for each in self.verdicts:
            name, _, axis = each.name.rpartition("_")
            summed = name in {"dead_time", "lag"} and accepted.get(f"delay_{axis}")
            if (accepted[each.name] or summed) and each.value is not None:
                known.setdefault(name, {})[axis] = each.value
        mean = {name: float(np.mean(list(values.values()))) for name, values in known.items()}
        ball = self.ball
        push = self.factor * ball.gravity
        inertia = ball.mass * ball.radius**2 * (1 / self.factor - 1)
        lines = {f"plant.ball.{name}": str(getattr(ball, name)) for name in ("mass", "radius")}
        lines |= self.over
        given = [each.value or 0.0 for each in self.verdicts if each.word == GIVEN_VERDICT]
        height, how = self.height, "as the log shows it"
        if given:
            height, how = float(np.mean(given)) - ball.radius / self.factor, "as given"
        if height is not None and height >= 0:  # laws take no surface below the axes
            lines["plant.plate.height"] = f"{height:.6g}  # of the surface, {how}"
        lines["plant.ball.inertia"] = f"{inertia:.6g}  # takes {self.factor:.3g} of gravity"
        gain = known.get("gain", {})
        turned = [gain.get(axis, sign * push) * sign / push for axis, sign in AXIS_SIGNS.items()]
        if gain and not any(map(is_other_scale, turned)):
            errors = ", ".join(f"{100 * (each - 1):z.6g}" for each in turned)
            lines["rig.cam_error_percent"] = f"[{errors}]  # how much too far a command tilts"
        if "friction" in mean:
            rolling = 1000 * mean["friction"] * ball.radius / push
            lines["plant.friction.rolling_mm"] = f"{rolling:.6g}  # for this ball's radius"
        if mean.get("dead_time", 0.0) > 0:
            dead_time = f"{mean['dead_time']:.6g}"
            lines["sensors.touch.dead_time"] = f"{dead_time}  # all of it, commands' too"
            lines["predictor.delay"] = dead_time
        if "lag" in mean:
            alone = any(accepted.get(f"lag_{axis}") for axis in "xy")
            remark = (
                "of the drives or of a filter of the positions"
                if alone
                else "its sum with the dead time is known, neither by itself"
            )
            lines["rig.plate_lag"] = f"{mean['lag']:.6g}  # {remark}"
            lines["plant.servo.bandwidth_hz"] = f"{corner_frequency(mean['lag']):.6g}"
        if camber := known.get("camber"):
            bends = ", ".join(f"{camber.get(axis, 0.0):z.6g}" for axis in "xy")
            lines["plant.camber"] = f"[{bends}]"
        if level := known.get("level"):
            tilts = [
                math.degrees(sign * level.get(axis, 0.0) / push)
                for axis, sign in AXIS_SIGNS.items()
            ]
            lines["plant.level_deg"] = f"[{tilts[0]:z.6g}, {tilts[1]:z.6g}]"
        return lines


def is_other_scale(turned: float) -> bool:
    """Whether a tilt per command is beyond what `rig.cam_error_percent` takes."""
    return abs(turned - 1) > MAX_SCALE_ERROR
