"""A mistake: the right dead time, and an observer so slow that nothing disturbs it.

# fails: a level that changes under way
"""

from pathlib import Path


def answer(rig: dict[str, float], folder: Path) -> dict[str, object]:
    """The rig's dead time, and poles a fifth of the default."""
    delay = rig["sensors.touch.dead_time"]
    return {"predictor": {"delay": delay}, "observer": {"poles": [-1.6, -2.0, -2.8, -3.2]}}
