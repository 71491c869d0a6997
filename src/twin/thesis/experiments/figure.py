"""The one figure: measured and predicted tracking errors of all experiments at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.thesis.experiments.predict import Prediction
from twin.writing import write_whole

LAWS = {
    "AFL": ("9.2", "9.3"),
    "AFL with integral": ("9.4", "9.5"),
    "backstepping": ("9.6", "9.7"),
    "sliding mode": ("9.8", "9.9"),
}
SIDES = ("without predictor", "with Smith predictor")
MEASURED, PREDICTED, CLEAN = "#222222", "#1f6fb4", "#e08214"


def draw(path: Path, rows: Sequence[Prediction]) -> None:
    """Draw tracking error over frequency, one panel per law, with and without predictor.

    Raises:
        RecordError: If the file cannot be written.
    """
    figure = Figure(figsize=(11, 6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 4, sharex=True, sharey="col")
    for column, (law, pair) in enumerate(LAWS.items()):
        for line, table in enumerate(pair):
            ax = axes[line, column]
            _panel(ax, [r for r in rows if r["table"] == table and r["column"] == "e_tt"])
            fitted = " (fitted)" if table == "9.3" else ""
            ax.set_title(f"{law}, {table}{fitted}", fontsize=10)
    for line, side in enumerate(SIDES):
        axes[line, 0].set_ylabel(f"{side}\ntracking error [%]")
    for ax in axes[1]:
        ax.set_ylim(0)  # of both above each other, once both are drawn
        ax.set_xlabel("ω [rad/s]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    write_whole(path, lambda target: figure.savefig(target, dpi=110, metadata={"Software": None}))


def _panel(ax: Axes, rows: Sequence[Prediction]) -> None:
    omega = [float(row["row"].split()[-1]) for row in rows]

    def values(key: str) -> list[float]:
        return [float("nan") if row[key] is None else row[key] for row in rows]

    ax.fill_between(
        omega,
        values("low"),
        values("high"),
        color=PREDICTED,
        alpha=0.2,
        lw=0,
        label="its 95 % interval of friction",
    )
    ax.plot(omega, values("predicted"), "o-", color=PREDICTED, ms=5, label="twin with friction")
    ax.plot(omega, values("frictionless"), "s-", color=CLEAN, ms=4, label="frictionless twin")
    ax.plot(omega, values("thesis"), "D", color=MEASURED, ms=6, label="measured on the rig")
    ax.set_xticks(omega)
    ax.grid(alpha=0.3)
