"""One run from scenario to folder: assemble, drive, judge, record, draw."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from twin.hal.rig import Rig
from twin.jobs import SecondProcess
from twin.run.assemble import assemble
from twin.run.control import build_controller, own_errors
from twin.run.finished import Run
from twin.run.loop import drive
from twin.run.metadata import classes_of
from twin.run.metrics import Motion
from twin.run.record import Recorder
from twin.run.record_file import write_run
from twin.run.snapshot import SNAPSHOTS, Keeper, packed
from twin.scenario.schema import Scenario
from twin.writing import write_json, write_whole


@own_errors()
def run(
    scenario: Scenario,
    progress: Callable[[float], None] = lambda _: None,
    watch: Callable[[Recorder], None] = lambda _: None,
    rig: Rig | None = None,
) -> Run:
    """Run a scenario with one rig.

    Args:
        scenario: What to run.
        progress: Called with the simulated time now and then.
        watch: Called with the recorder before the run, to observe it.
        rig: A real rig, not switched on; simulated by default.

    Raises:
        TwinError: If the scenario cannot be assembled.
    """
    keeper: Keeper | None = None
    if rig is None:
        rig, controller = assemble(scenario)
        keeper = Keeper(rig, controller, scenario.duration)
    else:
        controller = build_controller(scenario)
    period = scenario.rig.period
    ticks, knows = round(scenario.duration / period), controller.observer.knows
    record = Recorder(ticks, 1, period, rig.channels, knows)
    watch(record)
    begin = time.perf_counter()
    (outcome,) = drive(rig, controller, scenario.duration, record, progress, keep=keeper)
    spent = time.perf_counter() - begin
    return Run.of(
        scenario,
        record,
        outcome,
        controller.reference,
        journal=rig.journal,
        account=rig.account(),
        real_time_factor=record.length * period / spent,
        snapshots=tuple(keeper.snapshots) if keeper else (),
    )


def save(
    run: Run, folder: Path, shown: dict[str, Motion], beside: SecondProcess | None = None
) -> None:
    """Write a run folder: run.parquet, metrics.json, picture.png.

    Args:
        run: The run.
        folder: Where; made if missing.
        shown: Motions for the picture, by label.
        beside: A process that draws while the rest is written.

    Raises:
        RecordError: If the folder cannot be written.
    """
    begin = beside.begin if beside else partial
    picture = begin(drawn, shown, run.scenario.title, run.scenario.rig.limits.area)
    record_run(run, folder)
    write_json(folder / "metrics.json", run.summary())
    write_whole(folder / "picture.png", lambda path: path.write_bytes(picture()))


def record_run(run: Run, folder: Path, more: Mapping[str, Any] | None = None) -> None:
    """Write ``run.parquet`` of a run folder.

    Args:
        run: The run.
        folder: Where; made if missing.
        more: Further metadata; JSON.

    Raises:
        RecordError: If the folder cannot be written.
    """
    metadata = {
        **described(run.scenario),
        "classes": run.classes,
        "metrics": run.metrics,
        "events": list(run.events),
        **run.account,
        **({"driven": run.driven} if run.driven else {}),
        **(more or {}),
    }
    assert run.record is not None
    kept = {SNAPSHOTS: packed(run.snapshots)} if run.snapshots else None
    write_run(folder, run.record, metadata, kept)


def described(scenario: Scenario) -> dict[str, Any]:
    """What of a record's metadata is known before its run."""
    tables, classes = scenario.model_dump(mode="json"), classes_of(scenario)
    return {"scenario": tables, "classes": classes, "versions": versions()}


def drawn(shown: dict[str, Motion], title: str, area: tuple[float, float]) -> bytes:
    """The picture of runs as PNG; arguments as for ``overview_plot.png``."""
    from twin.run.overview_plot import png  # noqa: PLC0415  heavy: loaded when needed

    return png(shown, title, area)


def load_drawing() -> None:
    """Import what ``save`` draws with, ahead of time."""
    import twin.run.overview_plot  # noqa: F401, PLC0415  heavy: loaded when needed


def versions() -> dict[str, str]:
    """What produced a record: this project, its numerical libraries, Python."""
    names = ("ballplate", "mujoco", "numpy", "scipy", "control")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
