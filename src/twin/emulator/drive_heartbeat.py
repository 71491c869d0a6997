"""Heartbeats of an emulated drive: its own, and those of the node it watches."""

from __future__ import annotations

from twin.emulator.drive_objects import Store


class Heartbeats:
    """Sends one as often as 1017h says, and misses those of another node as 1016h says.

    Args:
        store: The drive's objects.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._beat = 0.0
        self._silence: float | None = None

    def restart(self) -> None:
        """Count the time to the next one anew, as after a write to 1017h."""
        self._beat = 0.0

    def due(self, dt: float) -> bool:
        """Whether one is to be sent after a further time in s."""
        period = self._store.get(0x1017) / 1e3
        self._beat += dt
        if not period or self._beat < period:
            return False
        self._beat %= period
        return True

    def heard(self, node: int) -> None:
        """Take in that of a node; monitoring begins with the first of the one to be watched."""
        watched = self._store.get(0x1016, 1)
        if watched & 0xFFFF and watched >> 16 & 0x7F == node:
            self._silence = 0.0

    def missed(self, dt: float) -> bool:
        """Whether the watched node has been silent for too long after a further time in s."""
        patience = (self._store.get(0x1016, 1) & 0xFFFF) / 1e3
        if self._silence is None or not patience:
            self._silence = None
            return False
        self._silence += dt
        if self._silence <= patience:
            return False
        self._silence = None
        return True
