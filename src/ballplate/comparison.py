"""Finished runs side by side as a mapping with table, picture and folder; records opened again."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import default, overview, showable
from twin.base.errors import plural
from twin.base.parts import left_out
from twin.base.writing import write_json, write_whole
from twin.run.files import MANIFEST_FILE, PICTURE_OF_MANY, folder_names, forget

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from ballplate.results import Log, Result
    from twin.run.metrics import Motion
    from twin.scenario.schema import Dimensions


@dataclass(repr=False, eq=False)
class Comparison(Mapping[str, "Result"]):
    """Runs side by side, by what tells them apart; shows itself in a notebook.

    Attributes:
        runs: By what tells them apart.
        title: What is compared.
        names: What tables and pictures call each run.
        folders: Where each run that was just made is kept within a folder of the comparison, by
            label.
        interrupted: Whether Ctrl-C ended it before all had run.
        folder: Where it was saved as the runs came; None for nowhere.
        logs: Which of them are logs, by label.

    Examples:
        >>> import ballplate as bp
        >>> settings = {"plant.kind": "lagrange", "duration": 0.5}
        >>> found = bp.compare("circle", "sine", settings=settings)
        >>> list(found), found["circle"].units["measured_x"]
        (['circle', 'sine'], 'm')
        >>> found["sine"].outcome
        'finished'
    """

    runs: Mapping[str, Result]
    title: str
    names: Mapping[str, str]
    _: KW_ONLY
    folders: Mapping[str, str] = field(default_factory=dict)
    interrupted: bool = False
    folder: Path | None = None
    logs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Name of a run, or its label."""
        self.names = {label: self.names.get(label, label) for label in self.runs}

    def __getitem__(self, label: str) -> Result:
        """One of the runs."""
        return self.runs[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self.runs)

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.metrics``."""
        return {label: each.metrics for label, each in self.runs.items()}

    def to_pandas(self) -> pd.DataFrame:
        """The indicators, a row per run."""
        import pandas as pd

        return pd.DataFrame.from_dict(self.metrics, orient="index")

    @property
    def motions(self) -> dict[str, Motion]:
        """The motion of each run by what pictures call it."""
        return {self.names[label]: each.motion for label, each in self.runs.items()}

    def summaries(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.summary``."""
        return {label: each.summary() for label, each in self.runs.items()}

    def plot(self, panel: str | Sequence[str] | None = None, width_mm: float = 88.0) -> Figure:
        """All runs in one picture, or in panels of it; arguments as for ``Result.plot``."""
        from ballplate.results import draw_motions

        return showable(draw_motions(self.motions, self.title, self._plate, panel, width_mm))

    def save(self, folder: str | Path = "runs/compare") -> Path:
        """Write a folder per run and compare.png into a folder; returns it.

        Raises:
            RecordError: If it cannot be written, or a run is one that was opened.
        """
        from ballplate.results import save_result

        forget(Path(folder))
        self.folders = name_folders(self.names)
        for label, each in self.runs.items():
            save_result(each, Path(folder) / self.folders[label])
        return self.draw(folder)

    def draw(self, folder: str | Path) -> Path:
        """Write the picture and the indicators alone into a folder; returns the folder.

        Raises:
            RecordError: If it cannot be written.
        """
        from twin.run.finished import draw_runs

        place = Path(folder)
        with left_out(file := place / PICTURE_OF_MANY):
            write_whole(file, draw_runs(self.motions, self.title, self._plate))
        content = {
            "folders": list(self.folders.values()),
            "names": [self.names[label] for label in self.folders],
            "linked": [
                {"position": position, "run": link_to(each.folder, place)}
                for position, (label, each) in enumerate(self.runs.items())
                if label not in self.folders and each.folder is not None
            ],
            "runs": self.summaries(),
        }
        write_json(place / MANIFEST_FILE, content)
        return place

    @property
    def _plate(self) -> Dimensions:
        return next(iter(self.runs.values())).scenario.dimensions

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title!r}: {', '.join(self.names.values())}>"

    def _repr_html_(self) -> str:
        """For a notebook: indicators and picture."""
        runs = {self.names[label]: each for label, each in self.runs.items()}
        return overview(self.title, runs, self.plot())


def name_folders(names: Mapping[str, str]) -> dict[str, str]:
    """Name the folder of each run of a comparison, by label.

    Args:
        names: What tables and pictures call each run, by label.
    """
    return dict(zip(names, folder_names(names.values()), strict=True))


def link_to(folder: Path, place: Path) -> str:
    """The path of a folder from a place; the whole path where there is none, as across drives."""
    try:
        return Path(os.path.relpath(folder.resolve(), place.resolve())).as_posix()
    except ValueError:
        return str(folder.resolve())


def load(path: str | Path) -> Result | Comparison | Log:
    """Open what was recorded before.

    Args:
        path: A run folder or its ``run.parquet``; a folder of run folders, as ``compare`` writes
            them; or a CSV log with named columns, units in the header as ``measured_x [mm]``.

    Returns:
        A ``Result`` for a run, a ``Comparison`` for several, a ``Log`` for a CSV file.

    Raises:
        TwinError: If it cannot be opened: what is wrong with it, or which column it lacks.

    Examples:
        >>> import ballplate as bp
        >>> folder = bp.run("hold", ["plant.kind=lagrange"], duration=0.1).save("kept")
        >>> bp.load(folder)
        <Result 'Hold on the centre (plant.kind=lagrange, duration=0.1)': finished>
    """
    from ballplate.results import Log, Result
    from twin.identify import logs
    from twin.run.opened import open_runs

    file = Path(path)
    if file.suffix == ".csv":
        log = logs.read(file)
        return Log(
            log.source, log.columns, {name: logs.LOG_COLUMN_UNITS[name] for name in log.columns}
        )
    runs = {each.name: Result.from_run(each) for each in open_runs((file,), tell=default().warn)}
    if len(runs) == 1:
        return next(iter(runs.values()))
    return Comparison(runs, f"Comparison of {plural(len(runs), 'run')}", {})
