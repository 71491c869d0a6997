"""A run: from scenario to folder, and its data when finished."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import STATE_NAMES
from controllers.catalog import origin
from controllers.controller import HeldLaw
from controllers.interfaces import Reference
from controllers.stable_inversion import AboutMotion
from twin.base.errors import RecordError
from twin.base.jobs import SecondProcess
from twin.base.parts import left_out, own_version
from twin.base.writing import remove, write_json, write_whole
from twin.hal.interface import Limits
from twin.hal.rig import Entry, Rig
from twin.run import assemble, controller_building
from twin.run.exporters import Signals
from twin.run.files import RUN_FILES
from twin.run.indicators import BOARD_INDICATORS, INDICATOR_UNITS
from twin.run.loop import drive, refuse_faults
from twin.run.metrics import INTERRUPTED_REASON, Motion, Outcome, against_python, find_rest, measure
from twin.run.record import CHANNELS, Recorder, classes_of, of_axes, write_run
from twin.scenario.changing import always_friction
from twin.scenario.load import check
from twin.scenario.schema import Dimensions, Scenario, choices


class RecordedReference(Reference):
    """Where a reference led, as recorded; its derivatives are differences of that.

    Args:
        time: In s, shape (K,).
        path: Desired ball position in m, shape (K, 2).
    """

    def __init__(self, time: Array, path: Array) -> None:
        self._time = time
        self._motion = [path]
        for _ in range(4):
            known = len(time) > 1
            self._motion.append(np.gradient(self._motion[-1], time, axis=0) if known else 0 * path)

    def __call__(self, t: float | Array) -> Array:
        """Position and four derivatives, shape (5, *shape(t), 2), between what was recorded."""
        each = [[np.interp(t, self._time, axis) for axis in of.T] for of in self._motion]
        return np.moveaxis(np.array(each), 1, -1)


@dataclass(eq=False, repr=False)
class Run(Signals):
    """A finished run of one rig: a mapping from column to values, and the figures of the run.

    Attributes:
        name: Its name in plots and tables.
        scenario: What was asked for.
        rows: Column name to values, shape (K,); of a rig of one axis the mapping leaves out the
            columns of the second, which are 0.
        units: Column name to unit.
        metrics: Its indicators by name, as ``metrics.json`` has them, in SI units but for those
            that say percent or deg; None for one that does not apply.
        versions: What produced it.
        folder: Where it lies; None for a run that is not on disk.
        events: Conditions that were detected: time in s, severity, text.
        ledger: Of a run in real time, ``TimingLog.as_dict``; else empty.
        branch: If the run is a branch of a run: which run, when and what was changed; else empty.
        driven: Of a run that a person drove, what they did beyond the scenario, see
            ``controlled``; else empty.
        classes: What law, observer and reference were, see ``metadata.classes_of``; of records of
            earlier versions empty.
        absent: Of those of controller, observer and reference that are not here, why.
        incomplete: What of the record or of the trace of its bus is missing, a line each.
        record: All channels of a run that was just made; None for one that was opened.
        real_time_factor: Simulated seconds per second of the loop, of a run that was just made.
        account: Timing statistics of one in real time.
    """

    name: str
    scenario: Scenario
    rows: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    folder: Path | None = None
    events: tuple[Mapping[str, Any], ...] = ()
    ledger: Mapping[str, Any] = field(default_factory=dict)
    branch: Mapping[str, Any] = field(default_factory=dict)
    driven: Mapping[str, Any] = field(default_factory=dict)
    classes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    absent: Mapping[str, str] = field(default_factory=dict)
    incomplete: tuple[str, ...] = ()
    record: Recorder | None = None
    real_time_factor: float | None = None
    account: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        record: Recorder,
        outcome: Outcome,
        reference: Reference | None = None,
        *,
        journal: Iterable[Entry] = (),
        account: Mapping[str, Any] | None = None,
        **more: Any,
    ) -> Self:
        """A run that was just made, evaluated from its scenario's start and band.

        Args:
            scenario: What was asked for.
            record: All channels.
            outcome: How it ended.
            reference: The reference it followed, as sampled; by default the scenario's.
            journal: Every condition that was detected.
            account: Timing statistics of a rig in real time.
            more: Further attributes.
        """
        desired = (reference or controller_building.build_reference(scenario))(record.time)[0]
        if origin(choices("reference")[scenario.reference.kind]) is not None:
            record.data["reference"] = desired[:, None]  # who draws the record may lack the class
        goals = more.get("driven", {}).get("goals")  # which no plan knew of from the start on
        if not goals and (laid := _planned_path(scenario, record, reference)) is not None:
            record.data["laid"] = laid[:, None]
        motion = Motion.of(record, desired, friction=always_friction(scenario))
        columns = list(record.columns())
        run = cls(
            "run",
            scenario,
            {"time": record.time, **{column: values for column, _, values in columns}},
            {"time": "s", **{column: unit for column, unit, _ in columns}},
            measure(motion, outcome, axes=scenario.plant.axes, **dict(scenario.metrics)),
            events=tuple(
                {"time": time, "severity": str(note.condition.severity), "text": note.text}
                for time, note in journal
            ),
            ledger=(account or {}).get("ledger", {}),
            classes=classes_of(scenario),
            record=record,
            account=account or {},
            **more,
        )
        vars(run)["motion"] = motion
        return run

    def __contains__(self, name: object) -> bool:
        return name in self.rows and bool(of_axes([str(name)], self.scenario.plant.axes))

    def __iter__(self) -> Iterator[str]:
        return iter(of_axes(self.rows, self.scenario.plant.axes))

    def __len__(self) -> int:
        return len(list(iter(self)))

    @property
    def outcome(self) -> str:
        """How it ended: finished, fell, lost, fault, aborted, diverged, or unknown."""
        return str(self.metrics.get("outcome") or "unknown")

    @property
    def end(self) -> float:
        """When its last period ended, s; 0 if it had none."""
        time = self.rows["time"]
        return float(time[-1]) + self.scenario.rig.period if len(time) else 0.0

    @property
    def judged_until(self) -> float:
        """When it was stopped, if it was, s; motion of ball and plate after it is not evaluated."""
        ended = self.metrics.get("outcome_time")
        return math.inf if ended is None or self.outcome == "finished" else float(ended)

    @property
    def interrupted(self) -> bool:
        """Whether a person ended it."""
        return self.metrics.get("reason") == INTERRUPTED_REASON

    def summary(self) -> dict[str, Any]:
        """Output of ``--json``: the indicators, and of a run just made the speed."""
        made: dict[str, Any] = {}
        if self.record is not None:
            speed = self.real_time_factor
            made = {"judged_from": self.scenario.metrics.start, "real_time_factor": speed}
        driven = {"driven": self.driven} if made and self.driven else {}
        numbers = {"scenario": self.scenario.title, **self.metrics, **made}
        lacks = {"incomplete": list(self.incomplete)} if self.incomplete else {}
        absent = set(BOARD_INDICATORS) - numbers.keys()
        units = {k: unit for k, unit in INDICATOR_UNITS.items() if k not in absent}
        return numbers | {"units": units, **self.account, **driven, **lacks}

    @cached_property
    def followed(self) -> Reference:
        """The reference that the run was to follow."""
        if CHANNELS["reference"].columns[0] in self.rows:
            path = np.stack([self.rows[name] for name in CHANNELS["reference"].columns], axis=1)
            return RecordedReference(self.rows["time"], path)
        return controller_building.build_reference(self.scenario)

    @property
    def settings(self) -> dict[str, Any]:
        """The tables of the scenario, with all settings of law, observer and reference."""
        tables = self.scenario.model_dump(mode="json")
        for table, its in self.classes.items():
            tables[table] |= its["settings"]
            tables[table] |= {key: its[key] for key in ("file", "sha256") if its.get(key)}
        return tables

    @property
    def about(self) -> dict[str, Any]:
        """Scenario, parameters and indicators, for files that can hold them."""
        scenario = self.scenario.model_dump(mode="json")
        return {"scenario": scenario, "parameters": self.settings, "metrics": self.summary()}

    @property
    def lacking(self) -> str:
        """What is missing to continue the run, though the record can be drawn; empty if nothing."""
        for table, line in self.absent.items():
            kind = getattr(self.scenario, table).kind
            file = self.classes.get(table, {}).get("file", "")
            was = f" (it was in {file})" if file else ""
            wrong = f"does not take its settings: {line}" if kind in choices(table) else "not here"
            return (
                f"{self.name}: {table} '{kind}'{was}: {wrong}; the record is shown, but replay "
                "and what-if need it: --law FILE"
            )
        return ""

    def require(self) -> None:
        """Make sure that the run can be continued.

        Raises:
            RecordError: If its law, observer or reference is not here, or differs from the run's.
        """
        if self.lacking:
            raise RecordError(self.lacking)
        now = classes_of(self.scenario)
        for table, was in self.classes.items():
            if was.get("sha256", "") != now[table].get("sha256", ""):
                kind = getattr(self.scenario, table).kind
                raise RecordError(
                    f"{self.name}: {table} '{kind}' differs from the one in the run: "
                    f"{was.get('file')} has changed since"
                )

    def controlled(self, at: float) -> Scenario:
        """The scenario with the controller that a person had chosen by a time in s."""
        found = self.scenario
        for each in self.driven.get("controllers", ()):
            if each["since"] < at + 1e-9:
                tables = self.scenario.model_dump(mode="json")
                tables |= {name: table for name, table in each.items() if name != "since"}
                found = check(tables, self.name)
        return found

    @property
    def limits(self) -> Limits:
        """Limits of what might be commanded of the rig."""
        return controller_building.build_limits(self.scenario)

    @cached_property
    def motion(self) -> Motion:
        """Motion of ball and plate."""
        state = states_of(self.rows)
        applied = np.stack([self.rows[f"applied_{axis}_acc"] for axis in ("phi", "theta")], axis=1)
        time = self.rows["time"]
        known = "true_x" in self.rows and always_friction(self.scenario)
        board = None
        if CHANNELS["board"].columns[0] in self.rows:
            of_board, requested = (
                np.stack([self.rows[name] for name in CHANNELS[kind].columns], axis=1)
                for kind in ("board", "requested")
            )
            board = against_python(
                of_board, requested, self.rows["supervisor"], self.scenario.rig.period
            )
        return Motion(
            time=time,
            ball=state[:, 0::4],
            plate=state[:, 2::4],
            u=applied,
            reference=self.followed(time)[0],
            held=find_rest(time, state[:, 1::4]) if known else None,
            lateness=self.rows.get("command_lateness"),
            board=board,
        )


def columns(rows: Mapping[str, Array], kind: str) -> Array:
    """The state columns ``true_...`` or ``estimated_...`` as states of (5.5), shape (K, 8)."""
    return np.stack([rows[f"{kind}_{name}"] for name in STATE_NAMES], axis=1)


def states_of(rows: Mapping[str, Array]) -> Array:
    """The true states (K, 8); of a real rig, where nobody knows them, the estimated ones."""
    return columns(rows, "true" if "true_x" in rows else "estimated")


@controller_building.own_errors()
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
    if rig is None:
        refuse_faults([scenario])
        rig, controller = assemble.assemble(scenario, unseen=True)
    else:
        controller = controller_building.build_controller(scenario.in_real_time)
    period = scenario.rig.period
    ticks, knows = round(scenario.duration / period), controller.observer.knows
    record = Recorder(ticks, 1, period, rig.channels, knows)
    watch(record)
    begin = time.perf_counter()
    (outcome,) = drive(rig, controller, scenario.duration, record, progress)
    return Run.of(
        scenario,
        record,
        outcome,
        controller.reference,
        journal=rig.journal,
        account=rig.account(),
        real_time_factor=record.length * period / (time.perf_counter() - begin),
    )


def _planned_path(
    scenario: Scenario, record: Recorder, reference: Reference | None
) -> Array | None:
    """The channel of that name; None if the law planned the desired path, or plans none."""
    law = choices("controller")[scenario.controller.kind]
    if not (issubclass(law, AboutMotion) and record.length):
        return None
    built: Any = controller_building.build_law(scenario)
    x, period, begin = np.zeros(8), scenario.rig.period, float(record.time[0])
    x[0::2] = record["measured"][0, 0]
    if begin > 0:  # of a run that continues an earlier one
        x = record["estimate"][0, 0]
    if isinstance(built, HeldLaw):
        period, built = built.ticks * period, built.law
    ticks = (record.time / period + 1e-6).astype(int) - round(begin / period)
    desired, count = reference or controller_building.build_reference(scenario), int(ticks[-1]) + 1
    path: Array = built.planned_path(x, desired, period, count, begin)[np.maximum(ticks, 0)]
    return None if np.isnan(path).all() else path


def save(run: Run, folder: Path, shown: dict[str, Motion]) -> None:
    """Write a run folder: run.parquet, metrics.json, picture.png.

    Args:
        run: The run.
        folder: Where; made if missing.
        shown: Motions for the picture, by label.

    Raises:
        RecordError: If the folder cannot be written.
    """
    save_record(run, folder)
    draw(run, folder, shown)


def save_record(run: Run, folder: Path) -> None:
    """Write run.parquet and metrics.json of a run folder, over those of an earlier run.

    Args:
        run: The run.
        folder: Where; made if missing.

    Raises:
        RecordError: If the folder cannot be written.
    """
    # no file is better than the one of the run before
    for name in ("metrics.json", "picture.png"):
        remove(folder / name)
    with left_out(folder / RUN_FILES[0]):
        record_run(run, folder)
    write_json(folder / "metrics.json", run.summary())


def draw(
    run: Run, folder: Path, shown: dict[str, Motion], helper: SecondProcess | None = None
) -> None:
    """Write the picture of a run folder.

    Args:
        run: The run.
        folder: Where; made if missing.
        shown: Motions for the picture, by label.
        helper: A process that draws, if there is one.

    Raises:
        RecordError: If the folder cannot be written.
    """
    begin = helper.begin if helper else partial
    picture = begin(draw_runs, shown, run.scenario.title, run.scenario.dimensions)
    with left_out(file := folder / "picture.png"):
        write_whole(file, picture())


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
        **run_metadata(run.scenario),
        "classes": run.classes,
        "metrics": run.metrics,
        "events": list(run.events),
        **run.account,
        **({"driven": run.driven} if run.driven else {}),
        **({"incomplete": list(run.incomplete)} if run.incomplete else {}),
        **(more or {}),
    }
    assert run.record is not None
    write_run(folder, run.record, metadata)


def run_metadata(scenario: Scenario) -> dict[str, Any]:
    """Metadata of a record that are known before its run."""
    tables, classes = scenario.model_dump(mode="json"), classes_of(scenario)
    return {"scenario": tables, "classes": classes, "versions": versions()}


def draw_runs(shown: dict[str, Motion], title: str, plate: Dimensions) -> bytes:
    """The picture of runs as PNG; arguments as for ``picture.png``."""
    from twin.run.picture import png  # noqa: PLC0415  heavy: loaded when needed

    return png(shown, title, plate)


def load_drawing() -> None:
    """Import what ``save`` draws with, ahead of time."""
    import twin.run.picture  # noqa: F401, PLC0415  heavy: loaded when needed


def versions() -> dict[str, str]:
    """Producer of a record: this project, its numerical libraries, Python."""
    found = {"python": platform.python_version(), "ballplate": own_version()}
    for name, distribution in NUMERICAL_LIBRARIES.items():
        with suppress(PackageNotFoundError):  # ballplate-core may be without
            found[name] = version(distribution)
    return found


NUMERICAL_LIBRARIES = {"mujoco": "mujoco-core", "numpy": "numpy", "scipy": "scipy"}
NUMERICAL_LIBRARIES |= {"control": "control"}
"""Libraries of a run, and the distributions that have their versions."""
