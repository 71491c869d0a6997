"""`identify --plan`: what a motion will tell of a rig, before anything is recorded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from twin.base.errors import ScenarioError
from twin.base.writing import check_writable
from twin.cli import options
from twin.cli.output import TERMINAL, Shown, bold, show

OWN_OPTIONS = {
    "plan": "--plan",
    "seconds": "--seconds",
    "scenarios": "--scenario",
    "rigs": "--rigs",
    "axes": "--axes",
    "optimise": "--optimise",
    "files": "--table",
}
"""Options of a plan by the names of their values."""
MOTION_ENDINGS = (".toml", ".csv")
"""Endings of the files of a motion: a scenario, and a table for a board."""


def PLAN(command: Any) -> Any:  # noqa: N802 - an option, as the others
    """The options of ``identify --plan``."""
    for option in (
        click.option(
            "--table",
            "files",
            multiple=True,
            type=options.PATH_TYPE,
            metavar="FILE",
            help="With --optimise: write the motion, FILE.toml a scenario, FILE.csv for a board.",
        ),
        click.option(
            "--optimise", is_flag=True, help="With --plan: search for a more informative motion."
        ),
        click.option(
            "--rigs",
            type=int,
            help="With --plan: number of rigs drawn from the unknown parameters [4].",
        ),
        click.option(
            "--axes",
            type=click.IntRange(1, 2),
            help="With --plan: number of axes of the rig [those that it has].",
        ),
        click.option(
            "--scenario",
            "scenarios",
            multiple=True,
            metavar="SCENARIO",
            callback=options.check_scenario_name,
            shell_complete=options.scenarios,
            help="With --plan: a motion to forecast [excite, circle, sine; on one axis line, "
            "excite].",
        ),
        click.option("--seconds", type=float, help="With --plan: length of the run [40]."),
        click.option("--plan", is_flag=True, help="Forecast what a run would show; takes no LOG."),
    ):
        command = option(command)
    return command


def take_plan(
    logs: Sequence[Path], held: Sequence[str], out: Path | None, how: dict[str, Any]
) -> dict[str, Any] | None:
    """The options of a plan, taken out of those of the command; None if none is wanted.

    Args:
        logs: The logs given.
        held: What is to be held out.
        out: Folder of the report.
        how: All further options by name; those of a plan are removed.

    Raises:
        ScenarioError: If options are given that do not go together.
    """
    given = {name: how.pop(name) for name in OWN_OPTIONS}
    if not given.pop("plan"):
        for name, option in OWN_OPTIONS.items():
            if given.get(name) not in (None, (), False):
                raise ScenarioError(f"{option}: needs --plan")
        if not logs:
            raise ScenarioError("LOG: give a log, or --plan to forecast the result of one")
        return None
    if logs:
        raise ScenarioError(f"{logs[0]}: --plan takes no LOG: it forecasts the result of one")
    for name in ("columns", "separator", "ball", "ball_height"):
        if how[name] is not None:
            raise ScenarioError(f"--{name.replace('_', '-')}: not allowed with --plan")
    if out is not None:
        raise ScenarioError("--out: not allowed with --plan, which only prints")
    _check_files(given["files"], optimise=given["optimise"])
    plan = {name: value for name, value in given.items() if value is not None}
    if held:
        try:
            (plan["hold_out"],) = map(float, held)
        except ValueError:
            raise ScenarioError("--hold-out: with --plan give one share, as 0.3") from None
    return plan


def _check_files(files: Sequence[Path], *, optimise: bool) -> None:
    """Make sure that the motion can be written to files.

    Raises:
        ScenarioError: If there is no motion, a file has a wrong ending, or cannot be written.
    """
    if files and not optimise:
        raise ScenarioError("--table: needs --optimise; it writes the optimised motion")
    for file in files:
        if file.suffix not in MOTION_ENDINGS:
            raise ScenarioError(f"--table {file}: must end in {' or '.join(MOTION_ENDINGS)}")
        check_writable(file.parent, "--table")


def show_plan(plan: dict[str, Any], names: str | None, on: str | None) -> int:
    """Print the forecasts; the exit code is 1 if no parameter will be identified.

    Args:
        plan: Arguments of ``plan_experiment`` by name, and the files to write.
        names: The parameters, a comma-separated list; None for the usual ones.
        on: The rig; None for the thesis's rig.
    """
    from ballplate.planning import plan_experiment
    from twin.identify.verdicts import IDENTIFIED_VERDICT

    files = plan.pop("files")
    done = plan_experiment(parameters=names or (), on=on, reporter=TERMINAL, **plan)
    for file in files:
        done.save(file)
    show(done.as_dict(), (*_describe(done), *(f"written: {file}" for file in files)))
    best = (each for rig in done.best.every for each in rig.verdicts)
    return int(all(each.word != IDENTIFIED_VERDICT for each in best))


def _describe(done: Any) -> Iterator[Shown]:
    from twin.base.page import round_plainly
    from twin.plan.forecast import FORECAST

    for forecast in done.forecasts:
        if forecast.rows:
            yield forecast.table
        else:
            yield bold(forecast.table.title)
        yield from forecast.sentences()
    if done.optimised is not None:
        yield done.optimised.describe()
    if len(done.forecasts) > 1:
        ranks = ", ".join(f"{each.scenario} {round_plainly(each.score)}" for each in done.forecasts)
        yield bold(f"{done.best.scenario} is expected to show most.")
        yield (
            "Expected half width over the largest that counts as identified, geometric mean of "
            f"all parameters and rigs (up to 1: identified, {FORECAST.worst_ratio:g}: nothing): "
            f"{ranks}."
        )
