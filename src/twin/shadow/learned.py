"""How much a rig differs from one window to the next, learned while it is healthy.

A rig with much that its twin leaves out (uneven screen, play, a slow screen clock) scatters more
than the twin expects. What scatter there was up to some seconds ago widens what is expected now.
"""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.shadow.belief import PARAMETERS, Belief
from twin.shadow.evidence import Evidence

LATEST = 8.0
"""Seconds before a window that it learns nothing from, for a change may have begun in them."""
COUNTED = 4.0
"""What is expected of a rig of which nothing is known yet counts as so many windows:"""
FIRST = np.array([1.0 if name == "noise" else 1.5 for name in PARAMETERS])
"""a factor of three, but for what hardly differs from window to window on any rig."""
MOST = 10.0
"""Largest factor: a rig that is far from its twin is not one that scatters."""


def scatter(evidence: Evidence, belief: Belief) -> Array:
    """Factors on what the belief expects parameters to change by, shape (W, P).

    With d the deviation that a window alone would give a parameter, 1/a its variance and Q that
    which is expected from window to window, E (d - mean)^2 = 1/a + f^2 Q; windows count by how well
    they show Q.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
    """
    expected = belief.changing[evidence.stopping.astype(int)] ** 2
    a = np.diagonal(evidence.information, axis1=-2, axis2=-1)
    shows = a > 0
    own = 1 / np.where(shows, a, 1.0)
    sd = np.sqrt(own + expected)
    weight = np.where(shows, expected / sd**4, 0.0)
    d = evidence.score * own
    # what is far off all along does not scatter: of an outlier counts how far it is from the others
    usual = np.cumsum(weight * d, axis=0) / np.maximum(np.cumsum(weight, axis=0), 1e-300)
    d = np.clip(d, usual - MOST * sd, usual + MOST * sd)
    sums = [
        np.concatenate((np.zeros((1, a.shape[1])), np.cumsum(weight * each, axis=0)))
        for each in (np.ones_like(d), d, d**2 - own, expected)
    ]
    until = np.searchsorted(evidence.end, evidence.begin - LATEST)
    count, first, second, share = (each[until] for each in sums)
    spread = second - first**2 / np.maximum(count, 1e-300)
    squared = (COUNTED * FIRST**2 + spread) / (COUNTED + share)
    return np.asarray(np.sqrt(np.clip(squared, 1.0, MOST**2)))
