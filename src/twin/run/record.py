"""The record of a run: named channels, one row per control period, written whole or not at all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from controllers.ballplate import STATES
from controllers.interfaces import Quantity

Observe = Callable[[float, Mapping[str, NDArray[Any]]], None]


@dataclass(frozen=True)
class Channel:
    """A recorded quantity: its columns with one unit each."""

    columns: tuple[str, ...]
    units: tuple[str, ...]


_STATE_UNITS = ("m", "m/s", "rad", "rad/s", "m", "m/s", "rad", "rad/s")

CHANNELS = {
    "state": Channel(tuple(f"true_{name}" for name in STATES), _STATE_UNITS),
    "measured": Channel(
        ("measured_x", "measured_phi", "measured_y", "measured_theta"), ("m", "rad", "m", "rad")
    ),
    "age": Channel(("age",), ("s",)),
    "touched": Channel(("touched",), ("1",)),
    "estimate": Channel(tuple(f"estimated_{name}" for name in STATES), _STATE_UNITS),
    "requested": Channel(("requested_phi_acc", "requested_theta_acc"), ("rad/s^2", "rad/s^2")),
    "applied": Channel(("applied_phi_acc", "applied_theta_acc"), ("rad/s^2", "rad/s^2")),
    "supervisor": Channel(("supervisor",), ("1",)),
    "timing": Channel(("lateness", "round_trip", "drive_age"), ("s", "s", "s")),
    "reference": Channel(("reference_x", "reference_y"), ("m", "m")),
}
"""The channels of records: ``state`` of simulated ones only, ``timing`` of real-time ones only,
``reference`` of those whose reference is not part of this program."""


@dataclass
class Recorder:
    """Keeps N rigs' channels in memory, one entry a control period.

    Attributes:
        ticks: Room for this many periods.
        rigs: Number of rigs.
        period: Control period in s.
        plant: Names of the columns of the channel ``plant``, each ending in its unit.
        further: What the observer estimates beyond the state: the channel ``further``.
        keep: Channels that are kept; none for all.
        every: Control periods from one recorded instant to the next. Between two, the applied
            acceleration that is kept is the largest by amount; the rest is that of the instant.
        length: Periods recorded so far.
        data: Channel name to values, shape (ticks, N) or (ticks, N, columns).
        observers: Are shown time and channels of each period as they are recorded; must not
            stall.
    """

    ticks: int
    rigs: int
    period: float
    plant: tuple[str, ...] = ()
    further: tuple[Quantity, ...] = ()
    keep: tuple[str, ...] = ()
    every: int = 1
    length: int = 0
    data: dict[str, Array] = field(default_factory=dict)
    observers: list[Observe] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Make room for the times."""
        self._time = np.empty(math.ceil(self.ticks / self.every))
        self._columns: list[tuple[str, Array]] = []
        self._tick = 0
        self._peak: Array | None = None

    def append(self, time: float, channels: Mapping[str, NDArray[Any]]) -> None:
        """Add the control period that began at a time in s; always the same channels.

        Args:
            time: In s.
            channels: Name to values, shape (N,) or (N, columns).
        """
        for observe in self.observers:
            observe(time, channels)
        if self.every > 1:
            channels = {**channels, "applied": self._largest(channels["applied"])}
            self._tick += 1
            if (self._tick - 1) % self.every:
                return
            self._peak = None
        if not self._columns:
            for name in self.keep or channels:
                self.data[name] = np.full((len(self._time), *channels[name].shape), np.nan)
            self._columns = list(self.data.items())
        row = self.length
        for name, values in self._columns:
            values[row] = channels[name]
        self._time[row] = time
        self.length += 1

    def _largest(self, applied: Array) -> Array:
        """The largest by amount since the last recorded instant."""
        if self._peak is not None:
            applied = np.where(np.abs(applied) > np.abs(self._peak), applied, self._peak)
        self._peak = applied
        return applied

    @property
    def time(self) -> Array:
        """Seconds since the start, shape (length,); of a real-time run with gaps if any."""
        return self._time[: self.length]

    @property
    def end(self) -> float:
        """When the last period ended, s."""
        return float(self._time[self.length - 1]) + self.every * self.period if self.length else 0.0

    def __getitem__(self, name: str) -> Array:
        """What was recorded of a channel, shape (length, N, columns)."""
        return self.data[name][: self.length].reshape(self.length, self.rigs, -1)

    def channel(self, name: str) -> Channel:
        """Columns and units of a channel."""
        if name == "further":
            names = tuple(f"estimated_{quantity.name}" for quantity in self.further)
            return Channel(names, tuple(quantity.unit for quantity in self.further))
        units = tuple(column.rpartition("_")[2] for column in self.plant)
        return CHANNELS.get(name) or Channel(self.plant, units)

    @property
    def units(self) -> dict[str, str]:
        """Name to unit of all columns it may have."""
        known = map(self.channel, (*CHANNELS, "plant", "further"))
        return {k: v for each in known for k, v in zip(each.columns, each.units, strict=True)}

    def of_rig(self, rig: int) -> Recorder:
        """The record of one rig alone, a copy."""
        alone = replace(self, rigs=1, data={}, observers=[])
        alone._time[:] = self._time
        alone.data = {name: values[:, rig : rig + 1].copy() for name, values in self.data.items()}
        return alone

    def columns(self) -> Iterator[tuple[str, str, Array]]:
        """Name, unit and values of every column but time; the rows of one rig follow the other."""
        for name in self.data:
            channel = self.channel(name)
            for column, unit, values in zip(
                channel.columns, channel.units, np.moveaxis(self[name], -1, 0), strict=True
            ):
                yield column, unit, values.T.ravel()

    def add(self, name: str, values: Array) -> None:
        """A channel that is known at the end only, shape (length, N, columns)."""
        self.data[name] = values

    def begin_with(self, columns: Mapping[str, Array]) -> None:
        """Take in the rows of one rig's record from which to go on.

        Args:
            columns: Names to values, shape (K,), in the order of the record.
        """
        self.length = len(columns["time"])
        self._time[: self.length] = columns["time"]
        channels = {name: self.channel(name) for name in (*CHANNELS, "plant", "further")}
        order = list(columns)
        present = [
            name
            for name, each in channels.items()
            if each.columns and columns.keys() >= {*each.columns} and name != "reference"
        ]
        for name in sorted(present, key=lambda name: order.index(channels[name].columns[0])):
            values = np.stack([columns[column] for column in channels[name].columns], axis=-1)
            shape = (len(self._time), 1, *values.shape[1:])[: None if values.shape[1] > 1 else 2]
            self.data[name] = np.full(shape, np.nan)
            self.data[name][: self.length] = values.reshape(self.length, *shape[1:])
        self._columns = list(self.data.items())
