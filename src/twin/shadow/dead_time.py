"""A sequential test for the dead time alone.

A screen that answers 5 ms later moves the ball's samples by less than a millimetre, now here, now
there, but does so in every window: many small signs, of which none may count for much. The test of
all causes trusts a single window more, and so has to leave much room for what differs from window
to window where the ball stops; little of the dead time is left to see there. Here each window is
trusted with so little that it needs none.
"""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.shadow.belief import CHANGING, PARAMETERS, Belief
from twin.shadow.evidence import Evidence
from twin.shadow.monitor import LOOKBACKS, bounded, statistic

CAUSE = ("dead time",)
LATE = PARAMETERS.index("delay")
ALONE = 0.5
"""Log-likelihood ratio that one window alone may speak for a change of the dead time."""
THRESHOLD = 3.6
"""Log-likelihood ratio at which this test raises an alarm."""


def limited(evidence: Evidence, belief: Belief, after: int = 0) -> Evidence:
    """The windows that show the dead time, each weakened to what one may say for a change of it.

    Args:
        evidence: Windows in the order of time, not softened.
        belief: The twin.
        after: Windows that are left out.
    """
    rolling = belief.unit * np.array([CHANGING[name] for name in PARAMETERS])
    room = np.tile(np.hypot(rolling, belief.uneven), (2, 1))
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
    return statistic(evidence, belief, after, CAUSE, range(1, LOOKBACKS[-1] + 1))


def standing(evidence: Evidence, ratio: Array, time: Array) -> Array:
    """The statistic as it stands at some times, shape (T,).

    Args:
        evidence: Windows of the test, in the order of time.
        ratio: The statistic after each, shape (W,).
        time: Seconds, shape (T,).
    """
    windows = np.searchsorted(evidence.end, time, side="right")
    return np.asarray(np.concatenate((np.zeros(1), ratio))[windows])
