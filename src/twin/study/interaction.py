"""Whether the effect of one parameter depends on another: the interaction plot."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.run.overview_plot import COLOURS

BINS = 5
"""Intervals of the first parameter, with equally many runs in each."""
THIRDS = ("low", "middle", "high")


class InteractionLine(NamedTuple):
    """The mean of a metric over one parameter, for a third of the runs by another one.

    Attributes:
        x: Mean of the parameter in each interval, shape (bins,).
        mean: Mean of the metric there, NaN where there are under two runs, shape (bins,).
        error: Standard error of that mean, shape (bins,).
    """

    x: Array
    mean: Array
    error: Array


def lines(first: Array, second: Array, values: Array) -> tuple[InteractionLine, ...]:
    """The metric over ``first`` for low, middle and high ``second``: parallel without interaction.

    Args:
        first: A parameter, one number per run, shape (K,).
        second: Another one, shape (K,).
        values: The metric, NaN for runs that failed, shape (K,).
    """
    good = np.isfinite(values)
    first, second, values = first[good], second[good], values[good]
    found = []
    for third in _split(second, len(THIRDS)):
        bins = [third[each] for each in _split(first[third], BINS)]
        x = np.array([first[each].mean() if len(each) else np.nan for each in bins])
        many = np.array([len(each) for each in bins])
        mean = np.array([values[each].mean() if len(each) > 1 else np.nan for each in bins])
        wide = np.array([values[each].std(ddof=1) if len(each) > 1 else np.nan for each in bins])
        found.append(InteractionLine(x, mean, wide / np.sqrt(np.maximum(many, 1))))
    return tuple(found)


def _split(numbers: Array, parts: int) -> list[NDArray[np.integer]]:
    """Indices of the numbers in ascending order, in parts of equal size."""
    return np.array_split(np.argsort(numbers, kind="stable"), parts)


def draw(panel: Axes, found: tuple[InteractionLine, ...], label: str | None) -> None:
    """Draw one variant's lines; named with the second parameter's label, if any."""
    for line, third, colour in zip(found, THIRDS, COLOURS, strict=False):
        panel.errorbar(
            line.x,
            line.mean,
            1.96 * line.error,
            marker="o",
            ms=3.5,
            lw=1.4,
            capsize=2,
            color=colour,
            label=f"{third} third of {label}" if label else None,
        )
