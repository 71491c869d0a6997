"""Sweeps: one scenario with every combination of some values, and the indicators of each run."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ballplate.changes import (
    Changes,
    Settings,
    Vary,
    changes_of,
    scenario_of,
    varied_of,
    warn_of_replaced,
)
from ballplate.comparing import map_scenarios
from ballplate.comparison_cases import cases_of
from ballplate.reporter import Reporter, check_processes, default, png, showable, writable
from twin.base.errors import LawError, ScenarioError, plural
from twin.base.page import Picture, Table, fragment
from twin.base.parts import left_out
from twin.base.shipped import find
from twin.base.writing import write_whole
from twin.run.indicators import INDICATOR_UNITS, nearest_indicator
from twin.run.tables import INDICATOR_LABELS, by_run

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from twin.scenario.schema import Scenario

DRAWN_INDICATORS = ("tracking_error_percent", "rms_error")
"""Indicators of which the first that applies is drawn, if no indicator is named."""
MAX_TITLE_WIDTH = 80
"""Maximum number of characters in a line of the title."""


@dataclass(repr=False, eq=False)
class Sweep:
    """Indicators of runs over the values of some keys; shows itself in a notebook.

    Attributes:
        title: What was swept.
        keys: What was varied.
        points: The values of the keys, one tuple a run; of a table what tells it from the others.
        rows: The indicators of each run, as ``Result.summary``.

    Examples:
        >>> import ballplate as bp
        >>> settings = {"plant.kind": "lagrange", "duration": 1}
        >>> found = bp.sweep("circle", {"reference.omega": [0.5, 0.75]}, settings=settings)
        >>> found
        <Sweep 'Circle of 150 mm ...' over reference.omega: 2 runs>
        >>> found["outcome"]
        ['finished', 'finished']
    """

    title: str
    keys: Sequence[str]
    points: Sequence[tuple[Any, ...]]
    rows: Sequence[Mapping[str, Any]]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return f"<Sweep {self.title!r} over {', '.join(self.keys)}: {plural(len(self), 'run')}>"

    def __getitem__(self, metric: str) -> list[Any]:
        """An indicator of every run; None where it does not apply.

        Raises:
            ScenarioError: If there is none of that name.
        """
        known = dict.fromkeys(name for row in self.rows for name in row)
        if metric not in known:
            raise ScenarioError(f"no indicator '{metric}'{nearest_indicator(metric, known)}")
        return [row.get(metric) for row in self.rows]

    @property
    def finished(self) -> bool:
        """Whether every run ran to its end."""
        return all(row["outcome"] == "finished" for row in self.rows)

    @property
    def values(self) -> list[Any]:
        """Those of the first key, in order."""
        return list(dict.fromkeys(point[0] for point in self.points))

    @property
    def curves(self) -> dict[str, list[Mapping[str, Any]]]:
        """The rows over the values of the first key, by the values of the others."""
        found: dict[str, list[Mapping[str, Any]]] = {}
        for point, row in zip(self.points, self.rows, strict=True):
            found.setdefault(", ".join(map(format_value, point[1:])), []).append(row)
        return found

    def to_pandas(self) -> pd.DataFrame:
        """A row per run: values of the keys, then indicators."""
        import pandas as pd

        values = [dict(zip(self.keys, point, strict=True)) for point in self.points]
        lines = [{**at, **row} for at, row in zip(values, self.rows, strict=True)]
        return pd.DataFrame(lines)

    def table(self) -> Table:
        """The indicators that come first, a line per run; of one that ended early how it did."""
        runs = {}
        for at, row in zip(self.points, self.rows, strict=True):
            when = "" if row["outcome_time"] is None else f" at {row['outcome_time']:.3g} s"
            early = {"outcome": row["outcome"] + when}
            runs[", ".join(map(format_value, at))] = row if row["outcome"] == "finished" else early
        return by_run(runs, ", ".join(self.keys))

    def csv(self) -> str:
        """A line per run: values of the keys, every indicator with its unit in the header."""
        names = ["outcome", *(name for name in INDICATOR_UNITS if name != "real_time_factor")]
        frame = self.to_pandas().reindex(columns=[*self.keys, *names])
        frame.columns = [
            f"{name} [{INDICATOR_UNITS[name]}]" if name in INDICATOR_UNITS else name
            for name in frame
        ]
        return frame.to_csv(index=False, lineterminator="\n")

    def plot(self, *metrics: str) -> Figure:
        """Indicators over the first key, a curve for each value of the others.

        Runs that ended early are crosses at the top.

        Args:
            metrics: Their names, as ``settling_time``; by default the tracking error, or, where
                it does not apply, the RMS error.

        Raises:
            ScenarioError: If there is none of that name.
        """
        import numpy as np

        from twin.run.picture import literal, style, styled_figure

        known = [name for name in DRAWN_INDICATORS if any(each is not None for each in self[name])]
        wanted = metrics or known[:1] or DRAWN_INDICATORS[:1]
        for name in wanted:
            self[name]  # tells which there are
        numeric = all(isinstance(value, int | float) for value in self.values)
        at = np.array(self.values if numeric else [*map(format_value, self.values)])
        with styled_figure(8, 1.6 + 2.8 * len(wanted)) as figure:
            title = "\n".join(textwrap.wrap(self.title, MAX_TITLE_WIDTH))
            figure.suptitle(literal(title), fontsize=11, fontweight="bold")
            panels = figure.subplots(len(wanted), sharex=True, squeeze=False)[:, 0]
            for panel, name in zip(panels, wanted, strict=True):
                words, unit = INDICATOR_LABELS.get(name, (name, ""))
                for index, (curve, rows) in enumerate(self.curves.items()):
                    early = np.array([row["outcome"] != "finished" for row in rows])
                    each = np.array([row.get(name) for row in rows], float)
                    shown = np.where(early, np.nan, 1000 * each if unit == "mm" else each)
                    (line,) = panel.plot(
                        at, shown, marker="o", ms=4, label=literal(curve), **style(index)
                    )
                    cross = {"color": line.get_color(), "transform": panel.get_xaxis_transform()}
                    if early.any():
                        panel.plot(at[early], np.ones(early.sum()), "x", clip_on=False, **cross)
                panel.set(ylabel=f"{words} [{unit}]", ylim=(0, None))
            early_too = "" if self.finished else "  (×: the run ended early)"
            panels[-1].set_xlabel(f"{self.keys[0]}{early_too}")
            if len(self.curves) > 1:
                handles = panels[0].get_legend_handles_labels()
                of = ", ".join(self.keys[1:])
                figure.legend(*handles, loc="outside lower center", ncols=4, title=of)
        return showable(figure)

    def save(self, folder: str | Path) -> Path:
        """Write sweep.png and sweep.csv into a folder; returns it.

        Raises:
            RecordError: If they cannot be written.
        """
        place = Path(folder)
        with left_out(file := place / "sweep.png"):
            figure = self.plot()
            write_whole(file, lambda path: figure.savefig(path, format="png", dpi=110))
        with left_out(file := place / "sweep.csv"):
            write_whole(file, self.csv())
        return place

    def _repr_html_(self) -> str:
        """For a notebook: the tracking error of every run, and its curve."""
        return fragment(self.title, [self.table(), Picture("", png(self.plot()))])


def format_value(value: Any) -> str:
    """A value in the digits a person wants to read."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def sweep(
    scenario: str | Path,
    vary: Vary,
    *,
    settings: Settings = (),
    out: str | Path | None = None,
    processes: int | None = None,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Sweep:
    """Run a scenario for every combination of values; each run is as by ``run``.

    Args:
        scenario: A shipped scenario, or a TOML file.
        vary: Dotted key, or a table as ``controller``, to the values that it takes; or texts
            ``KEY=[A, B, ...]``.
        settings: What else is changed, by dotted keys or as texts ``KEY=VALUE``.
        out: Folder to save in; see ``Sweep.save`` for later.
        processes: Processes to use; all processors by default.
        reporter: Receives progress; a notebook has its own.
        changes: What else is changed, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown, out of range or
            cannot be assembled.
        KeyboardInterrupt: If the user interrupts before any run has ended; later, what has ended
            is kept.

    Examples:
        >>> import ballplate as bp
        >>> settings = {"plant.kind": "lagrange", "duration": 4}
        >>> found = bp.sweep("circle", {"plant.friction.rolling_mm": [0, 0.2]}, settings=settings)
        >>> [f"{error:.0f} %" for error in found["tracking_error_percent"]]
        ['0 %', '32 %']
    """
    find(str(scenario))  # a wrong name is reported before anything heavy is imported
    from twin.scenario.variations import comparison, headings

    base, varied = changes_of(settings, changes), varied_of(vary)
    if not varied:
        raise ScenarioError("vary: give at least one key")
    report = reporter or default()
    check_processes(processes, report)
    title = scenario_of(scenario, base, titled=False).title
    warn_of_replaced([scenario], base, report)
    cases = [case.scenario for case in cases_of([str(scenario)], base, varied).values()]
    folder = writable(out, report)
    rows: dict[int, dict[str, Any]] = {}
    try:
        numbered = dict(enumerate(cases))
        rows.update(map_scenarios(_evaluate_runs, numbered, processes, report, "sweep"))
    except KeyboardInterrupt:
        if not rows:
            raise
    plain = [
        [
            heading if isinstance(value, list | dict) else value
            for value, heading in zip(values, headings(values), strict=True)
        ]
        for values in varied.values()
    ]
    title = comparison(title, varied, [each.text for each in base])
    every = [rows.get(number, _none("not run")) for number in range(len(cases))]
    done = Sweep(title, tuple(varied), list(itertools.product(*plain)), every)
    if folder is not None:
        done.save(folder)
    return done


def _evaluate_runs(scenarios: Sequence[Scenario]) -> list[dict[str, Any]]:
    """The indicators of each run; for a law that raises an error its line instead."""
    from twin.run.together import run_together

    return [
        _none("failed") | {"reason": str(done)} if isinstance(done, LawError) else done.summary()
        for done in run_together(scenarios)
    ]


def _none(outcome: str) -> dict[str, Any]:
    """The indicators of a run that there is not, and why not."""
    return dict.fromkeys(INDICATOR_UNITS) | {"outcome": outcome}
