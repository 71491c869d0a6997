"""Scenarios, variants of one and finished runs, run and shown side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Unpack

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
from ballplate.comparison import Comparison, name_folders
from ballplate.comparison_cases import Case, cases_of, variants_of
from ballplate.dangers import warn_of_dangers, warn_of_path
from ballplate.reporter import Reporter, check_processes, default, writable
from ballplate.running import WORTH_PROCESS, importable
from twin.base.errors import LawError, ScenarioError
from twin.base.shipped import find
from twin.run.files import forget, number_name, sorted_out

if TYPE_CHECKING:
    from ballplate.results import Result
    from twin.run.finished import Run
    from twin.scenario.schema import Scenario


Label = TypeVar("Label")
Found = TypeVar("Found")


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
    _check_arguments(names, logs, vary, columns, separator, report)
    from ballplate.results import Result
    from twin.run.opened import open_runs

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
    folder = writable(out, report)
    runs = _run_cases(cases, processes, folder, report, needed=not finished)
    origins: dict[str, Path | Run | Result] = dict(
        zip(finished, [*logs, *found, *results], strict=True)
    )
    positions = _positions(sources, cases, origins)
    done = Comparison(
        dict(sorted((finished | runs).items(), key=lambda each: positions[each[0]])),
        _make_title(names, chosen, cases, finished, varied, base),
        {label: cases[label].name for label in runs},
        folders={label: name for label, name in _folders_of(cases).items() if label in runs},
        interrupted=len(runs) < len(cases),
        folder=folder,
        logs=tuple(each.name for each in recorded),
    )
    if folder is not None:
        done.draw(folder)
    return done


def _check_arguments(
    names: Sequence[str],
    logs: Sequence[Path],
    vary: Vary | None,
    columns: str | None,
    separator: str | None,
    reporter: Reporter,
) -> None:
    """Check that the arguments of ``compare`` fit together, before anything heavy is imported.

    Args:
        names: Scenarios among the sources.
        logs: Logs among the sources.
        vary: What is varied.
        columns: Columns of logs of any rig.
        separator: Separator of these.
        reporter: Has the names of the arguments in messages.

    Raises:
        ScenarioError: If an argument lacks the other one that it needs, or there is no such
            scenario, or it is named twice.
    """
    if twice := [name for name in names if names.count(name) > 1]:
        raise ScenarioError(f"{twice[0]}: given {names.count(twice[0])} times; give it once")
    if separator is not None and columns is None:
        pair = map(reporter.name_of, ("separator", "columns"))
        raise ScenarioError("{}: needs {}, the columns of a log of any rig".format(*pair))
    if columns is not None and not logs:
        what = reporter.name_of("columns")
        raise ScenarioError(f"{what}: describe a log; name one, such as run.csv")
    if vary and not names:
        what = reporter.name_of("vary")
        raise ScenarioError(f"{what}: nothing to run; name a scenario, such as circle")
    for name in names:
        find(name)


def _make_title(
    names: Sequence[str],
    chosen: Mapping[str, Sequence[KeyChange]],
    cases: Mapping[str, Case],
    finished: Mapping[str, Result],
    varied: Mapping[str, Sequence[Any]],
    base: Sequence[KeyChange],
) -> str:
    """The title of a comparison: of its only scenario, or else the names of all that is in it.

    Args:
        names: Scenarios.
        chosen: Named variants of the first scenario, run in its place.
        cases: The runs of the comparison, by label.
        finished: Finished runs, by label.
        varied: What is varied, by key.
        base: What is changed of all scenarios; a title among it is the comparison's.
    """
    from twin.scenario.variations import comparison

    if cases and (any(each.key == "title" for each in base) or (len(names) == 1 and not finished)):
        what = next(iter(cases.values())).scenario.title
    else:
        what = ", ".join((*chosen, *names[bool(chosen) :], *finished))
    return comparison(what, varied, [each.text for each in base])


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


def _folders_of(cases: Mapping[str, Case]) -> dict[str, str]:
    """The name of the folder of each run within the comparison's folder, by label."""
    return name_folders({label: case.name for label, case in cases.items()})


def _run_cases(
    cases: Mapping[str, Case],
    processes: int | None,
    folder: Path | None,
    reporter: Reporter,
    *,
    needed: bool,
) -> dict[str, Result]:
    """Run the scenarios of a comparison; their results by label, in its order.

    Args:
        cases: By label.
        processes: Processes to use; all processors by default.
        folder: Folder that each run is saved in as it comes, emptied first; None for nowhere.
        reporter: Receives progress, warnings and the errors of laws.
        needed: Whether at least one of them must run.

    Raises:
        LawError: If a run is needed and every law failed.
        KeyboardInterrupt: If the user interrupts before any has run.
    """
    from ballplate.results import Result, save_result

    if folder is not None:
        forget(folder)
    names = _folders_of(cases)
    runs: dict[str, Result] = {}
    failed: list[LawError] = []
    scenarios = {label: case.scenario for label, case in cases.items()}
    _warn(scenarios, reporter)
    try:
        for label, came in map_scenarios(attempt, scenarios, processes, reporter, "comparison"):
            if isinstance(came, LawError):
                failed.append(came)
                reporter.warn(f"{label}: {came}")
                continue
            run = Result.from_run(came, label)
            runs[label] = run if folder is None else save_result(run, folder / names[label])
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
    from twin.run.logs import check_second_axis, fitting, log_run, read_log

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
        check_second_axis(path.name, rows["measured_y"], scenario)
        if names:
            own = changes_of(fitting(rows, scenario), {})
            fitted = fitted or own
            scenario = scenario_of(names[0], [*own, *base], titled=False)
        name = number_name(path.stem, [run.name for run in runs])
        runs.append(log_run(rows, scenario, name))
    return runs, fitted


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
    finished: Mapping[str, Path | Run | Result],
) -> dict[str, int]:
    """The position of the source of each run, by label.

    Args:
        sources: As they were given.
        cases: The scenarios.
        finished: Results and finished runs and, of a log, its file.
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


def map_scenarios(
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
