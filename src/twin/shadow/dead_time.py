"""A sequential test for the dead time alone.

A screen that answers 5 ms later moves the ball's samples by less than a millimetre, now here, now
there, but does so in every window: many small signs, of which none may count for much. The test of
all causes trusts a single window more, and so has to leave much room for what differs from window
to window where the ball stops; little of the dead time is left to see there. Here each window is
trusted with little, also where it and others would add up to much, which bounds the outliers of
stopping balls, and the room is smaller.
"""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.shadow.belief import CHANGING, PARAMETERS, STOPPING, Belief
from twin.shadow.evidence import Evidence
from twin.shadow.monitor import added_up, bounded

CAUSE = ("dead time",)
LATE = PARAMETERS.index("delay")
ALONE = 0.5
"""Log-likelihood ratio that one window alone may speak for a change of the dead time,"""
ADDED = 1.8
"""and on top of what the windows before it have said."""
ROOM = 0.2
"""Share of what else is expected to differ between windows in which the ball stops."""
THRESHOLD = 3.4
"""Log-likelihood ratio at which this test raises an alarm."""


def limited(evidence: Evidence, belief: Belief, after: int = 0) -> Evidence:
    """The windows that show the dead time, each weakened to what one may say for a change of it.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
        after: Windows that are left out.
    """
    rolling = np.array([CHANGING[name] for name in PARAMETERS])
    stopping = np.maximum(rolling, [ROOM * STOPPING[name] for name in PARAMETERS])
    room = np.hypot(belief.unit * np.stack((rolling, stopping)), belief.uneven)
    shows = evidence.information[:, LATE, LATE] > 0
    narrow = evidence.take(shows).softened(room)
    return bounded(narrow, belief, int(shows[:after].sum()), CAUSE, ALONE)


def delayed(evidence: Evidence, belief: Belief, after: int = 0) -> Array:
    """After each window the largest log-likelihood ratio of another dead time so far, shape (W,).

    Args:
        evidence: Windows in the order of time, ``limited``.
        belief: The twin.
        after: Windows for which it is not worked out, but left at zero.
    """
    return added_up(evidence, belief, after, CAUSE, ADDED)


def standing(evidence: Evidence, ratio: Array, time: Array) -> Array:
    """The statistic as it stands at some times, shape (T,).

    Args:
        evidence: Windows of the test, in the order of time.
        ratio: The statistic after each, shape (W,).
        time: Seconds, shape (T,).
    """
    windows = np.searchsorted(evidence.end, time, side="right")
    return np.asarray(np.concatenate((np.zeros(1), ratio))[windows])
