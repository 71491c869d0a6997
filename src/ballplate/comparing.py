"""Several runs side by side: scenarios, variants of one, and runs that are finished."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ballplate.changes import Changes, Settings, changes_of, scenario_of
from ballplate.notebook import page, png_image, table
from ballplate.reporter import Reporter, default
from ballplate.running import WORTH_PROCESS, importable, one_run, warn_of_dangers
from ballplate.signals import pandas
from twin.errors import ScenarioError
from twin.shipped import find
from twin.writable import check_writable

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from ballplate.results import Result
    from twin.run.execute import Run
    from twin.scenario.schema import Scenario

Vary = Mapping[str, Iterable[Any]]
"""Dotted key, or a table as ``controller``, to the values that it takes in turn."""


class Comparison(Mapping[str, "Result"]):
    """Runs side by side, by what tells them apart; shows itself in a notebook.

    Attributes:
        title: What is compared.
        headings: What the table calls each run.
        interrupted: Whether Ctrl-C ended it before all had run.
    """

    def __init__(
        self,
        runs: Mapping[str, Result],
        title: str,
        headings: Mapping[str, str],
        *,
        interrupted: bool = False,
    ) -> None:
        self._runs = dict(runs)
        self.title = title
        self.headings = {label: headings.get(label, label) for label in runs}
        self.interrupted = interrupted

    def __getitem__(self, label: str) -> Result:
        """One of the runs."""
        return self._runs[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self._runs)

    def __len__(self) -> int:
        return len(self._runs)

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.metrics``."""
        return {label: each.metrics for label, each in self._runs.items()}

    def to_pandas(self) -> pd.DataFrame:
        """The indicators, a row per run.

        Raises:
            TwinError: If pandas is not installed.
        """
        return pandas().DataFrame.from_dict(self.metrics, orient="index")

    def plot(self) -> Figure:
        """All runs in one picture."""
        from twin.run.overview_plot import picture

        motions = {self.headings[label]: each.motion for label, each in self._runs.items()}
        area = next(iter(self._runs.values())).scenario.rig.limits.area
        return picture(motions, self.title, area)

    def save(self, folder: str | Path = "runs/compare") -> Path:
        """Write a folder per run and compare.png into a folder; returns it.

        Raises:
            RecordError: If it cannot be written, or a run is one that was opened.
        """
        from ballplate.results import kept

        for label, each in self._runs.items():
            kept(each, Path(folder) / _slug(label))
        return self.draw(folder)

    def draw(self, folder: str | Path) -> Path:
        """Write compare.png alone into a folder; returns the folder.

        Raises:
            RecordError: If it cannot be written.
        """
        from twin.run.overview_plot import draw

        motions = {self.headings[label]: each.motion for label, each in self._runs.items()}
        area = next(iter(self._runs.values())).scenario.rig.limits.area
        draw(Path(folder) / "compare.png", motions, self.title, area)
        return Path(folder)

    def _repr_html_(self) -> str:
        """For a notebook: indicators and picture."""
        from twin.report.numbers import rows

        found = rows([each.replay for each in self._runs.values()])
        lines = [(row.label, *row.values, row.unit) for row in found]
        shown = table(("", *self.headings.values(), "unit"), lines)
        return page(self.title, shown, png_image(self.plot()))


def compare(
    *scenarios: str | Path | Result,
    vary: Vary | None = None,
    settings: Settings = (),
    out: str | Path | None = None,
    processes: int | None = None,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Comparison:
    """Run several scenarios, or variants of one, side by side.

    ``compare("circle", vary={"controller.kind": ["afl", "lqr"]})``, or two laws with gains of
    their own: ``vary={"controller": [{"kind": "afl"}, {"kind": "lqr", "rho": 100}]}``. Finished
    runs, results of ``run`` or ``load``, stand beside them as they are.

    Args:
        scenarios: Names, TOML files and results.
        vary: What is varied, all combinations of it; of scenarios, not of results.
        settings: What is changed of all scenarios.
        out: Folder to save in as the runs come; see ``Comparison.save`` for later.
        processes: Processes to use; all processors by default.
        reporter: Who is told progress and warnings.
        changes: What is changed of all scenarios, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown, out of range or
            cannot be assembled.
    """
    from ballplate.results import Result

    report = reporter or default()
    runs = {each.name: each for each in scenarios if isinstance(each, Result)}
    names = [str(each) for each in scenarios if not isinstance(each, Result)]
    for name in names:
        find(name)  # a wrong name is told before anything heavy is imported
    base = changes_of(settings, changes)
    varied = {key: list(values) for key, values in (vary or {}).items()}
    cases: dict[str, Scenario] = {}
    headings: dict[str, str] = {}
    for name in names:
        named = (name,) if len(scenarios) > 1 or not varied else ()
        for values in itertools.product(*varied.values()):
            variant = changes_of((), dict(zip(varied, values, strict=True)))
            label = " ".join((*named, *(each.text for each in variant)))
            cases[label] = scenario_of(name, [*base, *variant], titled=False)
            shown = ", ".join(each.text.partition("=")[2] for each in variant)
            headings[label] = " ".join((*named, shown)).strip()
    folder = None if out is None else Path(out)
    if folder is not None:
        check_writable(folder, report.name_of("out"))
    if not (runs or cases):
        raise ScenarioError("compare: name a scenario or give a result")
    title = _title(varied, [each.text for each in base])
    return side_by_side(cases, runs, title, headings, folder, processes, report)


def side_by_side(
    cases: Mapping[str, Scenario],
    finished: Mapping[str, Result],
    title: str,
    headings: Mapping[str, str],
    folder: Path | None,
    processes: int | None,
    reporter: Reporter,
) -> Comparison:
    """Run cases and put them beside runs that are finished.

    Args:
        cases: Label to what is to run.
        finished: Label to run.
        title: What is compared.
        headings: Label to what the table calls the run.
        folder: Where each run is saved as it comes, and the picture; None for nowhere.
        processes: Processes to use; None for all processors if the runs are worth it.
        reporter: Who is told progress and warnings.

    Raises:
        TwinError: If a case cannot be assembled, or the folder cannot be written.
        KeyboardInterrupt: If the user interrupts before any has run.
    """
    from ballplate.results import Result, kept

    runs: dict[str, Result] = {}
    interrupted = False
    try:
        for label, done in _each(cases, processes, reporter):
            each = Result.of(done, label, label)
            runs[label] = each if folder is None else kept(each, folder / _slug(label))
    except KeyboardInterrupt:
        interrupted = True
        if not runs:
            raise
    ordered = {label: runs[label] for label in cases if label in runs}
    found = Comparison({**finished, **ordered}, title, headings, interrupted=interrupted)
    if folder is not None:
        found.draw(folder)
    return found


def _each(
    cases: Mapping[str, Scenario], processes: int | None, reporter: Reporter
) -> Iterator[tuple[str, Run]]:
    """Label and run of every case as they come, on as many processes as are worth it."""
    from twin import jobs
    from twin.run import execute

    if processes is None:
        long = sum(case.duration for case in cases.values()) >= 2 * WORTH_PROCESS
        processes = jobs.cores() if long else 1
    if min(processes, len(cases)) <= 1 or not all(map(importable, cases.values())):
        for label, case in cases.items():
            done = one_run(case, label, reporter)
            yield label, done
            if done.outcome.interrupted:
                return
        return
    for case in cases.values():
        warn_of_dangers(case, reporter)
    with reporter.progress(", ".join(cases), len(cases), "runs") as advance:
        found = jobs.results(execute.run, cases.items(), min(processes, len(cases)))
        for number, (label, done) in enumerate(found, 1):
            advance(number)
            yield label, done


def _title(varied: Iterable[str], changed: Iterable[str]) -> str:
    """What is compared: the keys whose values stand over the columns, and what all runs share."""
    keys, shared = ", ".join(varied), ", ".join(changed)
    over = f"Comparison over {keys}" if keys else "Comparison"
    return f"{over} ({shared})" if shared else over


def _slug(label: str) -> str:
    return "".join(char if char.isalnum() or char in "._-" else "-" for char in label)
