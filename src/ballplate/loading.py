"""What was recorded before: finished runs, and logs of any rig."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ballplate.notebook import page, png_image, showable
from twin.run.files import Signals

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ballplate.comparing import Comparison
    from ballplate.results import Result
    from controllers.arrays import Array


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
        import matplotlib as mpl
        import numpy as np
        from matplotlib.figure import Figure

        from twin.run.picture import LOOK

        with mpl.rc_context(LOOK):
            figure = Figure(figsize=(9, 5), layout="constrained")
            ball, plate = figure.subplots(2, sharex=True)
            for axis in ("x", "y"):
                ball.plot(self.time, 1000 * self[f"measured_{axis}"], label=axis)
            for angle in ("phi", "theta"):
                plate.plot(self.time, np.degrees(self[f"measured_{angle}"]), label=angle)
            ball.set(title=self.name, ylabel="ball [mm]")
            plate.set(xlabel="time [s]", ylabel="plate [deg]")
            ball.legend(loc="upper right")
            plate.legend(loc="upper right")
            figure.draw_without_rendering()
        return showable(figure)

    def _repr_html_(self) -> str:
        """For a notebook: its picture."""
        return page("", png_image(self.plot()))


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
    from ballplate.comparing import Comparison
    from ballplate.reporter import default
    from ballplate.results import Result
    from twin.run.finished import open_runs

    runs = {each.name: Result.from_run(each) for each in open_runs((file,), tell=default().warn)}
    if len(runs) == 1:
        return next(iter(runs.values()))
    return Comparison(runs, f"Comparison of {len(runs)} runs", {})


def _log(file: Path) -> Log:
    from twin.identify.log import COLUMNS, read

    log = read(file)
    columns = {"time": log.time, "measured_x": log.ball[:, 0], "measured_y": log.ball[:, 1]}
    columns |= {"measured_phi": log.plate[:, 0], "measured_theta": log.plate[:, 1]}
    columns |= {"age": log.age, "touched": log.touched.astype(float)}
    if log.command is not None:
        names = ("applied_phi_rate", "applied_theta_rate")
        columns |= dict(zip(names, log.command.T, strict=True))
    return Log(log.source, columns, {name: COLUMNS[name].unit for name in columns})
