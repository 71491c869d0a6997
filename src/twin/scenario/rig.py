"""What a rig file may say: bus, drives, touch screen, limits; checked like a scenario."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, create_model

from twin.data_file import DataError, read_toml
from twin.devices.akd.config import AkdConfig, AxisConfig, BusConfig
from twin.devices.lumio.config import LumioConfig
from twin.errors import ScenarioError
from twin.scenario.load import Tables, validated
from twin.scenario.schema import LimitsTable
from twin.scenario.tables import STRICT, Section

Settings = TypeVar("Settings")


def model_of(cls: type, without: Collection[str] = ()) -> type[BaseModel]:
    """A strict model of a frozen dataclass and of those in it."""
    hints = typing.get_type_hints(cls)
    fields: dict[str, Any] = {}
    for item in dataclasses.fields(cls):
        if item.name in without:
            continue
        hint = hints[item.name]
        if dataclasses.is_dataclass(hint):
            inner = model_of(typing.cast("type", hint))
            fields[item.name] = (inner | None, None)
        elif item.default is not dataclasses.MISSING:
            fields[item.name] = (hint, item.default)
        elif item.default_factory is not dataclasses.MISSING:
            fields[item.name] = (hint, Field(default_factory=item.default_factory))
        else:
            fields[item.name] = (hint, ...)
    return create_model(cls.__name__, __config__=STRICT, **fields)


def built(cls: type[Settings], model: BaseModel, **more: Any) -> Settings:
    """The dataclass that a checked model stands for; what is not given keeps its default."""
    hints = typing.get_type_hints(cls)
    given = {name: getattr(model, name) for name in model.model_fields_set}
    for name, value in given.items():
        if isinstance(value, BaseModel):
            given[name] = built(hints[name], value)
    return cls(**given, **more)


Bus = model_of(BusConfig)
Drives = model_of(AkdConfig, {"bus", "axes", "period"})
Axis = model_of(AxisConfig, {"name"})
Touch = model_of(LumioConfig)


class RigFile(Section):
    """One real rig.

    ``home_deg``: plate angles (phi, theta) at which it stands when switched on.
    ``cams``: file of its cam table; that of the model if it is not given.
    ``late_periods``: late or missed periods in a row that level the plate.
    ``patience``: seconds that the ball is waited for.
    ``limits``: the narrower of these and the scenario's hold.
    """

    title: str = "rig"
    home_deg: tuple[float, float] = (0.0, 0.0)
    cams: str | None = None
    late_periods: Annotated[int, Field(ge=1)] = 25
    patience: Annotated[float, Field(gt=0, le=3600)] = 30.0
    limits: LimitsTable = LimitsTable()
    bus: Bus = Bus()  # type: ignore[valid-type]
    drives: Drives = Drives()  # type: ignore[valid-type]
    phi: Axis = Axis(node=1)  # type: ignore[valid-type]
    theta: Axis = Axis(node=2)  # type: ignore[valid-type]
    touch: Touch  # type: ignore[valid-type]

    def servos(self, period: float) -> AkdConfig:
        """The drives' settings, for a control period in s.

        Raises:
            TwinError: If they do not go together.
        """
        axes = (
            built(AxisConfig, self.phi, name="phi"),
            built(AxisConfig, self.theta, name="theta"),
        )
        return built(
            AkdConfig, self.drives, axes=axes, bus=built(BusConfig, self.bus), period=period
        )

    def screen(self) -> LumioConfig:
        """The touch screen's settings.

        Raises:
            TwinError: If they do not go together.
        """
        return built(LumioConfig, self.touch)


def read_rig(file: Path) -> RigFile:
    """A rig file.

    Raises:
        TwinError: If it cannot be read, or anything in it is unknown or out of range.
    """
    try:
        tables = read_toml(file)
    except DataError as error:
        raise ScenarioError(f"--rig {file}: {error}") from error
    return check_rig(tables, file.name)


def check_rig(tables: Tables, source: str) -> RigFile:
    """The rig that the tables describe.

    Raises:
        TwinError: If anything in them is unknown or out of range.
    """
    rig = validated(RigFile, tables, source)
    rig.servos(0.002), rig.screen()
    return rig
