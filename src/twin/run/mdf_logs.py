"""Reader of measurement files of ASAM (MDF)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.base.finalisers import quiet_finalisers
from twin.base.parts import extra
from twin.run.readers import LOGS_EXTRA, ForeignTable, check_bytes, numbers_of
from twin.run.record import check_size

_TABLE_OF_RANGES = 6
"""Conversion of MDF 4 in which a range of raw values has one number (value range to value)."""


def read_mdf(path: Path) -> ForeignTable:
    """The channels of a measurement file of ASAM, each with the times of its group.

    A channel of a name that several groups have is called ``NAME.GROUP``, groups counted from 1.
    """
    with extra(LOGS_EXTRA, f"{path.name}: a measurement file"):
        from asammdf import MDF  # noqa: PLC0415
    columns: dict[str, Array | list[str]] = {}
    units: dict[str, str] = {}
    clocks: dict[str, Array] = {}
    with quiet_finalisers(), path.open("rb") as opened, MDF(opened) as file:
        groups: list[Any] = list(file.groups)
        rows = [group.channel_group.cycles_nr for group in groups]
        every = [
            (k, channel.name, number)
            for k, group in enumerate(groups)
            for number, channel in enumerate(group.channels)
            if number != file.masters_db.get(k)
        ]
        check_size(max(rows, default=0), len(every), 1, path.stat().st_size)
        check_bytes(8 * sum(rows[k] for k, *_ in every), path)
        names = [name for _, name, _ in every]
        for k, name, number in every:
            signal = file.get(group=k, index=number)
            values = _by_ranges(file, k, number, np.asarray(signal.samples))
            if values.dtype.kind not in "biuf" or values.ndim != 1 or len(values) < 2:
                continue
            own = name if names.count(name) == 1 else f"{name}.{k + 1}"
            columns[own] = numbers_of(values)
            clocks[own] = np.asarray(signal.timestamps, dtype=float)
            if signal.unit:
                units[own] = str(signal.unit)
    return ForeignTable(columns, units, clocks=clocks)


def _by_ranges(file: Any, group: int, number: int, values: NDArray[Any]) -> NDArray[Any]:
    """The samples of a channel, of integers with a table of ranges converted here, shape (K,).

    asammdf gives such integers the default unless they are the upper end of a range
    (findings/asammdf_gives_integers_within_a_range_the_default.sh): both ends belong to it.
    """
    table = file.groups[group].channels[number].conversion
    if table is None or table.conversion_type != _TABLE_OF_RANGES:
        return values
    raw = np.asarray(file.get(group=group, index=number, raw=True).samples)
    if raw.dtype.kind not in "iu":
        return values
    ranges = range((table.val_param_nr - 1) // 3)
    within = [(table[f"lower_{i}"] <= raw) & (raw <= table[f"upper_{i}"]) for i in ranges]
    return np.select(within, [table[f"phys_{i}"] for i in ranges], table.default)
