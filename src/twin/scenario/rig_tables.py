"""Tables of a scenario that describe its rig, made of the settings of what is simulated."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import pydantic
from pydantic import BaseModel, ConfigDict, Field, model_validator

from controllers.ballplate import BallPlate
from twin.base.errors import ModelError
from twin.base.followers import FREE, GIVEN, Effect, Followers
from twin.base.settings import Setting, Unit, settings_of
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
"""What ``kind`` may name; ``twin.run.plants.register`` adds to it."""


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


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


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
