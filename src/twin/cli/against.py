"""What report and view open: finished runs, and logs with what the twin predicts of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ballplate.running import one_run
from twin.cli import completion as tab
from twin.cli.options import load_scenario
from twin.cli.output import warn
from twin.cli.terminal import Terminal
from twin.errors import RecordError
from twin.run.files import check_no_scenario

if TYPE_CHECKING:
    from twin.run.finished import Run

AGAINST = click.option(
    "--against",
    metavar="SCENARIO",
    shell_complete=tab.scenarios,
    help="Of CSV logs: the scenario they were recorded with, which the twin runs beside them.",
)


def opened(paths: Sequence[Path], against: str | None, overrides: Sequence[str]) -> list[Run]:
    """The runs that paths lead to; of logs the prediction of each as well.

    Args:
        paths: Run folders, records, CSV logs; the newest run if there is none.
        against: The scenario of the logs.
        overrides: ``KEY=VALUE`` each, what is changed of it.

    Raises:
        TwinError: If one cannot be opened, or a log has no scenario.
    """
    from twin.run.files import LAST
    from twin.run.finished import open_runs
    from twin.run.logs import fitting, log_run, read_log

    paths = paths or [Path(LAST)]
    logs = [path for path in paths if path.suffix == ".csv"]
    others = tuple(path for path in paths if path.suffix != ".csv")
    for path in others:
        check_no_scenario(path)
    if logs and against is None:
        raise RecordError(
            f"{logs[0]}: a log has no reference; name the scenario it was recorded with: "
            "--against circle"
        )
    if not logs and (against or overrides):
        raise RecordError("--against and --set: for CSV logs; a finished run has its scenario")
    runs = []
    for path in logs:
        assert against is not None
        rows = read_log(path)
        changed = (*fitting(rows, load_scenario(against, overrides)), *overrides)
        scenario = load_scenario(against, changed)
        label = f"{Path(against).stem} predicted"
        runs += [
            log_run(rows, scenario, path.stem),
            replace(one_run(scenario, label, Terminal()), name=label),
        ]
    return runs + (open_runs(others, warn) if others else [])
