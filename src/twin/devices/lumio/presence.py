"""Whether the ball is there, judged by the age of what is known of it."""

from __future__ import annotations

from enum import StrEnum

from twin.devices.lumio.conditions import BALL_LOST, FROZEN, STALE
from twin.devices.lumio.gate import Gate, Sample
from twin.devices.lumio.tracker import Tell


class TouchState(StrEnum):
    """What is known of the ball.

    TOUCHING: reported a moment ago. LIFTED: a lift-off was reported. STALE: reports have ceased
    without a lift-off. LOST: for too long either way, or never seen.
    """

    TOUCHING = "touching"
    LIFTED = "lifted"
    STALE = "stale"
    LOST = "lost"


def state(gate: Gate, sample: Sample | None, time: float, silent: bool = False) -> TouchState:
    """What is known of the ball at a time.

    Args:
        gate: The limits.
        sample: The newest position.
        time: Now, on the clock of the sample, s.
        silent: Whether a ball at rest sends nothing, so that silence says nothing.
    """
    if sample is None:
        return TouchState.LOST
    age = time - sample.time
    if silent and not sample.lifted:
        return TouchState.TOUCHING
    if age > gate.lost:
        return TouchState.LOST
    if sample.lifted:
        return TouchState.LIFTED
    return TouchState.STALE if age > gate.stale else TouchState.TOUCHING


class Presence:
    """Notices, from one look to the next, that a ball was lost or does not obey the tilt.

    Args:
        gate: The limits.
        tell: Called with each condition detected and its detail.
    """

    def __init__(self, gate: Gate, tell: Tell) -> None:
        self._gate = gate
        self._tell = tell
        self.forget()

    def forget(self) -> None:
        """Start anew, as before the first touch."""
        self._state = TouchState.LOST
        self._tilted: float | None = None
        self._frozen = False

    def look(self, sample: Sample | None, time: float, silent: bool = False) -> None:
        """Compare with the last look."""
        before, self._state = self._state, state(self._gate, sample, time, silent)
        if sample is None or self._state == before:
            return
        end = "after a lift-off" if sample.lifted else "without a lift-off"
        detail = f"no touch for {1000 * (time - sample.time):.0f} ms {end}"
        if self._state == TouchState.STALE:
            self._tell(STALE, detail)
        elif self._state == TouchState.LOST:
            self._tell(BALL_LOST, detail)

    def lean(self, sample: Sample | None, time: float, tilt: float) -> None:
        """Take in the plate's tilt, the larger of both angles, rad: no ball rests on a steep plate.

        What keeps reporting one and the same position there is a frozen touch.
        """
        if tilt <= self._gate.tilt or self._state != TouchState.TOUCHING or sample is None:
            self._tilted = None
            return
        self._tilted = time if self._tilted is None else self._tilted
        rest = time - max(self._tilted, sample.since)
        if rest <= self._gate.rest:
            self._frozen = False
        elif not self._frozen:
            self._frozen = True
            self._tell(FROZEN, f"no motion in {rest:.2f} s on a plate tilted by {tilt:.3f} rad")
