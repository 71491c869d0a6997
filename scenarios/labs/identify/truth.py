"""What the log of a rig tells."""

from pathlib import Path


def breakaway_ratio(point: dict[str, float], folder: Path) -> float | str:
    """The ratio where the ball rested again and again; along the figure of eight it never did."""
    rests = point["reference.phase"] > 0
    return point["plant.friction.breakaway_ratio"] if rests else "not determined"
