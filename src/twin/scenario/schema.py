"""What a scenario may say: its tables, keys, types, ranges and defaults."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from controllers.ballplate import BallPlate
from controllers.catalog import catalog
from controllers.interfaces import DelayedObserver, Law, Observer, Reference
from twin.hal.limits import Limits
from twin.scenario.change import Change
from twin.scenario.plant import SETTINGS, BallKeys, PlantKeys, SurfaceKeys
from twin.scenario.tables import Section, model_of, tables
from twin.sim.encoders import EncoderModel
from twin.sim.touch import TouchModel
from twin.sim.transmission import TransmissionError

if TYPE_CHECKING:
    from twin.scenario.tables import Derived

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]

MOST_PERIODS = 10_000_000
"""Longest run in control periods, 5.6 h of 2 ms: its record is kept in some GB of memory."""


class _Rig(Section):
    """How often the rig is controlled, and what it knows of its cams."""

    period: Positive = 0.002
    """Control period in s."""
    cams: Literal["table", "per_axis", "ratio"] = "table"
    """The calibrated table over both plate angles, one table per axis, or a plain ratio."""


class _Touch(Section):
    """The touch screen."""

    @field_validator("frame_rate", check_fields=False)
    @classmethod
    def _frames_come(cls, value: float) -> float:
        if 0 < value < 1:
            raise ValueError(f"must be 0 or 1 to 10000, got {value:g}")
        return value


class _Sensors(Section):
    """What the rig measures."""

    ideal: bool = False
    """Whether the full true state is measured instead."""
    noise_hold: NotNegative = 0.0
    """Time in s for which one draw of the noise holds; 0 for a new one every control period."""


TABLES = tables(
    *(*SETTINGS, TouchModel, EncoderModel, TransmissionError, Limits),
    bases={
        "plant": PlantKeys,
        "plant.ball": BallKeys,
        "plant.friction": Section,
        "plant.surface": SurfaceKeys,
        "plant.servo": Section,
        "rig": _Rig,
        "sensors": _Sensors,
        "sensors.touch": _Touch,
    },
    module=__name__,
)
"""Tables by dotted name: what is said of plant, rig and sensors."""
if TYPE_CHECKING:
    PlantTable = Derived
    RigTable = Derived
    SensorsTable = Derived
    DisturbanceTable = Derived
    RigLimitsTable = Derived
else:
    globals().update((each.__name__, each) for each in TABLES.values())


class MetricsTable(Section):
    """How a run is judged."""

    start: NotNegative = 0.0
    """Time in s from which on steady tracking is judged."""
    band_percent: Annotated[float, Field(gt=0, lt=100)] = 5.0
    """Settling band in % of the way to a constant goal."""


class Choice(BaseModel):
    """A law, observer or reference by name, with its own settings beside it."""

    model_config = ConfigDict(extra="allow", strict=True, frozen=True, allow_inf_nan=False)

    kind: str

    @property
    def settings(self) -> dict[str, Any]:
        """The settings written beside the name."""
        return dict(self.model_extra or {})


class KnownBall(Section):
    """The ball that the designer of law, observer and predictor believes in."""

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

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, value: Any) -> Any:
        return {"kind": value} if isinstance(value, str) else value

    @model_serializer(mode="wrap")
    def _in_short(self, whole: SerializerFunctionWrapHandler) -> str | dict[str, Any]:
        given = {key: value for key, value in whole(self).items() if value is not None}
        return self.kind if given.keys() == {"kind"} else given


class ControllerChoice(Choice):
    """A law, how often it is evaluated, and for which ball it is designed."""

    period: Positive | None = None
    """Control period of the law in s, a multiple of rig.period: its command is held between; that
    of the rig if none is given."""
    model: KnownBall = KnownBall()


class ObserverChoice(Choice):
    """An observer; the thesis's experiments use the Luenberger observer."""

    kind: str = "luenberger"


class Predictor(Section):
    """What makes up for the dead time; a scenario without the table has nothing that does."""

    kind: Literal["smith"] | None = None
    """The Smith predictor. Without a name it is the same, but for an observer that makes up for the
    dead time itself."""
    delay: Annotated[float, Field(ge=0, le=1)] = 0.042
    """Dead time in s that it, or such an observer, assumes."""


class Scenario(Section):
    """One experiment: a plant, its sensors, a controller, a reference, and for how long."""

    title: str
    """What tables, pictures and reports call it."""
    duration: Positive
    """How long it runs, in s."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Which noise is drawn: the same seed gives the same run to the last bit."""
    baseline: bool = False
    """Whether `ballplate run` also runs the clean model, to compare with."""
    change: tuple[Change, ...] = ()
    """What changes of the rig while it runs: each table says at which time (at), how long it takes
    (over, 0 for at once) and the new values by their quoted keys (set)."""
    plant: PlantTable = PlantTable()
    rig: RigTable = RigTable()
    sensors: SensorsTable = SensorsTable()
    disturbance: DisturbanceTable = DisturbanceTable()
    controller: ControllerChoice
    observer: ObserverChoice = ObserverChoice()
    predictor: Predictor | None = None
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
        if problem := self.plant.problem():
            yield problem
        if self.plant.kind == "lagrange" and self.rig.cams != "table":
            yield "rig.cams: the exact equations have no cams; set plant.kind=mujoco"
        if self.metrics.start >= self.duration:
            yield (
                f"metrics.start: {self.metrics.start:g} s is not before the end at "
                f"duration = {self.duration:g} s"
            )

    @property
    def designed_on(self) -> BallPlate:
        """Ball and plate as the designer of law, observer and predictor knows them.

        That is what the scenario says of its ball, unless ``controller.model`` says otherwise. Who
        makes a rig differ from what its designer knows leaves this alone: a ``[[change]]`` is no
        part of it, and a study writes what was known into ``controller.model``.
        """
        known = self.controller.model
        ball: BallPlate = BallPlate() if known.kind == "nominal" else self.plant.ball.model
        given = known.model_dump(exclude={"kind"}, exclude_none=True)
        return dataclasses.replace(ball, **given)

    @property
    def law_ticks(self) -> int:
        """Control periods of the rig in one of the law's."""
        ticks = round((self.controller.period or 0.0) / float(self.rig.period))
        return max(1, ticks)


KINDS: dict[str, type[Law] | type[Observer] | type[Reference]] = {
    "controller": Law,
    "observer": Observer,
    "reference": Reference,
}
"""The tables whose settings belong to a class of the catalog."""


def settings_model(cls: type) -> type[BaseModel]:
    """A strict model of the settings of a law, observer or reference: its dataclass fields."""
    given = {
        item.name
        for base in (Law, Observer, DelayedObserver)
        if issubclass(cls, base)
        for item in dataclasses.fields(base)
    }
    return model_of(cls, given)


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
    return dict(catalog(KINDS[table]))  # type: ignore[type-var]
