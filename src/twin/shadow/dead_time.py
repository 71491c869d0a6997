"""A sequential test for the dead time alone.

A screen that answers 5 ms later moves the ball's samples by less than a millimetre, now here, now
there, but does so in every window: many small signs, of which none may count for much. The test of
all causes trusts a single window more, and so has to leave much room for what differs from window
to window where the ball stops; little of the dead time is left to see there. Here each window is
trusted with little, which bounds the outliers of stopping balls, and the room is smaller.
"""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from twin.shadow.belief import CHANGING, PARAMETERS, STOPPING, Belief
from twin.shadow.evidence import Evidence
from twin.shadow.monitor import bounded, statistic

CAUSE = ("dead time",)
AT_MOST = 1.0
"""Log-likelihood ratio that one window may speak for a change of the dead time."""
ROOM = 0.3
"""Share of what else is expected to differ between windows in which the ball stops."""
THRESHOLD = 4.5
"""Log-likelihood ratio at which this test raises an alarm."""


def narrowed(evidence: Evidence, belief: Belief) -> Evidence:
    """Windows as this test takes them.

    Args:
        evidence: Not softened.
        belief: The twin.
    """
    rolling = np.array([CHANGING[name] for name in PARAMETERS])
    stopping = np.maximum(rolling, [ROOM * STOPPING[name] for name in PARAMETERS])
    return evidence.softened(np.hypot(belief.unit * np.stack((rolling, stopping)), belief.uneven))


def limited(narrow: Evidence, belief: Belief, after: int = 0) -> Evidence:
    """The windows, each weakened to what one may say for a change of the dead time.

    Args:
        narrow: Windows in the order of time, ``narrowed``.
        belief: The twin.
        after: Windows that are left out.
    """
    return bounded(narrow, belief, after, CAUSE, AT_MOST)


def delayed(evidence: Evidence, belief: Belief, after: int = 0) -> Array:
    """After each window the largest log-likelihood ratio of another dead time so far, shape (W,).

    Args:
        evidence: Windows in the order of time, ``limited``.
        belief: The twin.
        after: Windows for which it is not worked out, but left at zero.
    """
    return statistic(evidence, belief, after, CAUSE)
