"""Recorded signals by name, with their units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from twin.errors import RecordError, nearest

if TYPE_CHECKING:
    import pandas as pd

    from controllers.arrays import Array


class Signals(Mapping[str, "Array"]):
    """Columns of one rig's record, shape (K,) each, by their names.

    Args:
        columns: Name to values.
        units: Name to unit.

    Attributes:
        units: Name to unit, as ``m`` or ``rad/s``.
    """

    def __init__(self, columns: Mapping[str, Array], units: Mapping[str, str]) -> None:
        self._columns = columns
        self.units = dict(units)

    def __getitem__(self, name: str) -> Array:
        """The values of a column, shape (K,).

        Raises:
            RecordError: If there is none of that name.
        """
        try:
            return self._columns[name]
        except KeyError:
            raise RecordError(f"no column '{name}'{nearest(name, self._columns)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    @property
    def time(self) -> Array:
        """Seconds since the start, shape (K,)."""
        return self["time"]

    def to_pandas(self) -> pd.DataFrame:
        """The columns as a table over time in s; ``attrs["units"]`` has their units."""
        import pandas as pd

        frame = pd.DataFrame(dict(self)).set_index("time")
        frame.attrs["units"] = self.units
        return frame

    def export(self, file: str | Path) -> Path:
        """Write the columns for other programs, with their units; returns the file.

        Args:
            file: Its ending says how: ``.csv``, ``.mat`` or ``.parquet``.

        Raises:
            RecordError: If the ending is none of these, or the file cannot be written.
        """
        from twin.run.export import export

        export(Path(file), self._columns, self.units)
        return Path(file)
