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

    Attributes:
        rows: Name to values.
        units: Name to unit, as ``m`` or ``rad/s``.
    """

    rows: Mapping[str, Array]
    units: Mapping[str, str]

    def __getitem__(self, name: str) -> Array:
        """The values of a column, shape (K,).

        Raises:
            RecordError: If there is none of that name.
        """
        try:
            return self.rows[name]
        except KeyError:
            raise RecordError(f"no column '{name}'{nearest(name, self.rows)}") from None

    def __contains__(self, name: object) -> bool:
        return name in self.rows

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def time(self) -> Array:
        """Seconds since the start, shape (K,)."""
        return self["time"]

    def to_pandas(self) -> pd.DataFrame:
        """The columns as a table over time in s; ``attrs["units"]`` has their units."""
        import pandas as pd  # noqa: PLC0415  heavy: loaded when needed

        frame = pd.DataFrame(dict(self)).set_index("time")
        frame.attrs["units"] = dict(self.units)
        return frame

    def export(self, file: str | Path) -> Path:
        """Write the columns for other programs, with their units; returns the file.

        Args:
            file: Its ending says how: ``.csv``, ``.mat`` or ``.parquet``.

        Raises:
            RecordError: If the ending is none of these, or the file cannot be written.
        """
        from twin.run.files import export  # noqa: PLC0415  heavy: loaded when needed

        export(Path(file), self.rows, self.units)
        return Path(file)
