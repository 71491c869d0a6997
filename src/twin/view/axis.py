"""What the axis of a plot shows: from one round number to another."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from twin.view.signals import Signal

ROOM = 0.01
"""Room above and below the lines of a plot, at least, as a share of its height."""
STEPS = (1.0, 2.0, 5.0, 10.0)
"""A plot begins and ends at multiples of one of these, times a power of ten."""
FINE = 20
"""Such steps in the height of a plot, about."""
LEAST = 0.05
"""Least half of the height of a plot, in its unit."""


def shown_range(plots: Sequence[Mapping[str, Signal]]) -> tuple[float, float]:
    """What the axis of a plot of one or several runs shows: its lines, but not their limits.

    It begins and ends at round numbers, because the viewer labels powers of ten and their multiples
    only, of which a low plot has one or none. Of several runs the tracking error is drawn as a
    distance alone.
    """
    lines = [
        signal.values[np.isfinite(signal.values)]
        for plot in plots
        for name, signal in plot.items()
        if not name.startswith("limit")
        and not (len(plots) > 1 and "distance" in plot and name != "distance")
    ]
    values = np.concatenate([*lines, np.empty(0)])
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    margin = max(ROOM * (high - low), LEAST - (high - low) / 2)
    low, high = low - margin, high + margin
    power = 10.0 ** math.floor(math.log10((high - low) / FINE))
    step = next(power * each for each in STEPS if power * each * FINE >= (high - low) * (1 - 1e-9))
    places = max(0, -math.floor(math.log10(step * (1 + 1e-9))))
    return (
        round(step * math.floor(low / step + 1e-9), places),
        round(step * math.ceil(high / step - 1e-9), places),
    )
