"""The browsers that look: the first one drives, the next one takes over when it has gone."""

from __future__ import annotations

from collections.abc import Callable


class Audience:
    """Who looks, in the order in which they came.

    Args:
        clock: Seconds.
        patience: Seconds without anybody, once somebody was there, until all are taken to have
            gone for good: a page that is loaded again is away for a moment.
    """

    def __init__(self, clock: Callable[[], float], patience: float = 5.0) -> None:
        self._clock, self._patience = clock, patience
        self._there: list[str] = []
        self._left: float | None = None

    @property
    def driver(self) -> str | None:
        """Who drives."""
        return self._there[0] if self._there else None

    def __len__(self) -> int:
        return len(self._there)

    def come(self, who: str) -> None:
        """Somebody looks from now on."""
        if who not in self._there:
            self._there.append(who)
        self._left = None

    def go(self, who: str) -> None:
        """Somebody looks no more."""
        if who in self._there:
            self._there.remove(who)
        if not self._there and self._left is None:
            self._left = self._clock()

    @property
    def gone(self) -> bool:
        """Whether everybody has gone for good."""
        return self._left is not None and self._clock() - self._left > self._patience
