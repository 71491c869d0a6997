"""What a rig does when a fault is made: it tracks a circle."""

from __future__ import annotations

from twin.scenario.load import check
from twin.scenario.schema import Scenario


def tracking(duration: float, *, resting: bool) -> Scenario:
    """The circle, quickly under way, on the exact plant, with friction.

    Args:
        duration: In s.
        resting: Whether the ball is held in the middle instead.
    """
    circle = {"kind": "circle", "amplitude": 0.1, "omega": 1.5, "start": 1.0}
    return check(
        {
            "title": "fault matrix",
            "duration": duration,
            "seed": 1,
            "plant": {"kind": "lagrange", "friction": {"rolling_mm": 0.1765}},
            "controller": {"kind": "afl"},
            "predictor": {},
            "reference": {"kind": "hold"} if resting else circle,
        },
        "fault matrix",
    )
