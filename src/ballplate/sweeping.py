"""Indicators over the values of some keys: many runs of which only the numbers are kept."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ballplate.changes import Changes, Settings, changes_of, scenario_of, varied_of
from ballplate.comparing import cases_of
from ballplate.reporter import Reporter, default
from ballplate.running import importable
from ballplate.swept import Sweep
from twin.errors import LawError, ScenarioError
from twin.shipped import find
from twin.writing import check_writable

if TYPE_CHECKING:
    from twin.scenario.schema import Scenario


def sweep(
    scenario: str | Path,
    vary: Mapping[str, Iterable[Any]],
    *,
    settings: Settings = (),
    out: str | Path | None = None,
    processes: int | None = None,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Sweep:
    """Run a scenario for every combination of values; each run is that of ``run``.

    ``sweep("circle", {"plant.friction.rolling_mm": np.linspace(0, 0.5, 6)}).plot()``

    Args:
        scenario: A shipped scenario, or a TOML file.
        vary: Dotted key, or a table as ``controller``, to the values that it takes.
        settings: What else is changed, by dotted keys or as texts ``KEY=VALUE``.
        out: Folder to save in; see ``Sweep.save`` for later.
        processes: Processes to use; all processors by default.
        reporter: Who is told progress; a notebook has its own.
        changes: What else is changed, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown, out of range or
            cannot be assembled.
        KeyboardInterrupt: If the user interrupts before any run has ended; later, what has ended
            is kept.
    """
    find(str(scenario))  # a wrong name is told before anything heavy is imported
    from twin import jobs
    from twin.scenario.variants import comparison, headings

    base, varied = changes_of(settings, changes), varied_of(vary)
    if not varied or not all(varied.values()):
        raise ScenarioError("vary: name at least one key, each with at least one value")
    report = reporter or default()
    title = scenario_of(scenario, base, titled=False).title
    cases = [case.scenario for case in cases_of([str(scenario)], base, varied).values()]
    if out is not None:
        check_writable(Path(out), report.name_of("out"))
    count = processes or jobs.cores()
    if not all(map(importable, cases)):
        count = 1
    rows: dict[int, dict[str, Any]] = {}
    with report.progress("sweep", len(cases), "runs") as advance:
        try:
            for number, row in jobs.results(_judged, enumerate(cases), min(count, len(cases))):
                rows[number] = row
                advance(len(rows))
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
    points = list(itertools.product(*plain))
    done = Sweep(
        title,
        list(varied),
        points,
        [rows.get(number, _none("not run")) for number in range(len(cases))],
    )
    if out is not None:
        done.save(out)
    return done


def _judged(scenario: Scenario) -> dict[str, Any]:
    """The indicators of a run; of one whose law raises an error none, but its line."""
    from twin.run import finished

    try:
        done = finished.run(scenario)
    except LawError as error:
        return _none("failed") | {"reason": str(error)}
    if done.interrupted:
        raise KeyboardInterrupt
    return done.summary()


def _none(outcome: str) -> dict[str, Any]:
    """The indicators of a run that there is not, and why not."""
    from twin.run.indicators import UNITS

    return dict.fromkeys(UNITS) | {"outcome": outcome, "outcome_time": 0.0}
