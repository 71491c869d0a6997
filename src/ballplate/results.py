"""Results of runs, new or opened; logs of any rig, and the parameters they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter, default, overview, showable
from twin.base.errors import RecordError
from twin.base.writing import write_whole
from twin.run.exporters import FILM_SUFFIXES, Signals
from twin.run.files import free
from twin.run.finished import Run, draw, save_record
from twin.run.indicators import Indicators
from twin.run.opened import of_other_class

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from controllers.arrays import Array
    from twin.run.metrics import Motion
    from twin.scenario.schema import Dimensions


class Result(Run):
    """A run of one rig as a program uses it: what ``Run`` is, and its picture, report and folder.

    Made by ``run``, ``compare``, ``load`` and ``Rig.result``; shows itself in a notebook.

    Attributes:
        label: Name of its plant, as ``honest twin``; of an opened run its name.
        baseline: The same controller on the clean model; None if that did not run.
        beside: Further runs of its table and picture, by name.

    Examples:
        >>> import ballplate as bp
        >>> done = bp.run("circle", ["plant.kind=lagrange"], duration=2)
        >>> done.outcome, done.ball.shape, done.units["measured_x"]
        ('finished', (1000, 2), 'm')
        >>> f"{done.metrics['phi_max_deg']:.1f} deg"
        '0.3 deg'
        >>> done.export("circle.csv").name
        'circle.csv'
    """

    label: str
    baseline: Result | None
    beside: dict[str, Result]

    @classmethod
    def from_run(cls, run: Run, name: str = "", label: str = "") -> Result:
        """The result of a run that was just made or opened, under a name of its own if given."""
        found = cls.__new__(cls)
        name = name or run.name
        vars(found).update(vars(run), name=name, metrics=Indicators(run.metrics))
        vars(found).update(label=label or name, baseline=None, beside={})
        return found

    @property
    def title(self) -> str:
        """Description of the run."""
        return self.scenario.title

    @property
    def finished(self) -> bool:
        """Whether it ran to its end."""
        return self.outcome == "finished"

    @property
    def ball(self) -> Array:
        """Ball position in m, shape (K, 2): the true one, of a real rig the estimated one."""
        return self.motion.ball

    @property
    def reference(self) -> Array:
        """Desired ball position in m, shape (K, 2)."""
        return self.motion.reference

    @property
    def error(self) -> Array:
        """Reference minus ball in m, shape (K, 2)."""
        return self.motion.error

    @property
    def shown(self) -> dict[str, Result]:
        """The runs of its picture by label: itself, the clean model, further runs."""
        clean = {} if self.baseline is None else {self.baseline.label: self.baseline}
        return {self.label: self, **clean, **self.beside}

    @property
    def motions(self) -> dict[str, Motion]:
        """The motion of each run of its picture, by label."""
        return {label: each.motion for label, each in self.shown.items()}

    @property
    def verdict(self) -> str:
        """The run in one sentence: its tracking error, and what limited it most."""
        from twin.view.summary import describe_run

        clean = None if self.baseline is None else self.baseline.metrics["tracking_error_percent"]
        return describe_run(self, clean)

    def plot(self, panel: str | Sequence[str] | None = None, width_mm: float = 88.0) -> Figure:
        """The picture: path of the ball, error, plate angles and effort; or panels of it.

        ``result.plot("error", width_mm=88).savefig("error.pdf")`` has the width of a column and
        text as text, in TrueType fonts; ``plot(["plate", "error"])`` has one below the other.

        Args:
            panel: ``plate``, ``error``, ``x``, ``y``, ``angle`` or ``effort``, or a list of
                these, from the top; all by default.
            width_mm: Width of a figure of chosen panels in mm, 30 to 400.

        Raises:
            ScenarioError: If there is no such panel, or the width is out of range.
        """
        return showable(
            draw_motions(self.motions, self.title, self.scenario.dimensions, panel, width_mm)
        )

    def report(self, file: str | Path) -> Path:
        """Write the report of ``ballplate report``, one page that needs nothing else."""
        from twin.view.html import html

        write_whole(Path(file), html([self]))
        return Path(file)

    def export(
        self,
        file: str | Path,
        *,
        reporter: Reporter | None = None,
        **cut: Any,
    ) -> Path:
        """Write the signals for other programs, or the runs of its picture as one that moves.

        Args:
            file: Format by its ending: ``.csv``, ``.mat``, ``.parquet``, or ``.mcap`` by the extra
                ``mcap``; of a moving picture ``.webp``, ``.gif`` or ``.mp4`` (by the extra
                ``video``).
            reporter: Receives progress; a notebook has its own.
            cut: Of a moving picture, those of ``twin.run.film.Cut``: ``fps``, frames a second [20];
                ``since`` and ``until``, times of the run at which it begins and ends, s [all];
                ``seconds``, its duration [the run's]; ``size``, its width in
                pixels [600]; ``render``, ``plate`` from above or ``mujoco`` for the mechanism in
                3D, which needs EGL or OSMesa.

        Raises:
            RecordError: If the ending is none of these, the run has no such part, or the file
                cannot be written.
        """
        if Path(file).suffix not in FILM_SUFFIXES:
            return super().export(file)
        from twin.run.film import Cut, Film, moving

        report = reporter or default()
        film = Film(self.shown, Cut(**cut, name_of=report.name_of))
        with report.progress("moving picture", film.count, "frames") as advance:
            moving(Path(file), film, advance)
        return Path(file)

    def save(self, folder: str | Path | None = None) -> Path:
        """Write a run folder, run.parquet, metrics.json and picture.png; returns the folder.

        Args:
            folder: Where; ``runs/NAME`` by default, or the next free name if the law of the run
                there was a different one.

        Raises:
            RecordError: If it cannot be written, or the run is one that was opened.
        """
        place = Path(folder) if folder is not None else Path("runs") / self.name
        if self.record is not None and of_other_class(place, lambda: self.scenario):
            if folder is None:
                place = free(place)
            else:
                default().warn(f"{place}: replaces a run of a different law")
        return save_result(self, place).folder or place

    def _repr_html_(self) -> str:
        """For a notebook: title, indicators and picture."""
        return overview(self.title, self.shown, self.plot())

    def __repr__(self) -> str:
        error = self.metrics.get("tracking_error_percent")
        words = "" if error is None else f", tracking error {error:.3g} %"
        return f"<{type(self).__name__} {self.title!r}: {self.outcome}{words}>"


def draw_motions(
    motions: Mapping[str, Motion],
    title: str,
    plate: Dimensions,
    panel: str | Sequence[str] | None,
    width_mm: float,
) -> Figure:
    """The picture of motions by label, or panels of it; arguments as for ``Result.plot``."""
    from twin.run.picture import PaperFigure, picture
    from twin.run.picture import panel as draw_panel

    if panel is None:
        return picture(motions, title, plate, PaperFigure)
    return draw_panel(motions, panel, plate, width_mm)


def save_result(result: Result, folder: Path) -> Result:
    """The result, saved in a folder.

    Args:
        result: Of a run that was just made.
        folder: Where; made if missing.

    Raises:
        RecordError: If it cannot be written, or the run is one that was opened.
    """
    save_without_picture(result, folder)
    draw(result, folder, result.motions)
    return result


def save_without_picture(result: Result, folder: Path) -> Result:
    """The result, saved in a folder without its picture; arguments as for `save_result`."""
    if result.record is None:
        raise RecordError(f"{result.name}: was opened from {result.folder}; nothing new to save")
    save_record(result, folder)
    result.folder = folder
    return result


@dataclass(eq=False, repr=False)
class Log(Signals):
    """A log in SI units, as ``identify`` reads it.

    Attributes:
        name: Its file's name.
        rows: Column name to values, shape (K,).
        units: Column name to unit.

    Examples:
        >>> import ballplate as bp
        >>> done = bp.run("hold", ["plant.kind=lagrange"], duration=0.1)
        >>> log = bp.load(done.export("log.csv"))
        >>> log.name, log["measured_x"].shape, log.units["measured_x"]
        ('log.csv', (50,), 'm')
    """

    name: str
    rows: Mapping[str, Array]
    units: Mapping[str, str]
