"""What a person drives: a rig, its controller, its clean model, and their snapshots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.controller import Controller
from controllers.interfaces import Law, Measurement, Reference
from controllers.per_rig import SampledReference
from controllers.references import ALONG_X, AlongX
from controllers.setpoints import Setpoints
from twin.base.errors import ScenarioError
from twin.hal.rig import Entry
from twin.run.assemble import assemble
from twin.run.controller_building import build_controller, build_reference
from twin.run.finished import Run, save
from twin.run.metrics import Outcome
from twin.run.record import Recorder
from twin.run.rig_changes import RigChanges
from twin.run.state import Snapshot
from twin.scenario.changing import at_time
from twin.scenario.derived import clean
from twin.scenario.load import check
from twin.scenario.merging import put
from twin.scenario.schema import (
    CONTROL_TABLES,
    JUMP_KEYS,
    RAMP_KEYS,
    TIME_TOLERANCE_S,
    Change,
    Scenario,
    choices,
)
from twin.whatif.futures import CONTROL_KEY_PREFIXES
from twin.whatif.moments import take_over

SNAPSHOT_INTERVAL_S = 1.0
"""Simulated seconds from one state to the next."""
MAX_SNAPSHOTS = 300
"""States that are kept, of 0.2 MB each: of longer ago only the first."""


class Kept(NamedTuple):
    """A state.

    Attributes:
        time: Of it, s.
        row: Rows of the record before it.
        driven: What had been driven.
        rig: State of the rig and its controller.
        ghost: Of the clean model and its controller.
    """

    time: float
    row: int
    driven: Driven
    rig: Snapshot
    ghost: Snapshot


class States:
    """The states in the order of time."""

    def __init__(self) -> None:
        self.all: list[Kept] = []

    def due(self, time: float) -> bool:
        """Whether the next snapshot is due."""
        return not self.all or time > self.all[-1].time + SNAPSHOT_INTERVAL_S - 1e-9

    def keep(self, state: Kept) -> None:
        """Take one in; of two at one moment the later one counts, but the first one stays."""
        if len(self.all) > 1 and abs(self.all[-1].time - state.time) < 1e-9:
            self.all.pop()
        self.all.append(state)
        del self.all[1:-MAX_SNAPSHOTS]

    def back_to(self, time: float) -> Kept:
        """The last one before a time in s; all that follow are forgotten."""
        while len(self.all) > 1 and self.all[-1].time > time + 1e-9:
            self.all.pop()
        return self.all[-1]


class DrivenRig:
    """Rig, controller and clean model, as at the beginning of what was driven.

    Args:
        driven: What was driven so far.

    Attributes:
        rig: The rig.
        controller: Of it.
        ghost: The clean model.
    """

    def __init__(self, driven: Driven) -> None:
        self._controlled = driven.scenario
        self.rig, self.controller = assemble(self._controlled, changeable=True, unseen=True)
        self.ghost = Ghost(self._controlled, driven.reference)
        self._before: tuple[Controller, Scenario] | None = None
        self.follow(driven.reference)

    def follow(self, reference: Reference) -> None:
        """Let rig and clean model follow a new path from now on."""
        self.controller.reference = SampledReference(reference, self.rig.period)
        self.ghost.follow(reference)

    def push(self, x_rate: float, y_rate: float) -> None:
        """Change both balls' velocity at once, m/s, plate axes."""
        for rig in (self.rig, self.ghost.rig):
            ball = rig.devices.state[:, (0, 1, 4, 5)].copy()
            ball[:, 1] += x_rate
            ball[:, 3] += y_rate
            rig.devices.place(ball)

    def change(self, scenario: Scenario, time: float) -> None:
        """Let the rig have the settings of a scenario from a time in s on."""
        assert isinstance(self.rig.changes, RigChanges)
        self.rig.changes.follow([scenario], time)

    def control(self, controller: Controller, scenario: Scenario) -> None:
        """Have the controller of a scenario, started from the present state."""
        self._before = self.controller, self._controlled
        self.controller, self._controlled = controller, scenario

    def kept(self, measurement: Measurement, row: int, driven: Driven) -> Kept:
        """The state of this moment; it must not hold what the path ahead was taken to be.

        Args:
            measurement: The one that begins the period.
            row: Of the record.
            driven: What was driven so far.
        """
        self.follow(driven.reference)
        taken = Snapshot.take(self.rig, self.controller, measurement)
        ghost = Snapshot.take(self.ghost.rig, self.ghost.controller, self.ghost.measurement)
        return Kept(measurement.time, row, driven, taken, ghost)

    def go_on(self, state: Kept) -> Measurement:
        """Be in a state that was kept, with the controller that was chosen.

        Returns:
            The measurement that begins the period.
        """
        before, self._before = self._before, None
        if before is None:
            measurement = state.rig.restore(self.rig, self.controller)
            self.ghost.measurement = state.ghost.restore(self.ghost.rig, self.ghost.controller)
        else:
            measurement = state.rig.restore(self.rig)
            take_over(self.controller, *before, self._controlled, measurement.time)
        return measurement

    def picture(
        self, time: float, driven: Driven, applied: Array | None, factor: float
    ) -> tuple[float, ...]:
        """The numbers of a picture, in the order of ``session.PICTURE_COLUMNS``.

        Args:
            time: Of it, s.
            driven: What was driven so far.
            applied: Plate accelerations since the picture before, rad/s^2.
            factor: Simulated seconds a second of the clock.
        """
        desired = self.controller.reference(time)[0].ravel()
        goal = desired if driven.goals is None else np.array(driven.goals.points[-1][1:])
        state = self.rig.devices.state[0]
        ball, plate = state[0::4], state[2::4]
        ghost = self.ghost.rig
        clean = np.full(2, np.nan) if ghost.fallen[0] else ghost.devices.state[0, 0::4]
        errors = np.hypot(*(np.stack((ball, clean)) - desired).T)
        effort = np.nan if applied is None else np.sqrt((applied**2).mean())
        numbers = ([time], ball, plate, goal, desired, clean, errors, [effort, factor])
        return tuple(np.concatenate(numbers).tolist())


class Ghost:
    """A clean model that is stepped period by period.

    Args:
        scenario: Scenario of the rig that it accompanies.
        reference: The path to follow.

    Attributes:
        rig: The model.
        controller: Of it.
        measurement: The one that begins the period.
    """

    def __init__(self, scenario: Scenario, reference: Reference) -> None:
        self._scenario = clean(scenario)
        self.rig, self.controller = assemble(self._scenario, unseen=True)
        self.rig.__enter__()
        self.measurement = self.rig.read()
        self.follow(reference)
        self.controller.start(self.measurement)
        self.rig.start()

    def step(self) -> None:
        """One control period."""
        step = self.controller.command(self.measurement)
        self.controller.applied(self.rig.write(step.rate))
        self.rig.wait()
        self.measurement = self.rig.read()

    def follow(self, reference: Reference) -> None:
        """Follow a new path from now on."""
        self.controller.reference = SampledReference(reference, self.rig.period)

    def control(self, scenario: Scenario) -> None:
        """Have the controller of a scenario from now on."""
        now = clean(scenario)
        controller = build_controller(now)
        controller.start(self.measurement)
        take_over(controller, self.controller, self._scenario, now, self.measurement.time)
        self._scenario, self.controller = now, controller


MAX_DRIVEN_S = 1800.0
"""Longest time in s that can be driven: its record is kept in memory."""
MAX_PUSH_M_S = 3.0
"""Largest push along an axis, m/s: as far as the page can be dragged."""


@dataclass(frozen=True)
class Driven:
    """A scenario as a person has driven it so far; every change gives a new one.

    Attributes:
        scenario: With its changes of the plant, and the controller of now; its reference is the
            one from before a person gave the first goal.
        goals: The reference since then; None before.
        controllers: Since when, s, which controller, observer and predictor; the first from 0 on.
        pushes: Time in s and change of the ball's velocity (x, y) in m/s.
    """

    scenario: Scenario
    goals: Setpoints | None = None
    controllers: tuple[tuple[float, Mapping[str, Any]], ...] = ()
    pushes: tuple[tuple[float, float, float], ...] = ()

    @classmethod
    def begun(cls, scenario: Scenario) -> Driven:
        """A scenario that nothing was changed of yet.

        Raises:
            ScenarioError: If it cannot be assembled.
        """
        long = scenario.model_copy(update={"duration": MAX_DRIVEN_S, "baseline": False})
        build_reference(long)
        return cls(long, None, ((0.0, _control(long)),))

    @property
    def reference(self) -> Reference:
        """The path to follow."""
        if self.goals is None:
            return build_reference(self.scenario)
        return self.goals if self.scenario.plant.axes == 2 else AlongX(self.goals)

    @property
    def _axes(self) -> Array:
        """Factors of x and y: 0 of an axis that the rig lacks, shape (2,)."""
        return np.ones(2) if self.scenario.plant.axes == 2 else ALONG_X

    def goal(self, time: float, x: float, y: float) -> Driven:
        """With one more goal from a time in s on, taken into the operating area; m.

        Raises:
            ScenarioError: If the law has planned on the scenario's own path.
        """
        _of_now(self.scenario, "is no goal's: nobody knows the next one", goal=True)
        area = np.asarray(self.scenario.rig.limits.area, float)
        x, y = (np.clip((x, y), -area, area) * self._axes).tolist()
        if self.goals is None:
            before = self.scenario.reference.model_dump(mode="json")
            goals = Setpoints(points=((time, x, y),), before=before)
        elif time > self.goals.points[-1][0]:
            goals = self.goals.then(time, x, y)
        else:  # a second one within the same period
            goals = replace(self.goals, points=(*self.goals.points[:-1], (time, x, y)))
        return replace(self, goals=goals)

    def push(self, time: float, x_rate: float, y_rate: float) -> Driven:
        """With one more push: change of the ball's velocity in m/s, at most `MAX_PUSH_M_S`."""
        pushed = np.clip((x_rate, y_rate), -MAX_PUSH_M_S, MAX_PUSH_M_S) * self._axes
        x, y = pushed.tolist()
        return replace(self, pushes=(*self.pushes, (time, x, y)))

    def settings(self, time: float, values: Mapping[str, Any]) -> Driven:
        """With new values of keys from a time in s on.

        Raises:
            ScenarioError: If a key cannot change while a rig runs, or a value is out of range.
        """
        plant = {key: value for key, value in values.items() if key in RAMP_KEYS + JUMP_KEYS}
        for key in values:
            if key not in plant and not key.startswith(CONTROL_KEY_PREFIXES[:3]):
                raise ScenarioError(f"{key}: cannot be changed while a rig runs")
        tables = at_time(self.scenario, time).model_dump(mode="json", exclude={"change"})
        if tables["predictor"] is None:
            del tables["predictor"]
        checked = check(put(tables, values.items()), "play")
        if any(key not in plant for key in values):
            _of_now(checked, "is laid from the start of a scenario that has it")
        changed = self.scenario.model_copy(
            update={table: getattr(checked, table) for table in CONTROL_TABLES}
        )
        build_controller(changed)
        controllers = self.controllers
        if any(key not in plant for key in values):
            earlier = [each for each in controllers if each[0] < time - TIME_TOLERANCE_S]
            controllers = (*earlier, (time, _control(changed)))
        if plant:
            changes = _with_change(changed.change, time, plant)
            changed = changed.model_copy(update={"change": changes})
        return replace(self, scenario=changed, controllers=controllers)

    def recorded(self, end: float) -> Scenario:
        """The scenario that a record until a time in s was made with."""
        start = min(self.scenario.metrics.start, end / 2)
        kept = [each for each in self.scenario.change if each.at < end - TIME_TOLERANCE_S]
        tables = self.scenario.model_dump(mode="json", exclude={"change"})
        tables |= {
            "title": f"{self.scenario.title}, driven by hand",
            "duration": end,
            "change": [each.model_dump(mode="json") for each in kept],
        }
        tables["metrics"]["start"] = start
        if self.goals is not None:
            tables["reference"] = {
                "kind": Setpoints.name,
                "points": [list(point) for point in self.goals.points],
                "time_constant": self.goals.time_constant,
                "before": self.goals.before,
            }
        return check(tables, "play")

    def as_dict(self) -> dict[str, Any]:
        """What a person did that the scenario of the record does not say, and how much it is."""
        return {
            "goals": 0 if self.goals is None else len(self.goals.points),
            "changes": len(self.scenario.change),
            "pushes": [list(push) for push in self.pushes],
            "controllers": [{"since": since, **tables} for since, tables in self.controllers],
        }


def drivable(law: type[Law], *, goal: bool = False) -> bool:
    """Whether a law may be chosen while a rig runs: it has no plan; or may be given a goal."""
    return law.start is Law.start or (goal and law.replans)


def _of_now(scenario: Scenario, why: str, *, goal: bool = False) -> None:
    """Make sure that a scenario's law may be chosen while its rig runs, or be given a goal.

    Raises:
        ScenarioError: If it plans ahead.
    """
    kind = scenario.controller.kind
    laws = choices("controller")
    if not drivable(laws[kind], goal=goal):
        known = ", ".join(name for name, law in laws.items() if drivable(law, goal=goal))
        raise ScenarioError(
            f"controller.kind: '{kind}' needs a path that is known ahead, which {why}; "
            f"choose another (known: {known})"
        )


def _control(scenario: Scenario) -> dict[str, Any]:
    return scenario.model_dump(include={*CONTROL_TABLES})


def _with_change(
    changes: tuple[Change, ...], time: float, values: Mapping[str, Any]
) -> tuple[Change, ...]:
    """Changes and one more at once; of two at one time there is one with all values."""
    if changes and abs(changes[-1].at - time) < TIME_TOLERANCE_S:
        values = {**changes[-1].set, **values}
        changes = changes[:-1]
    return (*changes, Change(at=time, set=dict(values)))


class Part(NamedTuple):
    """The drive until now, as it is handed to the writer.

    Attributes:
        driven: By the person.
        outcome: How it ended.
        record: A copy of what was recorded until then.
        journal: Conditions that were detected.
        factor: Simulated seconds a second of the clock.
    """

    driven: Driven
    outcome: Outcome
    record: Recorder
    journal: tuple[Entry, ...]
    factor: float


Write = Callable[[Part, Path], object]


def save_driven(part: Part, folder: Path) -> None:
    """Write a run folder of what was driven.

    Raises:
        RecordError: If it cannot be written.
    """
    driven, record = part.driven, part.record
    done = Run.of(
        driven.recorded(record.period * round(record.end / record.period)),
        record,
        part.outcome,
        real_time_factor=part.factor,
        journal=part.journal,
        driven=driven.as_dict(),
    )
    save(done, folder, {"driven by hand": done.motion})
