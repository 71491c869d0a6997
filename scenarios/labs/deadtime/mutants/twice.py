"""A mistake: the dead time is counted twice, there and back.

# fails: the circle is followed
"""

from pathlib import Path


def answer(rig: dict[str, float], folder: Path) -> dict[str, object]:
    """Twice the rig's dead time."""
    delay = 2 * rig["sensors.touch.dead_time"]
    return {"predictor": {"delay": delay}, "observer": {"poles": [-2.8, -3.5, -4.9, -5.6]}}
