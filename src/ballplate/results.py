"""What a run gives: its signals, its indicators, its picture, its folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ballplate.reporter import Reporter, default, overview, showable
from twin.errors import RecordError
from twin.run.files import free
from twin.run.finished import Run, of_other_class, save
from twin.run.signals import MOVING
from twin.writing import write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from controllers.arrays import Array
    from twin.jobs import SecondProcess


class Result(Run):
    """A run of one rig as a program uses it: what ``Run`` is, and its picture, report and folder.

    Made by ``run``, ``compare``, ``load`` and ``Rig.result``; shows itself in a notebook.

    Attributes:
        label: What it ran on, as ``honest twin``; of an opened run its name.
        baseline: The same controller on the clean model; None if that did not run.
        beside: Further runs of its table and picture, by name.
    """

    label: str
    baseline: Result | None
    beside: dict[str, Result]

    @classmethod
    def from_run(cls, run: Run, name: str = "", label: str = "") -> Result:
        """That of a run which was just made or opened, under another name if one is given."""
        found = cls.__new__(cls)
        name = name or run.name
        vars(found).update(vars(run), name=name, label=label or name, baseline=None, beside={})
        return found

    @property
    def title(self) -> str:
        """What ran, in words."""
        return self.scenario.title

    @property
    def finished(self) -> bool:
        """Whether it ran to its end."""
        return self.outcome == "finished"

    @property
    def run(self) -> Result | None:
        """Itself, with its whole ``record``, if it was just made; None if it was opened."""
        return None if self.record is None else self

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
        """The runs of its picture by label: itself, the clean model, those beside it."""
        clean = {} if self.baseline is None else {self.baseline.label: self.baseline}
        return {self.label: self, **clean, **self.beside}

    @property
    def verdict(self) -> str:
        """The run in one sentence: its tracking error, and what limited it most."""
        from twin.report.summary import judged

        clean = None if self.baseline is None else self.baseline.metrics["tracking_error_percent"]
        return judged(self, clean)

    def plot(self) -> Figure:
        """The picture: path of the ball, error, plate angles and effort."""
        from twin.run.picture import picture

        motions = {label: each.motion for label, each in self.shown.items()}
        return showable(picture(motions, self.title, self.scenario.rig.limits.area))

    def report(self, file: str | Path) -> Path:
        """Write the report of ``ballplate report``, one page that needs nothing else."""
        from twin.report.html import html

        write_whole(Path(file), html([self]))
        return Path(file)

    def export(
        self,
        file: str | Path,
        *,
        fps: int = 20,
        since: float | None = None,
        until: float | None = None,
        seconds: float | None = None,
        size: int = 600,
        render: str = "plate",
        reporter: Reporter | None = None,
    ) -> Path:
        """Write the signals for other programs, or the runs of its picture as one that moves.

        Args:
            file: Its ending says how: ``.csv``, ``.mat``, ``.parquet``, or ``.mcap`` by the extra
                ``mcap``; of a moving picture ``.webp``, ``.gif`` or ``.mp4`` (by the extra
                ``video``).
            fps: Frames of the moving picture a second.
            since: Time of the run at which it begins, s; the first one by default.
            until: Time at which it ends, s; the last one by default.
            seconds: How long it lasts, s; as long as what it shows by default.
            size: Its width in pixels.
            render: ``plate`` from above, or ``mujoco`` for the mechanism in 3D, which needs EGL or
                OSMesa.
            reporter: Who is told progress; a notebook has its own.

        Raises:
            RecordError: If the ending is none of these, the run has no such part, or the file
                cannot be written.
        """
        if Path(file).suffix not in MOVING:
            return super().export(file)
        from twin.run.film import Cut, Film, moving

        cut = Cut(fps=fps, since=since, until=until, seconds=seconds, size=size, render=render)
        film = Film(self.shown, cut)
        with (reporter or default()).progress("moving picture", film.count, "frames") as advance:
            moving(Path(file), film, advance)
        return Path(file)

    def save(self, folder: str | Path | None = None) -> Path:
        """Write a run folder, run.parquet, metrics.json and picture.png; returns the folder.

        Args:
            folder: Where; ``runs/NAME`` by default, or the next free name if the law of the run
                there was another.

        Raises:
            RecordError: If it cannot be written, or the run is one that was opened.
        """
        place = Path(folder) if folder is not None else Path("runs") / self.name
        if self.record is not None and of_other_class(place, lambda: self.scenario):
            if folder is None:
                place = free(place)
            else:
                default().warn(f"{place}: replaces a run whose law was another")
        return kept(self, place).folder or place

    def _repr_html_(self) -> str:
        """For a notebook: title, indicators and picture."""
        return overview(self.title, self.shown, self.plot())

    def __repr__(self) -> str:
        error = self.metrics.get("tracking_error_percent")
        said = "" if error is None else f", tracking error {error:.3g} %"
        return f"<{type(self).__name__} {self.title!r}: {self.outcome}{said}>"


def kept(result: Result, folder: Path, beside: SecondProcess | None = None) -> Result:
    """The result, saved in a folder.

    Args:
        result: Of a run that was just made.
        folder: Where; made if missing.
        beside: A process that draws while the rest is written.

    Raises:
        RecordError: If it cannot be written, or the run is one that was opened.
    """
    if result.record is None:
        raise RecordError(f"{result.name}: was opened from {result.folder}; nothing new to save")
    save(result, folder, {label: each.motion for label, each in result.shown.items()}, beside)
    result.folder = folder
    return result
