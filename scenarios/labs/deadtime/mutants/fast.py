"""A mistake: the right dead time, and an observer as fast as without any.

# fails: the ball stays on the plate
"""

from pathlib import Path


def answer(rig: dict[str, float], folder: Path) -> dict[str, object]:
    """The rig's dead time, and the default poles."""
    delay = rig["sensors.touch.dead_time"]
    return {"predictor": {"delay": delay}, "observer": {"poles": [-8.0, -10.0, -14.0, -16.0]}}
