"""Parameters of a rig identified from logs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter, default
from twin.base.errors import LogError, ScenarioError

if TYPE_CHECKING:
    from twin.identify import logs
    from twin.identify.axis_logs import AnyLog
    from twin.identify.verdicts import Identification, ParameterVerdict
from ballplate.results import Result

HOLD_OUT_SHARE, MAX_HOLD_OUT_SHARE = 0.33, 0.8
"""Share of a log that is held out from the fit unless chosen otherwise, and the largest one."""


def check_hold_out(share: float, reporter: Reporter) -> None:
    """Make sure that a share of a log can be held out from its fit.

    Args:
        share: The share.
        reporter: Knows what the argument is called.

    Raises:
        ScenarioError: If it is out of range.
    """
    if not 0 <= share <= MAX_HOLD_OUT_SHARE:
        option = reporter.name_of("hold_out")
        raise ScenarioError(f"{option}: must be 0 to {MAX_HOLD_OUT_SHARE:g}, got {share:g}")


@dataclass(repr=False, eq=False)
class Identified:
    """Identified parameters of a log; shows itself in a notebook.

    Attributes:
        found: The fit with its intervals, checks on what was held out, and notes.

    Examples:
        >>> import ballplate as bp
        >>> done = bp.run("excite", ["plant.kind=lagrange"], duration=16)
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
        >>> done = bp.run("excite", ["plant.kind=lagrange"], duration=16)  # its arm is 0.18 mm
        >>> (rolling,) = bp.identify(done, "rolling", hold_out=0.3).verdicts
        >>> print(f"{rolling.value:.2f} {rolling.about.unit}, {rolling.word}")
        0.18 mm, identified
    """
    from twin.identify.any_logs import read_any
    from twin.identify.balls import ball_factor, ball_heights
    from twin.identify.log_columns import wanted_columns
    from twin.identify.parameters import PLAIN_PARAMETERS, choose_parameters
    from twin.scenario import load

    report = reporter or default()
    if isinstance(hold_out, float | int):
        check_hold_out(hold_out, report)
    names = [parameters] if isinstance(parameters, str) else parameters
    factor = None if ball is None else ball_factor(ball)
    height = report.name_of("ball_height")
    heights = None if ball_height is None else ball_heights(ball_height, height)
    if columns is None:
        needed = report.name_of("columns")
        if alone := "on" if on else "ball_height" if heights else "":
            raise ScenarioError(f"{alone}: needs {needed}; a run states its rig")
        if not isinstance(hold_out, float | int):
            option, most = report.name_of("hold_out"), MAX_HOLD_OUT_SHARE
            raise ScenarioError(f"{option}: must be 0 to {most:g}; a second log needs {needed}")
        wanted = choose_parameters(",".join(names) or None)
        return Identified(_identify_run(log, wanted, 1 - hold_out, factor, report))
    fitted = choose_parameters(",".join(names) or None, tuple(PLAIN_PARAMETERS), ())
    if heights and "lever" in fitted:
        raise LogError(f"{height}: it determines the lever; remove lever from the parameters")
    rig = load("hold", [f"parameters={on}"]).plant.model if on else None

    def read(paths: str | Path | Result | Sequence[str | Path]) -> list[AnyLog]:
        return [read_any(path, roles, separator) for path in _paths(paths)]

    roles = wanted_columns(columns)
    logs = read(log)
    held = float(hold_out) if isinstance(hold_out, float | int) else read(hold_out)
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


def _identify_run(
    log: str | Path | Result | Sequence[str | Path],
    names: tuple[str, ...],
    share: float,
    factor: float | None,
    reporter: Reporter,
) -> Identification:
    """What a run, or a log with named columns, shows of its rig.

    Args:
        log: The log, alone.
        names: Parameters to fit.
        share: Share of the log that they are fitted to.
        factor: Share of gravity that accelerates the ball, where it is stated.
        reporter: Receives progress.

    Raises:
        TwinError: If the log cannot be read, or nothing can be learned from it.
    """
    from twin.identify.twin_model import identify_twin

    if not isinstance(log, str | Path | Result):
        log, *others = log
        if others:
            raise ScenarioError(f"log: give one; several logs need {reporter.name_of('columns')}")
    recorded = _read_recorded(log)
    if factor is not None:
        recorded = recorded.with_ball(factor)
    elif not recorded.scenario:
        option = reporter.name_of("ball")
        reporter.note(f"{recorded.source}: states no ball: taken as hollow; {option} states it")
    with reporter.progress(f"identifying from {recorded.source}", 1.0) as advance:
        return identify_twin(recorded, names, share, advance)


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
