"""The command analyse: poles and margins of the thesis's designs and of a scenario's own loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from twin.cli import completion as tab
from twin.cli.options import JSON, LAW, SETTING
from twin.cli.output import console, print_json, print_table, progress
from twin.shipped import find

if TYPE_CHECKING:
    from controllers.ballplate import BallPlate
    from twin.scenario import Scenario


Numbers = dict[str, Any]
"""A part of what ``--json`` prints."""

CUTS = {
    "full_state_at_u1": "full state, continuous, cut at u1",
    "observer_at_u1": "Luenberger observer (8.1) at 2 ms, cut at u1",
    "observer_at_ball": "Luenberger observer (8.1) at 2 ms, cut at the ball's measurement",
}
TERMS = {"neglected": "left of (6.42)", "unlisted": "not named there: c4 phi'' and the like"}


@click.command()
@click.argument("scenario", default="sine", shell_complete=tab.scenarios)
@LAW
@SETTING
@JSON
def analyse(scenario: str, overrides: tuple[str, ...], *, as_json: bool) -> None:
    """Analyse loops, the thesis's and a scenario's own: poles, margins, neglected terms.

    SCENARIO [sine] gives the motion for which the neglected terms are computed, and a loop to
    analyse.
    """
    find(scenario)  # a wrong name is told before anything heavy is imported
    from controllers.analysis import design_rows, linear_designs
    from controllers.ballplate import BallPlate
    from twin.scenario import load
    from twin.scenario.load import titled

    chosen = titled(load(scenario, overrides), overrides)
    model = BallPlate()
    with progress("analysis", len(linear_designs(model)) + 1) as advance:
        rows = design_rows(model, advance)
        neglected = _neglected(chosen, model)
        loop = _loop(chosen)
    if as_json:
        content = {"designs": rows, "neglected": neglected, "loop": loop}
        print_json({"scenario": chosen.title, **content})
        return
    _print_poles(rows)
    for cut, title in CUTS.items():
        _print_margins(rows, cut, title)
    _print_neglected(neglected, chosen.title)
    _print_loop(loop)


def _neglected(scenario: Scenario, model: BallPlate) -> Numbers:
    """Terms of (6.42) along the scenario's motion on the clean exact model."""
    from twin.run.finished import run as run_scenario
    from twin.scenario.load import clean
    from twin.thesis.neglected import neglected_rows

    record = run_scenario(clean(scenario)).record
    assert record is not None
    x, u = record["state"][:, 0], record["applied"][:, 0]
    steady = record.time >= scenario.metrics.start - 1e-9
    return {
        "from": scenario.metrics.start,
        "whole": neglected_rows(model, x, u),
        "steady": neglected_rows(model, x[steady], u[steady]) if steady.any() else [],
    }


def _loop(scenario: Scenario) -> Numbers:
    """The scenario's own controller, observer and predictor as a sampled loop."""
    from controllers.analysis import loop_row
    from twin.run.assemble import build_controller

    controller = build_controller(scenario)
    dead_time = scenario.sensors.touch.dead_time
    return {
        "controller": scenario.controller.kind,
        "observer": scenario.observer.kind,
        "predictor": None if scenario.predictor is None else scenario.predictor.delay,
        "dead_time": dead_time,
        **loop_row(controller.law, controller.observer, dead_time),
    }


def _print_poles(rows: Sequence[Numbers]) -> None:
    from controllers.analysis import DEAD_TIME

    late = f"slowest, observer, {1000 * DEAD_TIME:g} ms late"
    lines = []
    for row in rows:
        slowest = row["slowest_pole_with_observer_and_dead_time"]
        four = (
            row["thesis_poles"] or [],
            row["poles_flat_model"],
            row["poles_linear_model"],
            [[slowest[0], abs(slowest[1])]],
        )
        lines.append((row["table"], _name(row), *map(_poles, four)))
    print_table(
        ("table", "", "thesis", "flat (6.44)", "linear (5.35)", late),
        lines,
        title="Closed-loop poles in 1/s about the level plate, full state",
    )
    console.print("The thesis places those of 8.1 on (5.35), those of 8.4 and 8.6 on (6.44).")


def _print_margins(rows: Sequence[Numbers], cut: str, title: str) -> None:
    lines = ((row["table"], _name(row), *_margins(row["margins"][cut])) for row in rows)
    print_table(("table", "", *MARGINS), lines, title=f"Margins: {title}")


def _print_neglected(found: Numbers, title: str) -> None:
    columns = ("eq.", "terms", "when", "main, max m/s²", "max m/s²", "peak ratio %", "RMS ratio %")
    title = f"Terms the flat model leaves out, Figure 8.6: {title}, clean model"
    whens = {"whole": "whole run", "steady": f"from {found['from']:g} s on"}
    lines = (
        (
            f"({row['equation']})",
            TERMS[row["terms"]],
            label,
            *(_shown(row[key]) for key in ("main_max", "max")),
            *(_shown(row[key], 100) for key in ("peak_ratio", "rms_ratio")),
        )
        for when, label in whens.items()
        for row in found[when]
    )
    print_table(columns, lines, title=title)


def _print_loop(found: Numbers) -> None:
    parts = [found["controller"], found["observer"]]
    if found["predictor"] is not None:
        parts.append(f"predictor {1000 * found['predictor']:g} ms")
    parts.append(f"dead time {1000 * found['dead_time']:g} ms")
    title = f"The scenario's sampled loop: {', '.join(parts)}"
    if found["reason"]:
        console.print(f"{title}: {found['reason']}")
        return
    lines = ((cut, *_margins(row)) for cut, row in found["margins"].items())
    print_table(("cut at", *MARGINS), lines, title=title)
    console.print(f"poles in 1/s, slowest first: {_poles(found['poles'], 10)}")
    if not found["stable"]:
        console.print("[bold red]this loop is unstable[/bold red]")
    if found["hold_left_out"]:
        console.print("controller.period: the law's hold between its periods is not in this loop")


MARGINS = ("gain", "phase deg", "disk", "delay ms", "crossover rad/s")


def _margins(row: Numbers | None) -> list[str]:
    if row is None:
        return ["unstable"]
    gain = f"{_shown(row['gain_down'] or 0.0)} to {_shown(row['gain_up'])}"
    rest = (("phase", 1), ("disk", 1), ("delay", 1000), ("crossover", 1))
    return [gain, *(_shown(row[key], scale) for key, scale in rest)]


def _name(row: Numbers) -> str:
    return f"{row['controller']} {row['settings']}"


def _poles(pairs: Sequence[Sequence[float]], most: int = 5) -> str:
    """Poles for people: conjugate ones as a±bj."""
    upper = [(real, imag) for real, imag in pairs if imag > -1e-6]
    shown = [f"{re:.3g}±{im:.3g}j" if im > 1e-4 else f"{re:.3g}" for re, im in upper[:most]]
    return ", ".join(shown) + (", ..." if len(upper) > most else "")


def _shown(value: float | None, scale: float = 1.0) -> str:
    return "∞" if value is None else f"{scale * value:.3g}"
