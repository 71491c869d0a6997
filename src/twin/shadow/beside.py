"""Windows of several logs side by side, each with its own twin: replayed in one go."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from twin.identify.problem import Problem
from twin.identify.windows import Windows
from twin.shadow.belief import Belief

AT_ONCE = 500
"""Windows that are worked on at once: more no longer fit the processor's cache."""


@dataclass(frozen=True)
class Beside:
    """W windows with their twins, which agree in what a batch of replays has only once.

    Attributes:
        windows: Of one log or of several.
        beliefs: The twins.
        owner: Which of the twins is that of a window, shape (W,).
    """

    windows: Windows
    beliefs: tuple[Belief, ...]
    owner: NDArray[np.int_]

    @classmethod
    def of(cls, parts: Sequence[tuple[Windows, Belief]]) -> Beside:
        """Windows of several logs in a row."""
        windows = [each for each, _ in parts]
        owner = np.repeat(np.arange(len(parts)), [len(each) for each in windows])
        joined = Windows.join(windows) if len(windows) > 1 else windows[0]
        return cls(joined, tuple(belief for _, belief in parts), owner)

    def take(self, which: Mask) -> Beside:
        """Some of the windows."""
        return Beside(self.windows.take(which), self.beliefs, self.owner[which])

    def portions(self) -> Iterator[tuple[Mask, Beside]]:
        """Parts of it of a size that is good to work on, and which windows they are."""
        at = np.arange(len(self.windows))
        for first in range(0, len(at), AT_ONCE):
            which = np.asarray((at >= first) & (at < first + AT_ONCE))
            yield which, self.take(which)

    def each(self, value: Callable[[Belief], object]) -> Array:
        """A value of the twin of every window, shape (W, ...)."""
        return np.array([value(belief) for belief in self.beliefs], float)[self.owner]

    @property
    def problem(self) -> Problem:
        """Replays of the windows."""
        return self.beliefs[0].problem(self.windows)

    @property
    def theta(self) -> Array:
        """What the twins believe, shape (1, W, P)."""
        return self.each(lambda belief: belief.theta[0])[None]

    @property
    def delay(self) -> Array:
        """Dead times in s, shape (W,)."""
        return self.each(lambda belief: belief.values["delay"])

    @property
    def rough(self) -> Array:
        """Standard deviations in m/s^2 of the unknown acceleration, shape (W,)."""
        return self.each(lambda belief: belief.rough)


def alike(beliefs: Sequence[Belief]) -> list[list[int]]:
    """Which twins can be replayed in one batch, by their places."""
    found: dict[object, list[int]] = {}
    for place, belief in enumerate(beliefs):
        found.setdefault((belief.model, belief.names, belief.grip), []).append(place)
    return list(found.values())
