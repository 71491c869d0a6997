"""Form of a scenario: its tables and how they fit together."""

from __future__ import annotations

import dataclasses
import json
import math
import typing
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pydantic
from pydantic import BaseModel, ConfigDict, Field, model_validator

from controllers.arrays import Array
from controllers.ballplate import BallPlate, time_constant
from controllers.catalog import catalog
from controllers.interfaces import Law, Observer, Reference, catalog_settings
from twin.base.followers import FOLLOWER_LABELS
from twin.base.settings import from_scenarios, settings_of, value_of
from twin.hal.linkage import Linkage, TiltTable
from twin.scenario.rig_tables import (
    CAMS_DEG,
    CAMS_ONLY,
    ENGINES,
    LEFT_OUT,
    OTHER_ENGINE,
    REGISTER,
    STRICT_CONFIG,
    DisturbanceTable,
    NotNegative,
    PlantTable,
    Positive,
    RigTable,
    Section,
    SensorsTable,
)
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction, SurfaceModel
from twin.sim.plant.interface import Parts
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import TransmissionError

_CHANGING_CLASSES = (
    Friction,
    Parts,
    DriveModel,
    TouchModel,
    EncoderModel,
    TransmissionError,
    SurfaceModel,
)


def _changing(how: str) -> tuple[str, ...]:
    every = (about for cls in _CHANGING_CLASSES for about in settings_of(cls).values())
    return tuple(about.key for about in every if about.changes == how)


RAMP_KEYS = _changing("ramp")
"""Settings that may change at once or along a ramp."""
JUMP_KEYS = _changing("jump")
"""Keys that change at once: a new ball of the same size, a new screen, new drives."""
RAMP_STEP_S = 0.02
"""Time step in s with which a ramp is followed."""
TIME_TOLERANCE_S = 1e-9
"""Times in s that are no further apart are one."""


class Change(Section):
    """One change of the plant, its drives or its sensors while they run."""

    at: Annotated[float, Field(ge=0)]
    """When it begins, time of the run in s; before the first period there is none."""
    over: Annotated[float, Field(ge=0)] = 0.0
    """How long the way to the new values takes, in s; 0 for at once."""
    set: Annotated[dict[str, Any], Field(min_length=1)]
    """The new values, each under its quoted key, as "plant.friction.rolling_mm"."""

    @property
    def end(self) -> float:
        """When the new values are reached, s."""
        return self.at + self.over

    def times(self) -> Iterator[float]:
        """When something has to be done for it, s."""
        for step in range(
            int((self.over - TIME_TOLERANCE_S) / RAMP_STEP_S) + 1 if self.over else 0
        ):
            yield self.at + step * RAMP_STEP_S
        yield self.end

    def problem(self) -> str:
        """What no plant can do of it, in one line; empty if all can be done."""
        for key in self.set:
            if key not in RAMP_KEYS + JUMP_KEYS:
                return (
                    f"{key}: cannot change during a run (allowed: "
                    f"{', '.join(RAMP_KEYS + JUMP_KEYS)})"
                )
            if self.over and key in JUMP_KEYS:
                return f"{key}: changes at once; leave out over = {self.over:g}"
        return ""


class InjectedFault(Section):
    """A fault that the virtual rig does to itself while it runs."""

    at: Annotated[float, Field(ge=0)]
    """When, time of the run in s."""
    name: Annotated[str, Field(min_length=1)]
    """Fault, by its name or as a line of `ballplate emulate`: "SYNC lost", "unplug"."""


STUDY_STEP = 0.002
"""Physics step in s of a study's mechanism; half the work of 1 ms. ``benchmarks/physics_step.py``
measures its error: docs/performance.md."""
MAX_CAM_STIFFNESS_N_M = 5e5
"""Stiffness of wheel on cam in N/m up to which that was found to hold."""
MOST_DAMPED = 0.3
"""Damping ratio of the plate on its wheels up to which it was; twice critical runs away at 2 ms."""


def at_study_step(scenario: Scenario) -> Scenario:
    """The scenario as one of many: at the step of studies unless it sets its own.

    Only the mechanism, on wheels not too hard or damped for the step, and at a control period that
    is a multiple of it; else the scenario as it is. The exact equations follow play worse at it.
    """
    plant, wheels = scenario.plant, scenario.plant.wheels
    steps = round(scenario.rig.period / STUDY_STEP)
    if (
        "step" in plant.model_fields_set
        or plant.kind != "mujoco"
        or (wheels.stiffness or 0.0) > MAX_CAM_STIFFNESS_N_M
        or (wheels.damping_ratio or 0.0) > MOST_DAMPED
        or steps < 1
        or abs(steps * STUDY_STEP - scenario.rig.period) > 1e-9 * scenario.rig.period
    ):
        return scenario
    return scenario.model_copy(update={"plant": plant.model_copy(update={"step": STUDY_STEP})})


MOST_PERIODS = 10_000_000
"""Longest run in control periods, 5.6 h of 2 ms: its record is kept in some GB of memory."""


CONTROL_TABLES = ("controller", "observer", "predictor")
"""Tables of a scenario that describe how the rig is controlled; they are given as a whole."""


def changed_in_vain(scenario: Scenario, lacking: Iterable[str]) -> Iterator[str]:
    """The keys, of those that a part leaves out, of settings that a scenario changes."""
    return (key for key in lacking if REGISTER[key].of(scenario) != REGISTER[key].default)


class MetricsTable(Section):
    """How a run is evaluated."""

    start: NotNegative = 0.0
    """Time in s from which steady tracking is evaluated. A run with a shorter ``duration`` is
    evaluated from the same share of it."""
    band_percent: Annotated[float, Field(gt=0, lt=100)] = 5.0
    """Settling band in % of the distance to a constant goal."""


class Choice(BaseModel):
    """A law, observer or reference by name, with its own settings next to it."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)

    kind: str

    @property
    def settings(self) -> dict[str, Any]:
        """The settings written next to the name."""
        return dict(self.model_extra or {})


class KnownBall(Section):
    """Ball and plate that the designer of law, observer and predictor believes in."""

    kind: Literal["scenario", "nominal"] = "scenario"
    """The ball of plant.ball, or the nominal one of Table A.2, whatever rolls on the plate; model =
    "nominal" is short for it. A [[change]] of the ball and what a study or family draws of it are
    unknown to the designer."""
    mass: Positive | None = None
    """Mass in kg that is believed in place of that ball's."""
    radius: Positive | None = None
    """Radius in m in place of that ball's."""
    inertia: Positive | None = None
    """Moment of inertia in kg m^2 in place of that ball's."""
    height: NotNegative | None = None
    """Height of the surface over the axes in m in place of plant.plate.height."""

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, value: Any) -> Any:
        return {"kind": value} if isinstance(value, str) else value

    @pydantic.model_serializer(mode="wrap")
    def _in_short(self, whole: pydantic.SerializerFunctionWrapHandler) -> str | dict[str, Any]:
        given = {key: value for key, value in whole(self).items() if value is not None}
        return self.kind if given.keys() == {"kind"} else given


MAX_ANSWER_TIME_S = 0.04
"""Longest time in s that an answer to a loop in real time may take: a longer silence of the host
stops the drives, and a plate that they hold no more is not levelled."""


class ControllerChoice(Choice):
    """A law, how often it is evaluated, and for which ball it is designed."""

    period: Positive | None = None
    """Control period of the law in s, a multiple of rig.period: its command is held between;
    none: the rig's period."""
    computing_time: NotNegative | Literal["measured"] = 0.0
    """How long a command is computed in s, or "measured" for its time on this computer. A command
    that takes longer than rig.period is applied that many periods later; the one before is held
    meanwhile. A real rig's time passes by itself: there it means nothing."""
    model: KnownBall = KnownBall()


class ObserverChoice(Choice):
    """An observer; the thesis's experiments use the Luenberger observer."""

    kind: str = "luenberger"


class Predictor(Section):
    """What makes up for the dead time; a scenario without the table has nothing that does."""

    kind: Literal["smith"] | None = None
    """The Smith predictor, which is also the default, except for an observer that compensates
    the dead time itself."""
    delay: Annotated[float, Field(ge=0, le=1)] = 0.042
    """Dead time in s that it, or such an observer, assumes."""
    wait: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Mean time in s from frame to use, which the Smith predictor assumes in addition; such an
    observer knows the age of each frame."""


class Board(Section):
    """The processor that has the controller; without the table Python has it."""

    program: str = "cortex-m4"
    """What runs the controller: cortex-m4 for its C code on an emulated Cortex-M4F, host for its
    C code on this computer, or the file of a program, an .elf for that emulated processor and
    any other for this computer."""
    real: Literal["float", "double"] = "float"
    """Type of the numbers in its C code."""
    clock_hz: Positive | None = None
    """Clock of the processor in Hz, from which a command's computing time follows; without one it
    takes none. A command that takes longer than rig.period is applied that many periods later; the
    plate rate before is held meanwhile."""
    cycles_per_instruction: tuple[Positive, Positive] = (1.1, 2.2)
    """Minimum and maximum clock cycles of an average instruction, by default those of a
    Cortex-M4F without wait states; the computing time uses the maximum."""
    time_limit: Positive = 10.0
    """Maximum time in s that the program may take for an answer, of this computer's time; on a
    rig in real time at most 0.04."""

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        least, most = self.cycles_per_instruction
        if least > most:
            return f"board.cycles_per_instruction: the least is {least:g}, the most {most:g}"
        return ""


class Dimensions(NamedTuple):
    """What is drawn of a plate from above.

    Attributes:
        screen: Its sides along x and y, m.
        area: Operating area |x|, |y|, m.
        ball: Radius of the ball, m.
        round: Whether the screen is round.
        axes: Number of axes, 2, or 1 of a tube or beam along x.
        rim: Distances between opposite walls along x and y, m; 0 for none.
    """

    screen: tuple[float, float]
    area: tuple[float, float]
    ball: float
    round: bool = False
    axes: int = 2
    rim: tuple[float, float] = (0.0, 0.0)

    def within(self, place: Array, margin: float) -> Array:
        """A place (2,) in m, or where it is nearest to on the screen without a margin in m."""
        edge = np.array(self.screen) / 2 - margin
        if self.round:
            return place * min(1.0, float(edge[0] / max(np.hypot(*place), 1e-9)))
        return np.clip(place, -edge, edge)


class Scenario(Section):
    """One experiment: a plant, its sensors, a controller, a reference, and for how long."""

    title: str
    """Title in tables, pictures and reports."""
    duration: Positive
    """Duration of the run, in s."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the noise: the same seed gives the same run to the last bit."""
    baseline: bool = False
    """Whether `ballplate run` also runs the clean model, to compare with."""
    rehearsed: bool = False
    """Whether a rig runs it only after the twin has kept the ball in a rehearsal."""
    change: tuple[Change, ...] = ()
    """Changes of the rig while it runs: each table gives the time (at), its duration
    (over, 0 for at once) and the new values by their quoted keys (set)."""
    fault: tuple[InjectedFault, ...] = ()
    """Faults of the virtual rig, on `--rig emulated` only: each table gives the time (at) and the
    name of the fault (name); `ballplate safety --list` lists the names."""
    plant: PlantTable = PlantTable()
    rig: RigTable = RigTable()
    sensors: SensorsTable = SensorsTable()
    disturbance: DisturbanceTable = DisturbanceTable()
    controller: ControllerChoice
    observer: ObserverChoice = ObserverChoice()
    predictor: Predictor | None = None
    board: Board | None = None
    reference: Choice
    metrics: MetricsTable = MetricsTable()

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        for problem in self._problems():
            raise ValueError(problem)
        return self

    def _problems(self) -> Iterator[str]:
        """What does not go together in it, a line each."""
        period, step, own = float(self.rig.period), self.plant.step, self.controller.period
        steps, ticks = round(period / step), round(self.duration / period)
        if steps < 1 or abs(steps * step - period) > 1e-9 * period:
            yield f"rig.period: {period:g} s is not a multiple of plant.step = {step:g} s"
        if own is not None and abs(self.law_ticks * period - own) > 1e-9 * own:
            yield f"controller.period: {own:g} s is not a multiple of rig.period = {period:g} s"
        if not 1 <= ticks <= MOST_PERIODS:
            yield (
                f"duration: must be {period:g} to {MOST_PERIODS * period:g} s with "
                f"rig.period = {period:g} s, got {self.duration:g}"
            )
        angle, acceleration = self.rig.limits.angle_deg, self.rig.limits.acceleration
        # a plate that is level may then be given no rate that could still be braked, see Clamp
        if period >= (most := math.sqrt(8 * math.radians(angle) / acceleration)):
            yield (
                f"rig.period: must be less than {most:.3g} s with rig.limits.angle_deg = {angle:g} "
                f"and rig.limits.acceleration = {acceleration:g}, got {period:g}: the plate could "
                "never be moved"
            )
        kind = self.plant.kind
        for key in changed_in_vain(self, LEFT_OUT.get(kind, ())):
            other = OTHER_ENGINE[kind]
            remedy = "" if key in LEFT_OUT[other] else f"; set plant.kind={other}"
            yield f"{key}: {FOLLOWER_LABELS[ENGINES[kind]]} {LEFT_OUT[kind][key]}{remedy}"
        if self.board is not None and (problem := self.board.problem()):
            yield problem
        if problem := self.plant.problem():
            yield problem
        yield from self._transmission_problems()
        (x, y), area = self.plant.size, self.rig.limits.area
        one = self.plant.axes == 1
        if 2 * area[0] > x or (2 * area[1] > y and not one):
            half = f"{x / 2:g}" if one else f"{x / 2:g}, {y / 2:g}"
            yield f"rig.limits.area: the plate's half is {half} m"
        elif self.plant.shape == "round" and 2 * math.hypot(*area) > x:
            most = x / 2 / math.hypot(*area)
            yield (
                f"rig.limits.area: its corners must lie on the round plate of radius {x / 2:g} m, "
                f"as those of [{most * area[0]:.3g}, {most * area[1]:.3g}] do"
            )
        for key in ("sensors.touch.rotation_deg", "rig.cam_coupling_percent"):
            if one and value_of(self, key):
                yield f"{key}: must be 0 with plant.axes = 1, which has no second axis"
        if self.metrics.start >= self.duration:
            yield (
                f"metrics.start: {self.metrics.start:g} s is not before the end at "
                f"duration = {self.duration:g} s"
            )

    def _transmission_problems(self) -> Iterator[str]:
        """What does not go together between servos and plate, a line each."""
        linkage, table = from_scenarios(Linkage, [self]), from_scenarios(TiltTable, [self])
        servos, most = linkage.given or table.given, self.rig.limits.angle_deg
        yield from filter(None, (each.problem(math.radians(most)) for each in (linkage, table)))
        if table.given and linkage.given:
            yield "plant.linkage: a table has no lengths next to it; leave out either"
        for key in CAMS_ONLY:
            if linkage.given and value_of(self, key) is not None:
                yield f"{key}: {REGISTER[key].followed_by.rods}"
        if servos and self.rig.cams == "per_axis":
            yield "rig.cams: must be 'table' (all of its lengths) or 'ratio' for a linkage"
        if self.plant.kind == "lagrange" and self.rig.cams != "table" and not servos:
            yield "rig.cams: the exact equations have no cams; set plant.kind=mujoco"
        if self.plant.kind == "mujoco" and most > CAMS_DEG and not servos:
            yield f"rig.limits.angle_deg: the cams reach {CAMS_DEG:g}; set plant.kind=lagrange"

    @property
    def designed_on(self) -> BallPlate:
        """Ball and plate as the designer of law, observer and predictor knows them.

        That is the scenario's own ball, unless ``controller.model`` differs. Who
        makes a rig differ from what its designer knows leaves this alone: a ``[[change]]`` is no
        part of it, and a study writes what was known into ``controller.model``.
        """
        known = self.controller.model
        ball: BallPlate = BallPlate() if known.kind == "nominal" else self.plant.model
        given = known.model_dump(exclude={"kind"}, exclude_none=True)
        return dataclasses.replace(ball, lag=self.rig.plate_lag, **given)

    @property
    def lateness(self) -> tuple[float, float]:
        """Dead time of ball and drives, with the mean wait for a frame, and the drives' lag, s."""
        touch, corner = self.sensors.touch, self.plant.servo.bandwidth_hz
        wait = 0.5 / touch.frame_rate if touch.frame_rate else 0.0
        dead = touch.dead_time + self.plant.servo.dead_time
        return dead + wait, time_constant(corner)

    @property
    def law_ticks(self) -> int:
        """Control periods of the rig in one of the law's."""
        ticks = round((self.controller.period or 0.0) / float(self.rig.period))
        return max(1, ticks)

    @property
    def dimensions(self) -> Dimensions:
        """Screen, operating area and ball."""
        plant = self.plant
        edge = plant.shape == "round"
        area, ball = self.rig.limits.area, plant.ball.radius
        return Dimensions(plant.size, area, ball, edge, plant.axes, plant.rim.size)

    @property
    def without_computing_time(self) -> Scenario:
        """The same with a law that computes in no time."""
        controller = self.controller.model_copy(update={"computing_time": 0.0})
        board = self.board and self.board.model_copy(update={"clock_hz": None})
        return self.model_copy(update={"controller": controller, "board": board})

    @property
    def takes_time(self) -> bool:
        """Whether its commands are computed in a time that acts."""
        clocked = self.board is not None and self.board.clock_hz is not None
        return bool(self.controller.computing_time) or clocked

    @property
    def in_real_time(self) -> Scenario:
        """The same where time passes by itself, and what answers is given up before drives stop."""
        found = self.without_computing_time
        limit = min(MAX_ANSWER_TIME_S, getattr(self.controller, "time_limit", MAX_ANSWER_TIME_S))
        given = {"time_limit": limit} if self.controller.kind == "fmu" else {}
        controller = found.controller.model_copy(update=given)
        least = found.board and min(MAX_ANSWER_TIME_S, found.board.time_limit)
        board = found.board and found.board.model_copy(update={"time_limit": least})
        return found.model_copy(update={"controller": controller, "board": board})


CATALOG_TABLES: dict[str, type[Law] | type[Observer] | type[Reference]] = {
    "controller": Law,
    "observer": Observer,
    "reference": Reference,
}
"""The tables with settings that belong to a class of the catalog."""


@cache
def settings_model(cls: type) -> type[BaseModel]:
    """A strict model of the settings of a law, observer or reference: its dataclass fields."""
    hints = typing.get_type_hints(cls, include_extras=True)
    fields: Any = {item.name: (hints[item.name], item) for item in catalog_settings(cls)}
    return pydantic.create_model(cls.__name__, __config__=STRICT_CONFIG, **fields)


def checked_settings(cls: type, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings as read from a file in the types that the class wants.

    Raises:
        pydantic.ValidationError: If one is unknown, missing or of the wrong type.
    """
    checked = with_settings(cls, settings)
    return {name: getattr(checked, name) for name in type(checked).model_fields}


def with_settings(cls: type, settings: Mapping[str, Any]) -> BaseModel:
    """The model of all settings of a class, those given as read from a file.

    Raises:
        pydantic.ValidationError: If one is unknown, missing or of the wrong type.
    """
    return settings_model(cls).model_validate_json(json.dumps(settings, default=str))


def choices(table: str) -> dict[str, type]:
    """The classes that the ``kind`` of a table may name."""
    return dict(catalog(CATALOG_TABLES[table]))  # type: ignore[type-var]
