"""One run of the commands run and compare: its warnings, its progress, its exit code."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from twin.cli.output import progress, warn

if TYPE_CHECKING:
    from twin.hal.rig import Rig
    from twin.run.execute import Run
    from twin.run.past import Past
    from twin.run.record import Recorder
    from twin.scenario import Scenario

WORTH_PROCESS = 5.0
"""Simulated seconds from which a process of its own saves time."""


def exit_code(done: Run) -> int:
    """0 for a finished run, else 1."""
    from twin.run.loop import Ending

    return 0 if done.outcome.ending is Ending.FINISHED else 1


def watched(
    scenario: Scenario,
    label: str,
    watch: Callable[[Recorder], None] = lambda _: None,
    *,
    quiet: bool = False,
    rig: Rig | None = None,
    past: Past | None = None,
) -> Run:
    """Run a scenario with its warnings and its progress.

    Args:
        scenario: What to run.
        label: What the progress calls it.
        watch: Is given the recorder before the run.
        quiet: Whether to show no progress.
        rig: A real rig; simulated by default.
        past: What has been simulated already.

    Raises:
        TwinError: If the scenario cannot be assembled.
    """
    from twin.run.execute import run as run_scenario

    warn_of_dangers(scenario)
    if quiet:
        return run_scenario(scenario, watch=watch, rig=rig, past=past)
    with progress(label, scenario.duration) as advance:
        return run_scenario(scenario, advance, watch, rig, past)


def warn_of_dangers(scenario: Scenario) -> None:
    """Warn if the scenario's loop is unstable, or its observer slower than its law."""
    from controllers.analysis import instability, slow_observer
    from twin.run.control import build_controller

    controller = build_controller(scenario)
    dead_time = scenario.sensors.touch.dead_time
    for danger in (
        instability(controller.law, controller.observer, dead_time=dead_time),
        slow_observer(controller.law, controller.observer),
    ):
        if danger:
            warn(danger)


def with_plant(overrides: tuple[str, ...], plant: str | None) -> tuple[str, ...]:
    """The overrides, and that of the option ``--plant``."""
    return (*overrides, f"plant.kind={plant}") if plant else overrides
