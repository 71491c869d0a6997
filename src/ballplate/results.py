"""Results of runs, new or opened; logs of any rig, and the parameters they show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter, default, overview, showable
from twin.base.errors import RecordError, ScenarioError
from twin.base.writing import write_whole
from twin.run.files import FILM_SUFFIXES, Indicators, Signals, free
from twin.run.finished import Run, draw, of_other_class, save_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from controllers.arrays import Array
    from twin.identify import logs
    from twin.identify.verdicts import Identification, ParameterVerdict
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

        film = Film(self.shown, Cut(**cut))
        with (reporter or default()).progress("moving picture", film.count, "frames") as advance:
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
    recorded(result, folder)
    draw(result, folder, result.motions)
    return result


def recorded(result: Result, folder: Path) -> Result:
    """The result, saved in a folder without its picture; arguments as for ``kept``."""
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


HOLD_OUT_SHARE, MAX_HOLD_OUT_SHARE = 0.33, 0.8
"""Share of a log that is held out from the fit unless chosen otherwise, and the largest one."""


def check_hold_out(share: float) -> None:
    """Make sure that a share of a log can be held out from its fit.

    Raises:
        ScenarioError: If it is out of range.
    """
    if not 0 <= share <= MAX_HOLD_OUT_SHARE:
        raise ScenarioError(f"hold_out: must be 0 to {MAX_HOLD_OUT_SHARE:g}, got {share:g}")


@dataclass(repr=False, eq=False)
class Identified:
    """Identified parameters of a log; shows itself in a notebook.

    Attributes:
        found: The fit with its intervals, checks on what was held out, and notes.

    Examples:
        >>> import ballplate as bp
        >>> done = bp.run("excite", ["plant.kind=lagrange"], duration=10)
        >>> found = bp.identify(done, "rolling", hold_out=0.3)
        >>> found.sentences[1]
        'Identified: friction.rolling_mm.'
        >>> again = bp.run("circle", found.settings, duration=0.1)
    """

    found: Identification

    @property
    def verdicts(self) -> tuple[ParameterVerdict, ...]:
        """The parameters asked for: value, interval, whether it is identified, and why not."""
        return self.found.verdicts

    @property
    def sentences(self) -> list[str]:
        """The verdict in words."""
        from twin.identify.report import sentences

        return sentences(self.found)

    @property
    def settings(self) -> dict[str, Any]:
        """The identified parameters as ``run`` takes them: ``run("circle", found.settings)``."""
        from twin.base.data_file import parse_toml
        from twin.identify.report import parameters

        return parse_toml(parameters(self.found))

    def save(self, folder: str | Path) -> Path:
        """Write report.html and parameters.toml into a folder; returns it.

        Raises:
            RecordError: If a file cannot be written.
        """
        from twin.identify.report import write

        write(self.found, Path(folder))
        return Path(folder)

    def _repr_html_(self) -> str:
        """For a notebook: the verdict in words, and each parameter with its interval."""
        from twin.base.page import Table, Text, fragment
        from twin.identify.report import TABLE_HEADINGS, rows

        title = f"Identification from {self.found.source}"
        return fragment(title, [Table("", TABLE_HEADINGS, rows(self.found)), Text(self.sentences)])


def identify(
    log: str | Path | Result | Sequence[str | Path],
    parameters: str | Iterable[str] = (),
    *,
    hold_out: float | str | Path | Sequence[str | Path] = HOLD_OUT_SHARE,
    columns: str | None = None,
    separator: str | None = None,
    ball: str | float | None = None,
    on: str | Path | None = None,
    ball_height: float | str | None = None,
    reporter: Reporter | None = None,
) -> Identified:
    """Fit friction, dead time, drives and level to a recorded motion.

    Args:
        log: Run folder, ``run.parquet`` or CSV file with named columns, or a result; preferably
            recorded with the scenario ``excite``. With ``columns`` one or more logs of any rig.
        parameters: Names of those to fit, as ``rolling`` or ``dead_time``; the usual ones if none.
        hold_out: Share of the log held out from the fit, 0 to 0.8; with ``columns`` also a second
            log, or some.
        columns: Of a log of any rig, ``"time=t:ms,measured_x=X:mm,command_phi=u:deg"``.
        separator: Between its columns; found if None.
        ball: ``"hollow"``, ``"solid"``, or the share of gravity that accelerates it.
        on: With ``columns``: a shipped rig, or a file of parameters, over which what is found is to
            lie. Its ball is the one of the log.
        ball_height: With ``columns``: metres from the axis about which the plate tilts up to the
            ball's centre, or ``"X,Y"`` of two axes. What the plate's acceleration does to the ball
            is held at it, else fitted.
        reporter: Receives progress; a notebook has its own.

    Raises:
        TwinError: If the log cannot be read, or nothing can be learned from it.

    Examples:
        >>> import ballplate as bp
        >>> done = bp.run("excite", ["plant.kind=lagrange"], duration=10)  # its arm is 0.18 mm
        >>> (rolling,) = bp.identify(done, "rolling", hold_out=0.3).verdicts
        >>> print(f"{rolling.value:.2f} {rolling.about.unit}, {rolling.word}")
        0.18 mm, identified
    """
    from twin.identify.logs import ball_factor, ball_heights, read_any, wanted_columns
    from twin.identify.parameters import PLAIN_PARAMETERS, choose_parameters
    from twin.scenario import load

    if isinstance(hold_out, float | int):
        check_hold_out(hold_out)
    names = [parameters] if isinstance(parameters, str) else parameters
    factor = None if ball is None else ball_factor(ball)
    heights = None if ball_height is None else ball_heights(ball_height)
    report = reporter or default()
    if columns is not None:
        wanted = wanted_columns(columns)
        fitted = choose_parameters(",".join(names) or None, tuple(PLAIN_PARAMETERS), ())
        rig = load("hold", [f"parameters={on}"]).plant.model if on else None
        logs = [read_any(path, wanted, separator) for path in _paths(log)]
        held = (
            float(hold_out)
            if isinstance(hold_out, float | int)
            else [read_any(path, wanted, separator) for path in _paths(hold_out)]
        )
        from twin.identify.any_rig import identify_axes  # heavy: after what may be wrong

        with report.progress(f"identifying from {logs[0].source}", 1.0) as advance:
            found = identify_axes(
                logs,
                held,
                fitted,
                factor,
                progress=advance,
                ball=rig,
                on=on,
                heights=heights,
                say=report.note,
            )
        return Identified(found)
    from twin.identify.twin_model import identify_twin

    if alone := "on" if on else "ball_height" if heights else "":
        raise ScenarioError(f"{alone}: needs columns; a run states its rig")
    if not isinstance(log, str | Path | Result):
        log, *others = log
        if others:
            raise ScenarioError("log: give one; several logs need columns")
    if not isinstance(hold_out, float | int):
        raise ScenarioError("hold_out: must be 0 to 0.8; a second log needs columns")
    wanted_names = choose_parameters(",".join(names) or None)
    recorded = _read_recorded(log)
    if factor is not None:
        recorded = recorded.with_ball(factor)
    elif not recorded.scenario:
        option = report.name_of("ball")
        report.note(f"{recorded.source}: states no ball: taken as hollow; {option} states it")
    with report.progress(f"identifying from {recorded.source}", 1.0) as advance:
        return Identified(identify_twin(recorded, wanted_names, 1 - hold_out, advance))


def _paths(logs: str | Path | Result | Sequence[str | Path]) -> list[Path]:
    if isinstance(logs, Result):
        raise ScenarioError("columns: describe a file, not a result")
    return [Path(each) for each in ([logs] if isinstance(logs, str | Path) else logs)]


def _read_recorded(log: str | Path | Result) -> logs.Log:
    from twin.identify import logs

    if not isinstance(log, Result):
        return logs.read(Path(log))
    if log.folder is not None:
        return logs.read(log.folder)
    scenario = log.scenario.model_dump(mode="json")
    columns = {name: log[name] for name in logs.LOG_COLUMN_UNITS if name in log}
    return logs.of_columns(columns, {"scenario": scenario}, log.name)
