"""What is plausible of a ball on the screen, and what is known of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True, kw_only=True)
class Gate:
    """What is plausible.

    Attributes:
        speed: Fastest ball, m/s; a run down the whole plate at 10 deg ends at 1.2 m/s.
        slack: Jitter of a position, m.
        confirm: Reports in a row, consistent with each other, that make a ball believed: at the
            start, and where it has jumped.
        stale: Seconds without a report after which a touching ball's position is stale; a resting
            ball is reported every 17 ms, with gaps of up to 47 ms in recordings.
        lost: Seconds without an accepted position after which the ball counts as lost.
        halt: Speed in m/s from which no ball stops dead.
        still: Reports without any motion after a ball was faster than that, which tell that the
            touch is frozen.
        tilt: Plate angle in rad on which no ball rests.
        rest: Seconds of rest on a plate tilted further than that, which tell the same.
    """

    speed: float = 1.5
    slack: float = 0.006
    confirm: int = 3
    stale: float = 0.06
    lost: float = 0.1
    halt: float = 0.08
    still: int = 4
    tilt: float = math.radians(2)
    rest: float = 0.3


class Sample(NamedTuple):
    """The newest accepted position.

    Attributes:
        time: When it arrived.
        position: Where, m in plate axes.
        lifted: Whether a lift-off has been reported since.
        since: Since when the position has not changed at all.
    """

    time: float
    position: tuple[float, float]
    lifted: bool
    since: float
