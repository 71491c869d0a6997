"""The ball of a log as a person states it: the share of gravity that accelerates it, its height."""

from __future__ import annotations

from twin.base.errors import LogError

GRAVITY_SHARES = {"hollow": 3 / 5, "solid": 5 / 7}
"""Share of gravity that accelerates a ball which rolls."""
BALL_HEIGHT_RANGE_M = -0.3, 0.5
"""Least and largest height in m of a ball's centre above the plate's axis."""


def ball_factor(text: str | float) -> float:
    """Share of gravity that accelerates a ball: of ``hollow``, ``solid``, or a number.

    Raises:
        LogError: If it is neither, or no ball has it.
    """
    try:
        factor = GRAVITY_SHARES.get(str(text)) or float(text)
    except ValueError:
        factor = 0.0
    if not 0.5 <= factor <= 1.0:
        raise LogError(f"--ball {text}: give hollow (3/5), solid (5/7) or a share from 0.5 to 1")
    return factor


def ball_inertia(mass: float, radius: float, factor: float) -> float:
    """Moment of inertia in kg m^2 of a ball of which gravity accelerates a share when it rolls.

    Args:
        mass: kg.
        radius: m.
        factor: The share.
    """
    return mass * radius**2 * (1 / factor - 1)


def ball_heights(text: str | float, option: str) -> tuple[float, float]:
    """Heights of a ball's centre above the plate's axis along x and y, m: one for both, or two.

    Args:
        text: A number, or two with a comma between.
        option: What a message calls it.

    Raises:
        LogError: If they are no such heights.
    """
    try:
        heights = [float(part) for part in str(text).split(",")]
    except ValueError:
        heights = []
    if len(heights) not in (1, 2) or not all(
        BALL_HEIGHT_RANGE_M[0] <= each <= BALL_HEIGHT_RANGE_M[1] for each in heights
    ):
        raise LogError(
            f"{option}: {text}: give metres from the axis about which the plate tilts up to the "
            f"ball's centre, {BALL_HEIGHT_RANGE_M[0]:g} to {BALL_HEIGHT_RANGE_M[1]:g}, "
            "or two of them, along x and y: X,Y"
        )
    return heights[0], heights[-1]
