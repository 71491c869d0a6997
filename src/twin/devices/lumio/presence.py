"""Whether the ball is on the screen, judged by the age of its newest position."""

from __future__ import annotations

from enum import StrEnum

from twin.devices.lumio.conditions import BALL_LOST, FROZEN, STALE
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.lumio.tracking import ReportFault, Sample


class TouchState(StrEnum):
    """What is known of the ball.

    TOUCHING: reported a moment ago. LIFTED: a lift-off was reported. STALE: reports have ceased
    without a lift-off. LOST: for too long either way, or never seen.
    """

    TOUCHING = "touching"
    LIFTED = "lifted"
    STALE = "stale"
    LOST = "lost"


def touch_state(limits: PlausibilityLimits, sample: Sample | None, time: float) -> TouchState:
    """What is known of the ball at a time.

    Args:
        limits: What is plausible.
        sample: The newest position.
        time: Now, on the clock of the sample, s.
    """
    if sample is None:
        return TouchState.LOST
    age = time - sample.time
    if age > limits.lost:
        return TouchState.LOST
    if sample.lifted:
        return TouchState.LIFTED
    return TouchState.STALE if age > limits.stale else TouchState.TOUCHING


class Presence:
    """Notices, from one update to the next, that a ball was lost or does not obey the tilt.

    Args:
        limits: What is plausible.
        report_fault: Called with each condition detected.
    """

    def __init__(self, limits: PlausibilityLimits, report_fault: ReportFault) -> None:
        self._limits = limits
        self._report_fault = report_fault
        self.forget()

    def forget(self) -> None:
        """Start again, as before the first touch."""
        self._state = TouchState.LOST
        self._tilted: float | None = None
        self._frozen = False

    def update(self, sample: Sample | None, time: float) -> None:
        """Compare with the last update."""
        before, self._state = self._state, touch_state(self._limits, sample, time)
        if sample is None or self._state == before:
            return
        end = "after a lift-off" if sample.lifted else "without a lift-off"
        detail = f"no touch for {1000 * (time - sample.time):.0f} ms {end}"
        if self._state == TouchState.STALE:
            self._report_fault(STALE, detail)
        elif self._state == TouchState.LOST:
            self._report_fault(BALL_LOST, detail)

    def note_tilt(self, sample: Sample | None, time: float, tilt: float) -> None:
        """Take in the plate's tilt, the larger of both angles, rad: no ball rests on a steep plate.

        What keeps reporting one and the same position there is a frozen touch.
        """
        if tilt <= self._limits.tilt or self._state != TouchState.TOUCHING or sample is None:
            self._tilted = None
            return
        self._tilted = time if self._tilted is None else self._tilted
        rest = time - max(self._tilted, sample.since)
        if rest <= self._limits.rest:
            self._frozen = False
        elif not self._frozen:
            self._frozen = True
            self._report_fault(
                FROZEN, f"no motion in {rest:.2f} s on a plate tilted by {tilt:.3f} rad"
            )
