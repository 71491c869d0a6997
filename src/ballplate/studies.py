"""Many runs over the values of some keys: sweeps and studies, and what they found."""

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
from twin.base.page import Block, Picture, Table, Text, fragment
from twin.base.parts import left_out
from twin.base.shipped import find
from twin.base.writing import write_whole
from twin.run.files import INDICATOR_UNITS, nearest_indicator
from twin.run.tables import INDICATOR_LABELS, by_run

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from matplotlib.figure import Figure

    from twin.scenario.schema import Scenario
    from twin.study.answers import Answer
    from twin.study.experiments import Do
    from twin.study.screen import Screen, Screened
    from twin.study.work import Work


DRAWN_INDICATORS = ("tracking_error_percent", "rms_error")
"""The first of these indicators that applies is drawn unless one is named."""
MOST_RIGS = 100_000
"""Largest number of rigs, and of a draw, that may be asked for."""
TITLE_WIDTH = 80
"""Characters in a line of the title."""


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
            title = "\n".join(textwrap.wrap(self.title, TITLE_WIDTH))
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


@dataclass(repr=False, eq=False)
class StudyResult:
    """Result of a study; shows itself in a notebook.

    Attributes:
        work: Its runs, with the study as it was asked.
        rows: Key, outcome, reason and indicators of every run, as an Arrow table.
        answers: Statistics, one per variant.
        screened: What many more points on the exact equations add, if the study was screened.

    Examples:
        >>> import ballplate as bp
        >>> from pathlib import Path
        >>> file = Path("own.toml")
        >>> _ = file.write_text('''
        ... title = "Speed of the circle"
        ... scenario = "circle"
        ... set = ["plant.kind=lagrange", "baseline=false", "duration=1.0"]
        ... method = "grid"
        ... [parameters."reference.omega"]
        ... values = [0.5, 1.0]
        ... unit = "rad/s"
        ... ''')
        >>> found = bp.study(file, seeds=1, processes=1)
        >>> found, len(found.to_pandas()), len(found.answers)
        (<StudyResult 'Speed of the circle': 2 runs>, 2, 1)
    """

    work: Work
    rows: pa.Table
    answers: list[Answer]
    screened: Screened | None = None

    @property
    def title(self) -> str:
        """Subject of the study, in a line."""
        return self.work.study.title

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title!r}: {plural(self.rows.num_rows, 'run')}>"

    @property
    def sentences(self) -> list[str]:
        """Its results, in sentences."""
        from twin.study.report import sentences

        return sentences(self.work.study, self.answers)

    def to_pandas(self) -> pd.DataFrame:
        """A row per run: variant, point, seed, parameters, outcome, indicators."""
        from twin.study.experiments import label_rows

        return label_rows(self.work.labels, self.rows).to_pandas()

    def pairs(self) -> pd.DataFrame:
        """A row per pair of variants: mean difference of the first metric, first minus second.

        ``half`` is the half-width of its 95 % interval, ``better`` and ``worse`` count the runs in
        which the first has the smaller value, or alone finished. Both met the same points and
        noises.
        """
        import pandas as pd

        from twin.study.report import pairs_of

        columns = ["first", "second", "mean", "half", "better", "worse", "both_failed"]
        found = pairs_of(self.work.study, self.answers)
        return pd.DataFrame([vars(each) for each in found], columns=columns)

    def plot(self) -> dict[str, Figure]:
        """Its figures by name: ``curves``, ``indices`` or ``scatter``, as the method has."""
        from twin.study.report import figures

        found = figures(self.work.study, self.answers)
        return {name: showable(figure) for name, figure in found.items()}

    def save(self, folder: str | Path) -> Path:
        """Write report.html, figures, rows.parquet and rows.csv into a folder; returns it.

        Of a screened study ``screened.csv``, too, with a row for each run beyond the study's own.

        Raises:
            RecordError: If a file cannot be written.
        """
        from twin.study.report import write

        write(self.work, self.rows, self.answers, Path(folder), self._screened_blocks)
        if self.screened is not None:
            from twin.study.screen_report import write_rows

            write_rows(self.screened, Path(folder))
        return Path(folder)

    @property
    def _screened_blocks(self) -> list[Block]:
        if self.screened is None:
            return []
        from twin.study.screen_report import blocks

        return blocks(self.work.study, self.screened)

    def _repr_html_(self) -> str:
        """For a notebook: sentences, a row per variant, figures."""
        from twin.study.report import compare_variants

        found = compare_variants(self.work.study, self.answers)
        pictures = [Picture("", png(figure)) for figure in self.plot().values()]
        blocks = [Text(self.sentences), found, *pictures, *self._screened_blocks]
        return fragment(self.title, blocks)


def study(
    name: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    processes: int | None = None,
    scheduler: str | None = None,
    reporter: Reporter | None = None,
    screen: int | None = None,
    **keys: Any,
) -> StudyResult:
    """Run a study: a shipped one by name, a TOML file, or a dictionary with its keys.

    Args:
        name: Its name or file, or its tables, as ``{"title": ..., "scenario": "circle",
            "parameters": {...}, ...}``.
        out: Folder for its report, where finished runs are kept, too: an interrupted study goes on
            there, a finished one answers at once. None keeps nothing.
        processes: Processes to use; all processors by default.
        scheduler: Address of a Dask scheduler that has the workers.
        reporter: Receives progress; a notebook has its own.
        screen: Of a ``montecarlo`` or ``sobol`` study so many times as many further points on the
            exact equations, in compiled C where that is possible: estimates of the mechanism from
            both, with the bias of the exact equations, and the worst and best points on the
            mechanism.
        keys: Keys in place of the study's own, as ``samples=8`` or ``seeds=2``.

    Raises:
        TwinError: If there is no such study, or anything in it is unknown or out of range.

    Examples:
        >>> import ballplate as bp
        >>> friction = {
        ...     "title": "Rolling friction",
        ...     "scenario": "circle",
        ...     "set": ["plant.kind=lagrange", "baseline=false", "duration=1.0"],
        ...     "method": "grid",
        ...     "parameters": {"plant.friction.rolling_mm": {"values": [0.1, 0.2], "unit": "mm"}},
        ... }
        >>> rows = bp.study(friction, seeds=1, processes=1).to_pandas()
        >>> rows["outcome"].tolist()
        ['finished', 'finished']
    """
    from twin.study.answers import answers
    from twin.study.experiments import Store, carry, executors

    report = reporter or default()
    check_processes(processes, report)
    called = name if isinstance(name, Mapping) else str(name)
    work, screening = screened_work_of(called, keys, screen, report)
    folder = writable(out, report)
    store = Store(folder)
    with executors(processes, scheduler) as (executor, count):

        def finish(some: Work, title: str = work.study.title) -> pa.Table:
            do: Do | None = None
            if some.study.engine == "c":
                from twin.study.compiled import carry_out_compiled

                do = carry_out_compiled
            with report.progress(title, some.different, "runs") as advance:
                return carry(
                    some,
                    store,
                    executor=executor,
                    processes=count,
                    do=do,
                    progress=lambda done, failed: advance(done, f"{failed} failed"),
                )

        rows = finish(work)
        screened = None if screening is None else screening.carry_out(rows, finish)
    found = StudyResult(work, rows, answers(work, rows), screened)
    if folder is not None:
        found.save(folder)
    return found


def screened_work_of(
    name: str | Mapping[str, Any], keys: Mapping[str, Any], times: int | None, reporter: Reporter
) -> tuple[Work, Screen | None]:
    """The runs of a study, and those of its screen if it has one.

    Args:
        name: Name, file or tables of the study.
        keys: Keys in place of the study's own.
        times: Points on the exact equations for each on the mechanism; None for no screen.
        reporter: Has the names of the arguments in messages.

    Raises:
        ScenarioError: If the study is wrong or cannot be screened.
    """
    if times is not None and keys.get("engine") == "c":
        engine, screen = map(reporter.name_of, ("engine", "screen"))
        raise ScenarioError(
            f"{engine} c: not with {screen}, whose runs on the mechanism need Python; leave it "
            "out: the further runs are in C where all their settings allow it"
        )
    work = work_of(name, keys)
    return work, None if times is None else screen_of(name, work, times)


def screen_of(name: str | Mapping[str, Any], work: Work, times: int) -> Screen:
    """The runs of a screened study, each of them checked.

    Args:
        name: Name, file or tables of the study.
        work: Its runs on the mechanism.
        times: Points on the exact equations for each on the mechanism.

    Raises:
        ScenarioError: If it cannot be screened, as when the exact equations do not have a setting
            or its points are not drawn independently.
    """
    from twin.study.compiled import knows
    from twin.study.screen import Screen

    try:
        screen = Screen(work, times, "c")
        works = (screen.paired, screen.wide)
        if not knows(each.scenario(task) for each in works for task in each.tasks):
            screen = Screen(work, times)
    except ScenarioError as error:
        called = work.study.title if isinstance(name, Mapping) else name
        raise ScenarioError(f"study {called}: {error}") from error
    return screen


def family(
    source: str | Path | Mapping[str, Any],
    count: int,
    *,
    draw: int = 0,
    scenario: str | Path = "circle",
) -> list[dict[str, Any]]:
    """Draw rigs of a family: settings of each, as ``run(..., settings=...)`` takes them.

    Args:
        source: Name of a shipped family, a TOML file, or its tables.
        count: Number of rigs, 1 to 100,000.
        draw: Number of the draw, 0 or more; no two draws have a rig in common, and the first rigs
            of a draw are the same however many are drawn.
        scenario: Name or file of the scenario of which factors are taken, and entries of a list
            that are not drawn.

    Raises:
        ScenarioError: If there is no such family or scenario, or anything in it, the number of
            rigs or the number of the draw is unknown or out of range.

    Examples:
        >>> import ballplate as bp
        >>> rigs = bp.family("uncertain", 2, draw=1)
        >>> [round(rig["plant.friction.rolling_mm"], 3) for rig in rigs]
        [0.219, 0.181]
        >>> bp.run("circle", settings=rigs[0], duration=0.1).outcome
        'finished'
    """
    from twin.study.schema import draw_rigs, read_family
    from twin.study.work import Builder

    for name, value, low in (("count", count, 1), ("draw", draw, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= MOST_RIGS:
            what = f"a whole number from {low} to {MOST_RIGS}"
            raise ScenarioError(f"family: {name} must be {what}, got {value!r:.40}")
    found = read_family(source if isinstance(source, Mapping) else str(source))
    relative = {key for key, parameter in found.parameters.items() if parameter.relative}
    builder = Builder(str(scenario))
    return [
        {**builder.whole_keys((), rig.point, relative), "seed": rig.seed}
        for rig in draw_rigs(found, draw, count)
    ]


def work_of(name: str | Mapping[str, Any], keys: Mapping[str, Any]) -> Work:
    """The runs of a study, each of them checked.

    Args:
        name: Name, file or tables of the study.
        keys: Keys in place of the study's own; None for those that are not.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    from controllers.catalog import in_files_only
    from twin.study.schema import read
    from twin.study.work import Work

    about = read(name, **keys)
    try:
        # a run is kept under the text of its law: one of a notebook has none
        with in_files_only():
            if about.engine == "c":
                from twin.study.compiled import KnownCheck

                check = KnownCheck()
                work = Work(about, check=check)
                check.check_controllers()
                return work
            return Work(about)
    except ScenarioError as error:  # it names the scenario
        called = about.title if isinstance(name, Mapping) else name
        raise ScenarioError(f"study {called}: {error}") from error
