"""Runs side by side, scenarios or variants of one and finished runs, as a mapping that draws."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, Unpack

from ballplate.changes import (
    Changes,
    KeyChange,
    Settings,
    Vary,
    changes_of,
    scenario_of,
    varied_of,
    warn_of_replaced,
)
from ballplate.dangers import warn_of_dangers, warn_of_path
from ballplate.reporter import (
    Reporter,
    check_processes,
    default,
    overview,
    showable,
    writable,
)
from ballplate.running import WORTH_PROCESS, importable
from twin.base.errors import LawError, ScenarioError, plural
from twin.base.parts import left_out
from twin.base.shipped import find
from twin.base.writing import write_json, write_whole
from twin.run.files import (
    MANIFEST_FILE,
    PICTURE_OF_MANY,
    folder_names,
    forget,
    number_name,
    sorted_out,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from ballplate.results import Log, Result
    from twin.run.finished import Run
    from twin.run.metrics import Motion
    from twin.scenario.schema import Dimensions, Scenario


MAX_NAME_LETTERS = 60
"""Most letters of a variant's name: it stands in legends, tables and folders."""
Label = TypeVar("Label")
Found = TypeVar("Found")


@dataclass(repr=False, eq=False)
class Comparison(Mapping[str, "Result"]):
    """Runs side by side, by what tells them apart; shows itself in a notebook.

    Attributes:
        runs: By what tells them apart.
        title: What is compared.
        names: What tables and pictures call each run.
        folders: Where each run that was just made is kept within a folder of the comparison, by
            label.
        interrupted: Whether Ctrl-C ended it before all had run.
        folder: Where it was saved as the runs came; None for nowhere.
        logs: Which of them are logs, by label.

    Examples:
        >>> import ballplate as bp
        >>> settings = {"plant.kind": "lagrange", "duration": 0.5}
        >>> found = bp.compare("circle", "sine", settings=settings)
        >>> list(found), found["circle"].units["measured_x"]
        (['circle', 'sine'], 'm')
        >>> found["sine"].outcome
        'finished'
    """

    runs: Mapping[str, Result]
    title: str
    names: Mapping[str, str]
    _: KW_ONLY
    folders: Mapping[str, str] = field(default_factory=dict)
    interrupted: bool = False
    folder: Path | None = None
    logs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Name of a run, or its label."""
        self.names = {label: self.names.get(label, label) for label in self.runs}

    def __getitem__(self, label: str) -> Result:
        """One of the runs."""
        return self.runs[label]

    def __iter__(self) -> Iterator[str]:
        return iter(self.runs)

    def __len__(self) -> int:
        return len(self.runs)

    @property
    def metrics(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.metrics``."""
        return {label: each.metrics for label, each in self.runs.items()}

    def to_pandas(self) -> pd.DataFrame:
        """The indicators, a row per run."""
        import pandas as pd

        return pd.DataFrame.from_dict(self.metrics, orient="index")

    @property
    def motions(self) -> dict[str, Motion]:
        """The motion of each run by what pictures call it."""
        return {self.names[label]: each.motion for label, each in self.runs.items()}

    def summaries(self) -> dict[str, dict[str, Any]]:
        """The indicators of each run, as ``Result.summary``."""
        return {label: each.summary() for label, each in self.runs.items()}

    def plot(self, panel: str | Sequence[str] | None = None, width_mm: float = 88.0) -> Figure:
        """All runs in one picture, or in panels of it; arguments as for ``Result.plot``."""
        from ballplate.results import draw_motions

        return showable(draw_motions(self.motions, self.title, self._plate, panel, width_mm))

    def save(self, folder: str | Path = "runs/compare") -> Path:
        """Write a folder per run and compare.png into a folder; returns it.

        Raises:
            RecordError: If it cannot be written, or a run is one that was opened.
        """
        from ballplate.results import save_result

        forget(Path(folder))
        self.folders = _folders_of(self.names)
        for label, each in self.runs.items():
            save_result(each, Path(folder) / self.folders[label])
        return self.draw(folder)

    def draw(self, folder: str | Path) -> Path:
        """Write the picture and the indicators alone into a folder; returns the folder.

        Raises:
            RecordError: If it cannot be written.
        """
        from twin.run.finished import draw_runs

        place = Path(folder)
        with left_out(file := place / PICTURE_OF_MANY):
            write_whole(file, draw_runs(self.motions, self.title, self._plate))
        content = {
            "folders": list(self.folders.values()),
            "names": [self.names[label] for label in self.folders],
            "linked": [
                {"position": position, "run": link_to(each.folder, place)}
                for position, (label, each) in enumerate(self.runs.items())
                if label not in self.folders and each.folder is not None
            ],
            "runs": self.summaries(),
        }
        write_json(place / MANIFEST_FILE, content)
        return place

    @property
    def _plate(self) -> Dimensions:
        return next(iter(self.runs.values())).scenario.dimensions

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title!r}: {', '.join(self.names.values())}>"

    def _repr_html_(self) -> str:
        """For a notebook: indicators and picture."""
        runs = {self.names[label]: each for label, each in self.runs.items()}
        return overview(self.title, runs, self.plot())


def _folders_of(names: Mapping[str, str]) -> dict[str, str]:
    """The folder of each run within the folder of the comparison, by label.

    Args:
        names: What tables and pictures call each run, by label.
    """
    return dict(zip(names, folder_names(names.values()), strict=True))


def link_to(folder: Path, place: Path) -> str:
    """The path of a folder from a place; the whole path where there is none, as across drives."""
    try:
        return Path(os.path.relpath(folder.resolve(), place.resolve())).as_posix()
    except ValueError:
        return str(folder.resolve())


class Case(NamedTuple):
    """A run of a comparison.

    Attributes:
        scenario: What is run.
        name: What tables and pictures call it.
        source: Name or file of the scenario that it is a variant of.
    """

    scenario: Scenario
    name: str
    source: str


def compare(
    *sources: str | Path | Result,
    variants: Mapping[str, Settings] | Sequence[str] = (),
    vary: Vary | None = None,
    settings: Settings = (),
    out: str | Path | None = None,
    processes: int | None = None,
    columns: str | None = None,
    separator: str | None = None,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Comparison:
    """Run several scenarios, or variants of one, side by side, together with finished runs.

    ``compare("circle", variants={"PID": {"controller.kind": "pid"}, "LQR": {"controller.kind":
    "lqr"}})`` runs these two, under their names; ``vary={"controller.kind": ["afl", "lqr"]}`` all
    combinations of values. Finished runs are shown as they are, logs over the twin's prediction
    for the first scenario. They are in the order of the sources.

    Args:
        sources: Scenarios by name or TOML file, run folders, CSV logs, results of ``run`` or
            ``load``.
        variants: Name to changes of the first scenario, which runs once for each and not as it
            is; or texts ``NAME=KEY=VALUE; KEY=VALUE``.
        vary: What is varied, all combinations of it, as a table or texts ``KEY=[A, B, ...]``; of
            scenarios, not of what is finished.
        settings: What is changed of all scenarios.
        out: Folder to save in as the runs come; see ``Comparison.save`` for later.
        processes: Processes to use; all processors by default.
        columns: Of logs of any rig, as ``identify`` takes them.
        separator: Between these.
        reporter: Receives progress and warnings.
        changes: What is changed of all scenarios, by tables.

    Raises:
        TwinError: If there is no such scenario, run or log, or anything in it is unknown, out of
            range or cannot be assembled, or the folder cannot be written.
        KeyboardInterrupt: If the user interrupts before any has run.

    Examples:
        >>> import ballplate as bp
        >>> settings = {"plant.kind": "lagrange", "duration": 4}
        >>> laws = {"controller.kind": ["afl", "lqr"]}
        >>> found = bp.compare("circle", vary=laws, settings=settings)
        >>> for label, metrics in found.metrics.items():
        ...     print(f"{label}: tracking error {metrics['tracking_error_percent']:.0f} %")
        controller.kind=afl: tracking error 30 %
        controller.kind=lqr: tracking error 53 %
    """
    if not sources:
        raise ScenarioError("compare: name a scenario or give a result")
    given = [str(source) for source in sources if isinstance(source, str | Path)]
    names, folders, logs = sorted_out(given, of_any_rig=columns is not None)
    report = reporter or default()
    check_processes(processes, report)
    if separator is not None and columns is None:
        pair = map(report.name_of, ("separator", "columns"))
        raise ScenarioError("{}: needs {}, the columns of a log of any rig".format(*pair))
    if columns is not None and not logs:
        what = report.name_of("columns")
        raise ScenarioError(f"{what}: describe a log; name one, such as run.csv")
    if vary and not names:
        what = report.name_of("vary")
        raise ScenarioError(f"{what}: nothing to run; name a scenario, such as circle")
    for name in names:
        find(name)  # a wrong name is reported before anything heavy is imported
    from ballplate.results import Result
    from twin.run.opened import open_runs
    from twin.scenario.variations import comparison

    base, varied = changes_of(settings, changes), varied_of(vary or {}, report.name_of("vary"))
    chosen = variants_of(variants, names, report) if variants else {}
    if chosen and varied:
        what = " and ".join(map(report.name_of, ("variants", "vary")))
        raise ScenarioError(f"{what}: give only one of them")
    found = open_runs(folders, tell=report.warn) if folders else []
    results = _results_among(sources)
    opened = [*map(Result.from_run, found), *results]
    recorded, fitted = runs_of_logs(logs, names, opened, base, (columns, separator), report.warn)
    shown = [*map(Result.from_run, recorded), *opened]
    own = report.name_of("variants")
    cases = cases_of(names, [*fitted, *base], varied, chosen, alone=not shown, what=own)
    warn_of_replaced(names, base, report)
    finished = label_runs(shown, cases)
    listed = ", ".join((*chosen, *names[bool(chosen) :], *finished))
    named = any(each.key == "title" for each in base) or (len(names) == 1 and not finished)
    what = next(iter(cases.values())).scenario.title if cases and named else listed
    folder = writable(out, report)
    if folder is not None:
        forget(folder)
    own_folders = _folders_of({label: case.name for label, case in cases.items()})
    places = {} if folder is None else {label: folder / name for label, name in own_folders.items()}
    runs = _run_cases(cases, processes, places, report, needed=not finished)
    positions = _positions(
        sources, cases, dict(zip(finished, [*logs, *found, *results], strict=True))
    )
    done = Comparison(
        dict(sorted((finished | runs).items(), key=lambda each: positions[each[0]])),
        comparison(what, varied, [each.text for each in base]),
        {label: cases[label].name for label in runs},
        folders={label: own_folders[label] for label in runs},
        interrupted=len(runs) < len(cases),
        folder=folder,
        logs=tuple(each.name for each in recorded),
    )
    if folder is not None:
        done.draw(folder)
    return done


def _results_among(sources: Sequence[str | Path | Result]) -> list[Result]:
    """The sources that are results already, in their order.

    Raises:
        ScenarioError: If a source is neither a name or file nor a result.
    """
    from ballplate.results import Result

    results = [each for each in sources if not isinstance(each, str | Path)]
    for each in results:
        if not isinstance(each, Result):
            raise ScenarioError(f"compare: takes names, files and results, got {each!r:.60}")
    return results


def _run_cases(
    cases: Mapping[str, Case],
    processes: int | None,
    places: Mapping[str, Path],
    reporter: Reporter,
    *,
    needed: bool,
) -> dict[str, Result]:
    """Run the scenarios of a comparison; their results by label, in its order.

    Args:
        cases: By label.
        processes: Processes to use; all processors by default.
        places: Where each run is saved as it comes, by label; empty for nowhere.
        reporter: Receives progress, warnings and the errors of laws.
        needed: Whether at least one of them must run.

    Raises:
        LawError: If a run is needed and every law failed.
        KeyboardInterrupt: If the user interrupts before any has run.
    """
    from ballplate.results import Result, save_result

    runs: dict[str, Result] = {}
    failed: list[LawError] = []
    scenarios = {label: case.scenario for label, case in cases.items()}
    _warn(scenarios, reporter)
    try:
        for label, came in carried_out(attempt, scenarios, processes, reporter, "comparison"):
            if isinstance(came, LawError):
                failed.append(came)
                reporter.warn(f"{label}: {came}")
                continue
            run = Result.from_run(came, label)
            runs[label] = save_result(run, places[label]) if places else run
    except KeyboardInterrupt:
        if not runs:
            raise
        reporter.warn("interrupted: unfinished runs are not in the table")
    if failed and needed and not runs:
        raise failed[0]
    return {label: runs[label] for label in cases if label in runs}


def _warn(scenarios: Mapping[str, Scenario], reporter: Reporter) -> None:
    """Warn of the dangers of each scenario."""
    for label, each in scenarios.items():
        with suppress(LawError):  # its run will tell
            own = label if len(scenarios) > 1 else ""
            warn_of_dangers(each, reporter, own)
            warn_of_path(each, reporter, own)


def runs_of_logs(
    logs: Sequence[Path],
    names: Sequence[str],
    finished: Sequence[Run],
    base: Sequence[KeyChange],
    columns_and_separator: tuple[str | None, str | None],
    tell: Callable[[str], None],
) -> tuple[list[Run], list[KeyChange]]:
    """Logs as runs, and what their prediction is to be changed to.

    Args:
        logs: Files.
        names: Of scenarios; the first one's reference is the logs'.
        finished: Finished runs; without scenarios, the first gives the reference.
        base: What is changed of the scenario.
        columns_and_separator: The columns of logs of any rig, None of other logs; their separator.
        tell: Receives what was left out of them.
    """
    from twin.identify.any_logs import read_any
    from twin.identify.log_columns import wanted_columns
    from twin.run.logs import fitting, log_run, read_log

    runs: list[Run] = []
    fitted: list[KeyChange] = []
    columns, separator = columns_and_separator
    for path in logs:
        if not (names or finished):
            raise ScenarioError(
                f"{path}: a log has no reference; name the scenario that was recorded, as in: "
                f"ballplate compare {path} circle"
            )
        scenario = scenario_of(names[0], base, titled=False) if names else finished[0].scenario
        if columns is None:
            rows = read_log(path)
        else:
            log = read_any(path, wanted_columns(columns), separator)
            rows = log.on(scenario).columns
            for note in log.notes:
                tell(f"{path.name}: {note}")
        if names:
            own = changes_of(fitting(rows, scenario), {})
            fitted = fitted or own
            scenario = scenario_of(names[0], [*own, *base], titled=False)
        name = number_name(path.stem, [run.name for run in runs])
        runs.append(log_run(rows, scenario, name))
    return runs, fitted


def cases_of(
    names: Sequence[str],
    base: Sequence[KeyChange],
    varied: Mapping[str, Sequence[Any]],
    chosen: Mapping[str, Sequence[KeyChange]] | None = None,
    *,
    alone: bool = True,
    what: str = "variants",
) -> dict[str, Case]:
    """Label to case of every run: each scenario with each combination of what is varied.

    Args:
        names: Scenarios.
        base: What is changed of all of them.
        varied: Key to plain values.
        chosen: Changes of the first scenario by the name of the variant, in place of that scenario.
        alone: Whether nothing else is shown.
        what: The argument of the variants in messages.

    Raises:
        ScenarioError: If anything in them is unknown or out of range, or a variant has the name of
            a scenario that is run as it is.
    """
    from twin.scenario.variations import variants

    cases: dict[str, Case] = {}
    for called, changed in (chosen or {}).items():
        scenario = scenario_of(names[0], [*base, *changed], titled=False)
        cases[called] = Case(scenario, called, names[0])
    for name in names[1:] if chosen else names:
        if name in (chosen or {}):
            raise ScenarioError(
                f"{what} '{name}': a scenario of this comparison has this name; give another one"
            )
        named = (name,) if len(names) > 1 or not varied or not alone else ()
        for variant in variants(varied):
            label, called = (
                " ".join(filter(None, (*named, text))) for text in (variant.label, variant.name)
            )
            changed = changes_of((), dict(variant.settings))
            scenario = scenario_of(name, [*base, *changed], titled=False)
            cases[label] = Case(scenario, called, name)
    return cases


def variants_of(
    variants: Mapping[str, Settings] | Sequence[str], names: Sequence[str], reporter: Reporter
) -> dict[str, list[KeyChange]]:
    """The changes of each named variant.

    Args:
        variants: Name to settings, or texts ``NAME=KEY=VALUE; KEY=VALUE``.
        names: Scenarios, of which the first has variants.
        reporter: Knows what the argument is called.

    Raises:
        ScenarioError: If there is no scenario, or a name is empty, too long or there twice.
    """
    what = reporter.name_of("variants")
    if not names:
        raise ScenarioError(f"{what}: nothing to run; name a scenario, such as circle")
    given_names = [variants] if isinstance(variants, str) else variants
    if not isinstance(given_names, Mapping | Sequence) or not all(
        isinstance(each, str) for each in given_names
    ):
        raise ScenarioError(
            f"{what}: must be a table of names, or texts NAME='KEY=VALUE; KEY=VALUE', "
            f"got {variants!r:.60}"
        )
    if isinstance(given_names, Mapping):
        pairs: list[tuple[str, Settings]] = list(given_names.items())
    else:
        pairs = [_parse_variant(text, what) for text in given_names]
    found: dict[str, list[KeyChange]] = {}
    for given, settings in pairs:
        name = given.strip()
        if not name or len(name) > MAX_NAME_LETTERS or not name.isprintable():
            raise ScenarioError(f"{what} '{name:.80}': a name has 1 to {MAX_NAME_LETTERS} letters")
        if name in found:
            raise ScenarioError(f"{what} '{name}': two variants have this name")
        try:
            found[name] = changes_of(settings, {})
        except ScenarioError as error:
            raise ScenarioError(f"{what} '{name}': {error}") from None
    return found


def _parse_variant(text: str, what: str) -> tuple[str, Settings]:
    """Name and settings in a text ``NAME=KEY=VALUE; KEY=VALUE``; what: the argument in messages."""
    from twin.scenario.load import split_settings

    name, equals, rest = text.partition("=")
    if not equals:
        raise ScenarioError(f"{what} '{text:.80}': write NAME='KEY=VALUE; KEY=VALUE'")
    return name, split_settings(rest)


def label_runs(finished: Sequence[Result], taken: Collection[str] = ()) -> dict[str, Result]:
    """Finished runs by their names, or, where those are the same, by their titles.

    Args:
        finished: The runs.
        taken: Labels of runs that are shown with them; a run of that name is called by its folder.
    """
    names = [each.name for each in finished]
    found: dict[str, Result] = {}
    for each in finished:
        label = each.name if names.count(each.name) == 1 else each.title
        if label in taken and each.folder is not None:
            label = each.folder.as_posix()
        found[number_name(label, [*taken, *found])] = each
    return found


def _positions(
    sources: Sequence[str | Path | Result],
    cases: Mapping[str, Case],
    finished: Mapping[str, Path | Run],
) -> dict[str, int]:
    """The position of the source of each run, by label.

    Args:
        sources: As they were given.
        cases: The scenarios.
        finished: Finished runs and, of a log, its file.
    """
    from twin.run.files import is_last, last, run_folders

    found: dict[str, int] = {}
    given: dict[str, int] = {}
    for position, source in reversed(list(enumerate(sources))):
        if not isinstance(source, str | Path):
            found |= {label: position for label, each in finished.items() if each is source}
            continue
        path = last() if is_last(Path(source)) else Path(source)
        folders = run_folders(path) if path.is_dir() else [path, path.parent]
        given |= {os.path.realpath(each): position for each in folders}
        given[str(source)] = position
    for label, case in cases.items():
        found[label] = given[case.source]
    for label, each in finished.items():
        if label not in found:
            place = each if isinstance(each, Path) else each.folder
            found[label] = given.get(os.path.realpath(place or ""), len(sources))
    return found


def carried_out(
    work: Callable[[Sequence[Scenario]], Sequence[Found]],
    scenarios: Mapping[Label, Scenario],
    processes: int | None,
    reporter: Reporter,
    what: str,
) -> Iterator[tuple[Label, Found]]:
    """Label and result of every scenario, as they come; on several processes where that pays.

    Args:
        work: What is done with those of a batch, a function of a module; one result each.
        scenarios: By label.
        processes: How many; all processors by default.
        reporter: Receives progress.
        what: What the work is called there.
    """
    from twin.base import jobs

    if not scenarios:
        return
    long = sum(each.duration for each in scenarios.values()) >= 2 * WORTH_PROCESS
    count = min(processes or (jobs.cores() if long else 1), len(scenarios))
    if not all(map(importable, scenarios.values())):
        count = 1
    from twin.run.together import work_in_batches

    done = 0
    with reporter.progress(what, len(scenarios), "runs") as advance:
        for found in work_in_batches(work, scenarios, count):
            done += len(found)
            advance(done)
            yield from found


def attempt(scenarios: Sequence[Scenario]) -> list[Run | LawError]:
    """The runs of scenarios that share a batch, or how the law of each failed.

    Raises:
        KeyboardInterrupt: If the user interrupts them.
        TwinError: If one cannot be assembled.
    """
    from twin.run.together import run_together

    return list(run_together(scenarios))


def load(path: str | Path) -> Result | Comparison | Log:
    """Open what was recorded before.

    Args:
        path: A run folder or its ``run.parquet``; a folder of run folders, as ``compare`` writes
            them; or a CSV log with named columns, units in the header as ``measured_x [mm]``.

    Returns:
        A ``Result`` for a run, a ``Comparison`` for several, a ``Log`` for a CSV file.

    Raises:
        TwinError: If it cannot be opened: what is wrong with it, or which column it lacks.

    Examples:
        >>> import ballplate as bp
        >>> folder = bp.run("hold", ["plant.kind=lagrange"], duration=0.1).save("kept")
        >>> bp.load(folder)
        <Result 'Hold on the centre (plant.kind=lagrange, duration=0.1)': finished>
    """
    from ballplate.results import Log, Result
    from twin.identify import logs
    from twin.run.opened import open_runs

    file = Path(path)
    if file.suffix == ".csv":
        log = logs.read(file)
        return Log(
            log.source, log.columns, {name: logs.LOG_COLUMN_UNITS[name] for name in log.columns}
        )
    runs = {each.name: Result.from_run(each) for each in open_runs((file,), tell=default().warn)}
    if len(runs) == 1:
        return next(iter(runs.values()))
    return Comparison(runs, f"Comparison of {plural(len(runs), 'run')}", {})
