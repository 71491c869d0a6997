"""The scan time of a panel's reports: which are no new ones, and which come ever later.

A digitizer may say when it scanned the contacts of a report (HID Usage Tables, page 0Dh, usage
56h): a counter of 100 us that wraps, 16 bits as a rule, and begins anywhere, also anew after a
pause. A panel with a counter that stands still from the start, or that counts in a unit other than
the stated one, is no clock: its times are not used.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple


class ScanTime(NamedTuple):
    """When the contacts of a report were scanned.

    Attributes:
        time: By the panel's counter, s.
        wrap: After how many s that begins again.
    """

    time: float
    wrap: float


class ScanClock:
    """Compares the scan times of reports with each other and with their arrival.

    After a pause it knows nothing of what was before.

    Args:
        late: Seconds by which reports may arrive later after their scan than the promptest ones.
    """

    REPEATS = 3
    """Reports in a row, none of them new, that show that the scan time stands still."""
    PAUSE = 0.25
    """Pause in s between two reports after which nothing of before is known any more."""
    GAP = 0.06
    """Pause in s after which a counter may begin anew; else an earlier time is an old one."""
    LEARN = 1.0
    """Seconds of reports after which it is known whether a panel's counter keeps time; if not, it
    is found out anew."""
    DRIFT = 0.02
    """Share by which the second of a counter that keeps time may differ from the host's: what grows
    as slowly is not seen."""
    LASTING = 0.1
    """Seconds for which reports must be late."""

    def __init__(self, late: float) -> None:
        self.excess = 0.0
        """Seconds by which the newest report came later after its scan than the promptest ones."""
        self._late = late
        self._newest: ScanTime | None = None
        self._moves = False
        self._contacts: set[int] = set()
        self._repeats = 0
        self._arrived = 0.0
        self._restart(0.0)

    def _restart(self, arrival: float) -> None:
        """Learn anew how the counter relates to the host's clock."""
        self._begun, self._counted = arrival, 0.0
        self._keeps = False
        self._since: float | None = None
        self.excess = 0.0

    def is_new(self, arrival: float, scan: ScanTime, contacts: Collection[int]) -> bool:
        """Take in a report; whether its contacts have been scanned since the one before.

        Args:
            arrival: When it arrived, s.
            scan: Its scan time.
            contacts: Numbers of its contacts. A frame may be spread over reports of one scan time,
                which have different contacts.
        """
        before, passed, self._arrived = self._newest, arrival - self._arrived, arrival
        counted = 0.0 if before is None else (scan.time - before.time) % scan.wrap
        old = counted > scan.wrap / 2
        if before is None or passed > self.PAUSE or (old and passed > self.GAP):
            self._restart(arrival)
        elif old and self._moves:
            self._repeats += 1
            return False
        elif not counted:
            again = not self._contacts.isdisjoint(contacts)
            self._contacts.update(contacts)
            self._repeats += again
            return not (again and self._moves)
        elif not old:
            self._moves = True
            self._compare(arrival, counted, passed)
        self._newest, self._repeats, self._contacts = scan, 0, set(contacts)
        return True

    @property
    def stands_still(self) -> bool:
        """Whether a counter that has counted no longer does."""
        return self._moves and self._repeats >= self.REPEATS

    @property
    def falls_behind(self) -> bool:
        """Whether reports have been too late for long enough."""
        return self._since is not None and self._arrived - self._since >= self.LASTING

    def _compare(self, arrival: float, counted: float, passed: float) -> None:
        """Follow by how much reports are late; with what has passed by both clocks, s."""
        self._counted += counted
        total = arrival - self._begun
        if not self._keeps:
            if total >= self.LEARN and abs(self._counted - total) <= self.DRIFT * total:
                self._keeps = True
            elif total >= self.LEARN:
                self._begun, self._counted = arrival, 0.0
            return
        # since the promptest one; a counter slower than the host's clock must not look late
        self.excess = max(0.0, self.excess + passed - counted - self.DRIFT * passed)
        if self.excess <= self._late:
            self._since = None
        elif self._since is None:
            self._since = arrival
