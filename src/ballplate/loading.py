"""What was recorded before: finished runs, logs of any rig, and the parameters they show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ballplate.comparing import Comparison
from ballplate.reporter import Reporter, default, png, showable
from ballplate.results import Result
from controllers.arrays import Array
from twin.data_file import parse_toml
from twin.errors import ScenarioError
from twin.identify import logs
from twin.page import Picture, Table, Text, fragment
from twin.run.finished import open_runs
from twin.run.signals import Signals

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from twin.identify.judged import Identification, ParameterVerdict


@dataclass(eq=False, repr=False)
class Log(Signals):
    """A log in SI units, as ``identify`` reads it; shows itself in a notebook.

    Attributes:
        name: Its file's name.
        rows: Column name to values, shape (K,).
        units: Column name to unit.
    """

    name: str
    rows: Mapping[str, Array]
    units: Mapping[str, str]

    def plot(self) -> Figure:
        """Ball and plate as they were measured, over time."""
        from twin.run.picture import drawn

        with drawn(9, 5) as figure:
            ball, plate = figure.subplots(2, sharex=True)
            for axis in ("x", "y"):
                ball.plot(self.time, 1000 * self[f"measured_{axis}"], label=axis)
            for angle in ("phi", "theta"):
                plate.plot(self.time, np.degrees(self[f"measured_{angle}"]), label=angle)
            ball.set(title=self.name, ylabel="ball [mm]")
            plate.set(xlabel="time [s]", ylabel="plate [deg]")
            ball.legend(loc="upper right")
            plate.legend(loc="upper right")
        return showable(figure)

    def _repr_html_(self) -> str:
        """For a notebook: its picture."""
        return fragment("", [Picture("", png(self.plot()))])


def load(path: str | Path) -> Result | Comparison | Log:
    """Open what was recorded before.

    Args:
        path: A run folder or its ``run.parquet``; a folder of run folders, as ``compare`` writes
            them; or a CSV log with named columns, units in the header as ``measured_x [mm]``.

    Returns:
        A ``Result`` for a run, a ``Comparison`` for several, a ``Log`` for a CSV file.

    Raises:
        TwinError: If it cannot be opened: what is wrong with it, or which column it lacks.
    """
    file = Path(path)
    if file.suffix == ".csv":
        return _log(file)
    runs = {each.name: Result.from_run(each) for each in open_runs((file,), tell=default().warn)}
    if len(runs) == 1:
        return next(iter(runs.values()))
    return Comparison(runs, f"Comparison of {len(runs)} runs", {})


def _log(file: Path) -> Log:
    log = logs.read(file)
    columns = {"time": log.time, "measured_x": log.ball[:, 0], "measured_y": log.ball[:, 1]}
    columns |= {"measured_phi": log.plate[:, 0], "measured_theta": log.plate[:, 1]}
    columns |= {"age": log.age, "touched": log.touched.astype(float)}
    if log.command is not None:
        columns |= dict(zip(logs.RATES, log.command.T, strict=True))
    return Log(log.source, columns, {name: logs.COLUMNS[name] for name in columns})


HOLD_OUT = 1 / 3
"""Share of a log that is held out from the fit."""


@dataclass(repr=False, eq=False)
class Identified:
    """What a log shows of its rig; shows itself in a notebook.

    Attributes:
        found: The fit with its intervals, checks on what was held out, and notes.
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
        from twin.identify.report import HEADS, rows

        title = f"Identification from {self.found.source}"
        return fragment(title, [Table("", HEADS, rows(self.found)), Text(self.sentences)])


def identify(
    log: str | Path | Result | Sequence[str | Path],
    parameters: str | Iterable[str] = (),
    *,
    hold_out: float | str | Path | Sequence[str | Path] = HOLD_OUT,
    columns: str | None = None,
    separator: str | None = None,
    pixel: str | None = None,
    ball: str | float | None = None,
    reporter: Reporter | None = None,
) -> Identified:
    """Fit friction, dead time, drives and level to a recorded motion.

    Args:
        log: Run folder, ``run.parquet`` or CSV file with named columns, or a result; preferably
            recorded with the scenario ``excite``. With ``columns`` one or more logs of any rig.
        parameters: Names of those to fit, as ``rolling`` or ``dead_time``; the usual ones if none.
        hold_out: Share of the log held out from the fit, 0 to 0.8; with ``columns`` also another
            log, or some.
        columns: Of a log of any rig, ``"time=t:ms,measured_x=X:mm,command_phi=u:deg"``.
        separator: Between its columns; found if None.
        pixel: Length of a pixel, as ``"0.5mm"``.
        ball: ``"hollow"``, ``"solid"``, or the share of gravity that accelerates it.
        reporter: Who is told progress; a notebook has its own.

    Raises:
        TwinError: If the log cannot be read, or nothing can be learned from it.
    """
    from twin.identify.logs import BALLS, ball_factor, read_any, wanted_columns
    from twin.identify.parameters import PLAIN, chosen

    if isinstance(hold_out, float | int) and not 0 <= hold_out <= 0.8:
        raise ScenarioError(f"hold_out: must be 0 to 0.8, got {hold_out:g}")
    names = [parameters] if isinstance(parameters, str) else parameters
    factor = None if ball is None else ball_factor(ball)
    report = reporter or default()
    if columns is not None:
        from twin.identify.any_rig import identify_any

        wanted = wanted_columns(columns, pixel)
        logs = [read_any(path, wanted, separator) for path in _paths(log)]
        held = (
            float(hold_out)
            if isinstance(hold_out, float | int)
            else [read_any(path, wanted, separator) for path in _paths(hold_out)]
        )
        fitted = chosen(",".join(names) or None, tuple(PLAIN), ())
        with report.progress(f"identifying from {logs[0].source}", 1.0) as advance:
            found = identify_any(logs, held, fitted, factor or BALLS["hollow"], progress=advance)
        return Identified(found)
    from twin.identify.twin_model import identify as fit

    if not isinstance(log, str | Path | Result):
        log, *others = log
        if others:
            raise ScenarioError("log: give one; several are taken with columns only")
    if not isinstance(hold_out, float | int):
        raise ScenarioError("hold_out: must be 0 to 0.8; another log is taken with columns only")
    wanted_names = chosen(",".join(names) or None)
    recorded = _recorded(log)
    if factor is not None:
        recorded = recorded.with_ball(factor)
    with report.progress(f"identifying from {recorded.source}", 1.0) as advance:
        return Identified(fit(recorded, wanted_names, 1 - hold_out, advance))


def _paths(logs: str | Path | Result | Sequence[str | Path]) -> list[Path]:
    if isinstance(logs, Result):
        raise ScenarioError("columns: are of a file, not of a result")
    return [Path(each) for each in ([logs] if isinstance(logs, str | Path) else logs)]


def _recorded(log: str | Path | Result) -> logs.Log:
    if not isinstance(log, Result):
        return logs.read(Path(log))
    if log.folder is not None:
        return logs.read(log.folder)
    scenario = log.scenario.model_dump(mode="json")
    columns = {name: log[name] for name in logs.COLUMNS if name in log}
    return logs.of_columns(columns, {"scenario": scenario}, log.name)
