"""Runs side by side, as a mapping that draws, saves and shows itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.notebook import indicators, page, png_image, showable

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from ballplate.results import Result
    from twin.run.metrics import Motion


class Comparison(Mapping[str, "Result"]):
    """Runs side by side, by what tells them apart; shows itself in a notebook.

    Attributes:
        title: What is compared.
        headings: What the table calls each run.
        names: What pictures call it.
        folders: Where each run that was just made is kept within a folder of the comparison.
        interrupted: Whether Ctrl-C ended it before all had run.
        folder: Where it was saved as the runs came; None for nowhere.
        replaced: What it replaced where it is saved, in words; empty for nothing.
        logs: Which of them are logs, by label.
    """

    def __init__(
        self,
        runs: Mapping[str, Result],
        title: str,
        headings: Mapping[str, str],
        *,
        names: Mapping[str, str] | None = None,
        folders: Mapping[str, str] | None = None,
        interrupted: bool = False,
        replaced: str = "",
        logs: Sequence[str] = (),
    ) -> None:
        self._runs = dict(runs)
        self.title = title
        self.headings = {label: headings.get(label, label) for label in runs}
        self.names = self.headings | dict(names or {})
        self.folders = dict(folders or {})
        self.interrupted, self.replaced = interrupted, replaced
        self.folder: Path | None = None
        self.logs = tuple(logs)

    def __getitem__(self, label: str) -> Result:
        """One of the runs."""
        return self._runs[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self._runs)

    def __len__(self) -> int:
        return len(self._runs)

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.metrics``."""
        return {label: each.metrics for label, each in self._runs.items()}

    def to_pandas(self) -> pd.DataFrame:
        """The indicators, a row per run."""
        import pandas as pd

        return pd.DataFrame.from_dict(self.metrics, orient="index")

    @property
    def motions(self) -> dict[str, Motion]:
        """The motion of each run by what pictures call it."""
        return {self.names[label]: each.motion for label, each in self._runs.items()}

    def summaries(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.summary``."""
        return {label: each.summary() for label, each in self._runs.items()}

    def plot(self) -> Figure:
        """All runs in one picture."""
        from twin.run.picture import picture

        return showable(picture(self.motions, self.title, self._area))

    def save(self, folder: str | Path = "runs/compare") -> Path:
        """Write a folder per run and compare.png into a folder; returns it.

        Raises:
            RecordError: If it cannot be written, or a run is one that was opened.
        """
        from ballplate.results import kept
        from twin.run.files import forget, slug

        self.replaced = forget(Path(folder))
        self.folders = {label: self.folders.get(label, slug(label)) for label in self._runs}
        for label, each in self._runs.items():
            kept(each, Path(folder) / self.folders[label])
        return self.draw(folder)

    def draw(self, folder: str | Path) -> Path:
        """Write the picture and the indicators alone into a folder; returns the folder.

        Raises:
            RecordError: If it cannot be written.
        """
        from twin.run.files import MANIFEST
        from twin.run.picture import draw
        from twin.writing import write_json

        place = Path(folder)
        draw(place / "compare.png", self.motions, self.title, self._area)
        content = {
            "folders": list(self.folders.values()),
            "names": [self.names[label] for label in self.folders],
            "runs": self.summaries(),
        }
        write_json(place / MANIFEST, content)
        return place

    @property
    def _area(self) -> tuple[float, float]:
        area: tuple[float, float] = next(iter(self._runs.values())).scenario.rig.limits.area
        return area

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title!r}: {', '.join(self.headings.values())}>"

    def _repr_html_(self) -> str:
        """For a notebook: indicators and picture."""
        runs = {self.headings[label]: each for label, each in self._runs.items()}
        return page(self.title, indicators(runs), png_image(self.plot()))
