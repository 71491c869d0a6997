"""Form of a scenario: its tables, keys, types, ranges and defaults."""

from __future__ import annotations

import dataclasses
import json
import math
import typing
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pydantic
from pydantic import BaseModel, ConfigDict, Field, model_validator

from controllers.arrays import Array
from controllers.ballplate import BallPlate, time_constant
from controllers.catalog import catalog
from controllers.interfaces import Law, Observer, Reference, catalog_settings
from twin.base.errors import ModelError
from twin.base.followers import FREE, GIVEN, PARTS, Effect, Followers
from twin.base.settings import Setting, Unit, from_scenarios, settings_of, value_of
from twin.hal.interface import NOMINAL_PERIOD, Limits
from twin.hal.linkage import Linkage, TiltTable
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction, SurfaceModel
from twin.sim.plant.interface import BallSpin, BallStart, Parts
from twin.sim.plant.rim import Reach, Rim
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import TransmissionError

STRICT_CONFIG = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Section(BaseModel):
    """A table of a scenario: unknown keys, wrong types and non-finite numbers are refused."""

    model_config = STRICT_CONFIG
    sources: ClassVar[dict[str, tuple[type, str]]] = {}
    """Of keys that set a dataclass's field: key to dataclass and name of the field."""


if TYPE_CHECKING:

    class Derived(Section):
        """What a type checker knows of a derived table: it has keys."""

        def __init__(self, **keys: Any) -> None: ...

        def __getattr__(self, name: str) -> Any: ...


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


def tables(*classes: type, bases: Mapping[str, type[Section]], module: str) -> dict[str, Any]:
    """The models of all tables that settings of some dataclasses lie in, by dotted name.

    Args:
        classes: Dataclasses with settings.
        bases: What some tables have besides: fields of their own and checks. Tables and the keys of
            each are in the order in which they are named, here first.
        module: Where each model stands under its name, so that it can be sent to other processes:
            ``plant.ball`` is ``PlantBallTable``.
    """
    fields: dict[str, dict[str, Any]] = {name: {} for name in bases}
    sources: dict[str, dict[str, tuple[type, str]]] = {name: {} for name in bases}
    for cls in classes:
        for field, about in settings_of(cls).items():
            path, _, key = about.key.rpartition(".")
            fields.setdefault(path, {})[key] = (_hint(about), about.default)
            sources.setdefault(path, {})[key] = (cls, field)
    inner: dict[str, dict[str, Any]] = {}
    found: dict[str, Any] = {}
    for path in sorted(fields, key=lambda path: -path.count(".")):
        title = "".join(part.capitalize() for part in path.split(".")) + "Table"
        own: dict[str, Any] = inner.get(path, {}) | fields[path]
        made = pydantic.create_model(
            title, __base__=bases.get(path, Section), __module__=module, **own
        )
        made.sources = sources[path]
        outer, _, name = path.rpartition(".")
        inner.setdefault(outer, {})[name] = (made, made())
        found[path] = made
    return found


def _hint(about: Setting) -> Any:
    """The type of a key: the type of its default, every number of it within the bounds."""
    default = about.default
    if about.type is not None:
        return about.type if default is not None else about.type | None
    at = about.bounds.get
    number = Field(ge=at("ge"), gt=at("gt"), le=at("le"), lt=at("lt"))
    if isinstance(default, tuple):
        return tuple[(Annotated[float, number],) * len(default)]  # type: ignore[misc]
    if isinstance(default, int):
        return Annotated[int, number]
    bounded = Annotated[float, number]
    return bounded | None if default is None else bounded


PLANT_CLASSES = (Friction, SurfaceModel, DriveModel, Linkage, TiltTable, Parts, BallStart, Rim)
"""Dataclasses with settings that are keys of ``plant``."""
PLANT_KINDS = ["mujoco", "lagrange"]
"""What ``kind`` may name; ``twin.run.assemble.register`` adds to it."""


def _check_plant_kind(kind: str) -> str:
    if kind not in PLANT_KINDS:
        raise ValueError(f"must be {' or '.join(map(repr, PLANT_KINDS))}, got {kind!r}")
    return kind


LEAST_ON_CAMS = 0.32
"""Least side of a plate on cams in m: its wheels sit 0.16 m from the cardan joint."""
CAMS_DEG = 10.0
"""How far the cams tilt the plate either way, deg; thesis chapter 3."""
LEAST_ROLLING_MM = 0.01
"""The smallest arm of rolling resistance the engine can simulate, in mm."""

BALL_KINDS: dict[str, dict[str, dict[str, float]]] = {
    "hollow": {"ball": {}, "friction": {}},
    "steel": {
        # A solid sphere of 7850 kg/m^3 and the hollow ball's radius: 4/3 pi r^3 rho and 2/5 m r^2.
        "ball": {"mass": 0.263, "inertia": 4.208e-5},
        # Assumed: Appendix E gives only that its friction is less. It dents the screen less for its
        # stiffness and more for its weight; a quarter to a third of the hollow ball's is plausible.
        "friction": {"rolling_mm": 0.05},
    },
}
"""What each kind of ball sets where a scenario does not."""


class BallKeys(Section):
    """The ball; defaults are the thesis's Table A.2, or those of the solid steel ball."""

    kind: Literal["hollow", "steel"] = "hollow"
    """Hollow plastic ball, or a solid steel ball, which sets mass, inertia and friction."""

    def problem(self) -> str:
        """Error of the whole table, in one line; empty if there is none."""
        ball: Any = self
        far = 1000 * ball.radius
        most = ball.mass * ball.radius**2
        if sum(part**2 for part in ball.offset_mm) >= far**2:
            return f"plant.ball.offset_mm: must lie within the ball's radius of {far:g} mm"
        if ball.oval_mm >= far:
            return f"plant.ball.oval_mm: must be less than the ball's radius of {far:g} mm"
        if ball.inertia > most:
            return (
                f"plant.ball.inertia: must be at most mass x radius^2 = {most:g} kg m^2, and is "
                f"{ball.inertia:g}; a solid ball has 2/5 of that, a thin-walled one 2/3"
            )
        return ""


class SurfaceKeys(Section):
    """How friction and level vary over the screen: drawn at random, or grids."""

    def problem(self) -> str:
        """Error of the whole table, in one line; empty if there is none."""
        about = vars(self)
        given = {name: about[name] for name in ("relative", "height_um") if about[name]}
        if given and (about["spread_percent"] or about["slope_deg"]):
            return "plant.surface: give either grids or spread_percent and slope_deg, not both"
        shapes = {}
        for name, rows in given.items():
            if min(len(rows), *map(len, rows)) < 2 or len(set(map(len, rows))) > 1:
                return f"plant.surface.{name}: must be 2 or more rows of equally many, 2 or more"
            shapes[name] = f"{len(rows)} x {len(rows[0])}"
        if len(set(shapes.values())) > 1:
            sizes = " and ".join(f"{name} is {shape}" for name, shape in shapes.items())
            return f"plant.surface: grids must be of one size, but {sizes}"
        if any(value < 0 for row in about["relative"] for value in row):
            return "plant.surface.relative: must not be negative"
        return ""


SHAPE_OF_PLATE = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=GIVEN,
    explain="compares runs of one build of the rig",
    identify="fits samples from the screen, whatever its shape",
    symbols="bound the ball by the operating area",
)
SPIN_OF_BALL = Followers(
    mechanism="has a ball that spins freely",
    equations=GIVEN,
    source=GIVEN,
    explain=Effect("rolling", "thesis"),
    identify="fits a ball without a spin of its own",
    symbols=GIVEN,
)
KNOWN_CAMS = dataclasses.replace(
    SHAPE_OF_PLATE,
    explain=Effect("cams"),
    identify="has the plate's angles from its encoders",
    symbols="have the plate's acceleration as their input",
)
NUMBER_OF_AXES = dataclasses.replace(
    SHAPE_OF_PLATE,
    mechanism="is a plate that tilts about two axes",
    identify="fits the two axes of a plate",
    symbols="have a plate of two axes",
)
HELD_NOISE = dataclasses.replace(
    SHAPE_OF_PLATE,
    source=FREE,
    explain="switches the noise off, not its hold time",
    identify="takes the samples as recorded and estimates their noise",
    symbols="measure y without errors",
)


class PlantKeys(Section):
    """What is simulated."""

    kind: Annotated[
        str,
        pydantic.AfterValidator(_check_plant_kind),
        pydantic.WithJsonSchema({"type": "string", "enum": list(PLANT_KINDS)}),
    ] = "mujoco"
    """The mechanism in MuJoCo, or the exact equations of a ball that rolls."""
    step: Annotated[float, Field(ge=1e-5, le=1)] = 0.001
    """Time step of the simulation in s; for the mechanism at most 0.002."""
    axes: Annotated[Literal[1, 2], NUMBER_OF_AXES] = 2
    """Number of axes: 2 of a plate, or 1 of a tube or beam, which has x and phi alone."""
    shape: Annotated[Literal["rectangle", "round"], SHAPE_OF_PLATE] = "rectangle"
    """Shape of the plate: a rectangle, or round with the diameter plant.size = [d, d]."""
    ball_spin: Annotated[BallSpin, SPIN_OF_BALL] = "free"
    """In the exact equations, the ball's spin about the plate's normal: free, locked to the plate,
    or thesis for the equations (5.9), which lack a term of a ball with locked spin."""

    @model_validator(mode="after")
    def _kind_of_ball(self) -> PlantKeys:
        """Put in what the kind of ball sets and the scenario does not."""
        ball: Any = vars(self)["ball"]
        for name, values in BALL_KINDS[ball.kind].items():
            section: Section = vars(self)[name]
            left = {
                key: value for key, value in values.items() if key not in section.model_fields_set
            }
            if left:
                object.__setattr__(self, name, section.model_copy(update=left))
        return self

    @property
    def model(self) -> BallPlate:
        """The model that laws are designed on, with this ball and plate."""
        inner: Any = vars(self)
        ball = {name: vars(inner["ball"])[name] for name in ("mass", "radius", "inertia")}
        return BallPlate(**ball, height=inner["plate"].height)

    @property
    def reach(self) -> Reach:
        """How far walls let the ball go."""
        inner: Any = vars(self)
        return Reach.of(inner["rim"].size, inner["ball"].radius, self.shape)

    def problem(self) -> str:
        """Error of the whole table, in one line; empty if there is none."""
        return next(filter(None, self._problems()), "")

    def _problems(self) -> Iterator[str]:
        inner: Any = vars(self)
        mechanism = self.kind == "mujoco"
        if self.kind == "lagrange" and self.ball_spin != "free" and inner["start"].spin:
            yield (
                f"plant.start.spin: must be 0 with plant.ball_spin = {self.ball_spin!r}, which has "
                "no spin as a state; set plant.ball_spin=free"
            )
        (x, y), start, disc = inner["size"], inner["start"], self.shape == "round"
        if mechanism and min(x, y) < LEAST_ON_CAMS and not any(inner["linkage"].crank_mm):
            yield (
                f"plant.size: a plate on the mechanism's cams reaches over both wheels, at least "
                f"{LEAST_ON_CAMS:g} m; set plant.kind=lagrange, or give plant.linkage.crank_mm"
            )
        if disc and x != y:
            yield f"plant.size: of a round plate its diameter twice, got {x:g} and {y:g}"
        for axis, side in zip("xy"[: self.axes], (x, y), strict=False):
            if abs(vars(start)[axis]) > side / 2:
                yield f"plant.start.{axis}: the plate's half is {side / 2:g} m"
        if disc and math.hypot(start.x, start.y) > x / 2:
            yield f"plant.start: the round plate's radius is {x / 2:g} m"
        if self.axes == 1:
            yield from self._one_axis_problems()
        yield from self._rim_problems()
        if mechanism and self.step > 0.002:
            yield f"plant.step: must be at most 0.002 s for the mechanism, got {self.step:g}"
        rolling = inner["friction"].rolling_mm
        if mechanism and 0 < rolling < LEAST_ROLLING_MM:
            yield (
                f"plant.friction.rolling_mm: must be 0 or at least {LEAST_ROLLING_MM:g} for the "
                f"mechanism, got {rolling:g}"
            )
        yield inner["ball"].problem()
        yield inner["surface"].problem()

    def _one_axis_problems(self) -> Iterator[str]:
        inner: Any = vars(self)
        start, surface = inner["start"], inner["surface"]
        across = {
            "start.spin": start.spin,
            "camber.1": inner["camber"][1],
            "rim.size.1": inner["rim"].size[1],
            "surface.slope_deg": surface.slope_deg,
            "surface.height_um": surface.height_um,
        }
        for key, value in across.items():
            if value:
                yield f"plant.{key}: leave it out with plant.axes = 1, which has no y"
        if self.shape == "round":
            yield "plant.shape: must be 'rectangle' with plant.axes = 1"

    def _rim_problems(self) -> Iterator[str]:
        inner: Any = vars(self)
        rim, start, ball = inner["rim"].size, inner["start"], 2 * inner["ball"].radius
        for axis, between, side in zip("xy"[: self.axes], rim, inner["size"], strict=False):
            if between and not ball < between <= side:
                yield (
                    f"plant.rim.size: must be 0 along {axis}, for no walls, or above the ball's "
                    f"{ball:g} m and at most the plate's {side:g} m, got {between:g}"
                )
            elif between and (reach := (between - ball) / 2) < abs(vars(start)[axis]):
                yield f"plant.start.{axis}: walls let the ball's middle go {reach:g} m"
        if self.shape == "round" and any(rim):
            if rim[0] != rim[1]:
                yield f"plant.rim.size: of a round plate its diameter twice, got {list(rim)}"
            elif math.hypot(start.x, start.y) > (reach := (rim[0] - ball) / 2):
                yield f"plant.start: the rim lets the ball's middle go {reach:g} m"


PLANT_DEFAULTS = {
    about.key: about.default for cls in PLANT_CLASSES for about in settings_of(cls).values()
}
"""What a scenario has of each setting of ``plant`` that it does not give."""


def without_ball(plant: dict[str, Any], kind: Any) -> None:
    """Take out of the tables of a plant what its kind of ball sets, as a record has it in them."""
    keys = {
        (name, key)
        for each in BALL_KINDS.values()
        for name, values in each.items()
        for key in values
    }
    for name, key in keys:
        default = PLANT_DEFAULTS[f"plant.{name}.{key}"]
        own = plant.get(name, {})
        if own.get(key) == BALL_KINDS.get(kind, {}).get(name, {}).get(key, default):
            del own[key]


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


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]

MOST_PERIODS = 10_000_000
"""Longest run in control periods, 5.6 h of 2 ms: its record is kept in some GB of memory."""


class _Rig(Section):
    """How often the rig is controlled, and the controller's knowledge of its cams or linkage."""

    period: Positive = NOMINAL_PERIOD
    """Control period in s."""
    cams: Annotated[Literal["table", "per_axis", "ratio"], KNOWN_CAMS] = "table"
    """The calibrated table over both plate angles, which of a linkage is all its lengths, one table
    per axis, or a plain ratio."""
    plate_lag: Annotated[float, Field(ge=0, le=2)] = 0.0
    """Time constant in s with which the plate follows its command, as law and observer assume."""


class _Touch(Section):
    """The touch screen."""

    @pydantic.field_validator("frame_rate", check_fields=False)
    @classmethod
    def _frames_come(cls, value: float) -> float:
        if 0 < value < 1:
            raise ValueError(f"must be 0 or 1 to 10000, got {value:g}")
        return value


class _Sensors(Section):
    """What the rig measures."""

    ideal: bool = False
    """Whether the full true state is measured instead."""
    noise_hold: Annotated[float, Field(ge=0), HELD_NOISE] = 0.0
    """Time in s for which one draw of the noise is held; 0 for a new one every control period."""


RIG_CLASSES = (*PLANT_CLASSES, TouchModel, EncoderModel, TransmissionError, Limits)
"""Dataclasses with settings that describe a rig."""
RIG_TABLES: dict[str, type[Section]] = {
    "plant": PlantKeys,
    "plant.ball": BallKeys,
    "plant.friction": Section,
    "plant.surface": SurfaceKeys,
    "plant.servo": Section,
    "rig": _Rig,
    "sensors": _Sensors,
    "sensors.touch": _Touch,
}
"""What their tables have besides: keys that no dataclass's field is."""
SCENARIO_TABLES = tables(*RIG_CLASSES, bases=RIG_TABLES, module=__name__)
"""Tables by dotted name: the settings of plant, rig and sensors."""


NOT_OF_A_RIG = {
    "plant.kind": "chooses the engine",
    "plant.step": "is the engine's",
    "plant.ball.kind": "stands for other settings",
    "rig.period": "is the loop's",
    "rig.plate_lag": "is what law and observer believe",
    "sensors.ideal": "measures no rig",
}
"""Keys of those tables that describe no rig, and what they do."""


def register(
    classes: Iterable[type] = RIG_CLASSES, bases: Mapping[str, type[Section]] = RIG_TABLES
) -> dict[str, Setting]:
    """Every setting of a rig by its key; ``followed_by`` of each is who follows it.

    Args:
        classes: Dataclasses with settings.
        bases: Tables with keys of their own, which state their followers as an annotation.

    Raises:
        ModelError: If nothing is stated of a key.
    """
    found = {about.key: about for cls in classes for about in settings_of(cls).values()}
    for table, model in bases.items():
        for name, field in model.model_fields.items():
            key = f"{table}.{name}"
            stated = [each for each in field.metadata if isinstance(each, Followers)]
            if stated:
                found[key] = Setting(key, field.default, Unit.SI, {}, stated[0], field.annotation)
            elif key not in NOT_OF_A_RIG:
                raise ModelError(f"{key}: nothing states who follows it; annotate it by Followers")
    return found


CONTROL_TABLES = ("controller", "observer", "predictor")
"""Tables of a scenario that describe how the rig is controlled; they are given as a whole."""
REGISTER = register()
"""Every setting that describes a rig, by its key."""
ENGINES = {"mujoco": "mechanism", "lagrange": "equations"}
"""The part of the register that each of the twin's own plants is."""
OTHER_ENGINE = {"mujoco": "lagrange", "lagrange": "mujoco"}


def left_out(part: str, settings: Mapping[str, Setting] = REGISTER) -> dict[str, str]:
    """The settings that a part leaves out, by key, and why, as words that follow its label."""
    every = ((key, about.followed_by.lacking(part)) for key, about in settings.items())
    return {key: why for key, why in every if why}


LEFT_OUT = {kind: left_out(part) for kind, part in ENGINES.items()}
"""Settings that each of the twin's own plants leaves out, by key, and why."""
CAMS_ONLY = tuple(key for key, about in REGISTER.items() if about.followed_by.rods)
"""Keys of the mechanism with cams."""


def changed_in_vain(scenario: Scenario, lacking: Iterable[str]) -> Iterator[str]:
    """The keys, of those that a part leaves out, of settings that a scenario changes."""
    return (key for key in lacking if REGISTER[key].of(scenario) != REGISTER[key].default)


if TYPE_CHECKING:
    PlantTable = Derived
    RigTable = Derived
    SensorsTable = Derived
    DisturbanceTable = Derived
    RigLimitsTable = Derived
else:  # a process to which a scenario is sent finds its classes by these names
    PlantBallTable = SCENARIO_TABLES["plant.ball"]
    PlantFrictionTable = SCENARIO_TABLES["plant.friction"]
    PlantSurfaceTable = SCENARIO_TABLES["plant.surface"]
    PlantServoTable = SCENARIO_TABLES["plant.servo"]
    SensorsTouchTable = SCENARIO_TABLES["sensors.touch"]
    PlantLinkageTable = SCENARIO_TABLES["plant.linkage"]
    PlantWheelsTable = SCENARIO_TABLES["plant.wheels"]
    PlantSpringTable = SCENARIO_TABLES["plant.spring"]
    PlantPlateTable = SCENARIO_TABLES["plant.plate"]
    PlantStartTable = SCENARIO_TABLES["plant.start"]
    PlantRimTable = SCENARIO_TABLES["plant.rim"]
    SensorsEncodersTable = SCENARIO_TABLES["sensors.encoders"]
    RigLimitsTable = SCENARIO_TABLES["rig.limits"]
    PlantTable = SCENARIO_TABLES["plant"]
    RigTable = SCENARIO_TABLES["rig"]
    SensorsTable = SCENARIO_TABLES["sensors"]
    DisturbanceTable = SCENARIO_TABLES["disturbance"]


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
    """Control period of the law in s, a multiple of rig.period: its command is held between; that
    of the rig if none is given."""
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
            yield f"{key}: {PARTS[ENGINES[kind]]} {LEFT_OUT[kind][key]}{remedy}"
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
        for key in ("sensors.touch.rotation_deg", "rig.cam_coupling_percent") if one else ():
            if value_of(self, key):
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
        for key in CAMS_ONLY if linkage.given else ():
            if value_of(self, key) is not None:
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
