"""Form of a rig file: bus, drives, touch screen, limits; checked like a scenario.

The tables ``[drives]`` and ``[touch]`` have the keys of their kind (`devices/kinds.py`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, create_model, model_validator
from pydantic.errors import PydanticUserError

from twin.base.data_file import read_tables
from twin.base.errors import ScenarioError
from twin.base.shipped import shipped_in
from twin.devices.akd.config import AkdConfig, AxisConfig, BusConfig, DriveSettings
from twin.devices.common import wider
from twin.devices.kinds import DEFAULT_KINDS, SHIPPED_KINDS, Found, Role, find_kind
from twin.devices.lumio.config import CalibrationError, LumioConfig, read_calibration
from twin.devices.own_config import OwnConfig
from twin.scenario.load import validate
from twin.scenario.merging import Tables
from twin.scenario.rig_tables import CAMS_DEG, RigLimitsTable, Section
from twin.scenario.schema import Scenario

LATE_PERIODS = 25
LONGEST_PERIOD = 0.02
"""Control period in s at which a rig file is checked by itself; what a shorter one cannot have, as
the frames of a slow bus, is refused when the period is known."""


class RigFile(Section):
    """One real rig.

    ``drives.kind``, ``touch.kind``: what the devices are, AKD drives and a Lumio screen by default;
    the other keys of these tables are those of the kind.
    ``backend``: file and class of hardware of one's own, in place of drives and touch screen.
    ``own``: its settings, and the thresholds of its monitoring.
    ``home_deg``: plate angles (phi, theta) at which it stands when switched on.
    ``cams``: file of its cam table; by default the model's.
    ``late_periods``: missed periods, not made up for by others in time, that level the plate.
    ``patience``: seconds that the ball is waited for.
    ``limits``: the narrower of these and the scenario's hold.
    """

    title: str = "rig"
    home_deg: tuple[float, float] = (0.0, 0.0)
    cams: str | None = None
    late_periods: Annotated[int, Field(ge=1, le=10_000)] = LATE_PERIODS
    patience: Annotated[float, Field(gt=0, le=3600)] = 30.0
    limits: RigLimitsTable = RigLimitsTable()
    bus: BusConfig = BusConfig()
    drives: DriveSettings = DriveSettings()
    phi: AxisConfig = AxisConfig(name="phi", node=1)
    theta: AxisConfig = AxisConfig(name="theta", node=2)
    touch: LumioConfig | None = None
    backend: str | None = None
    own: OwnConfig = OwnConfig()
    kinds: ClassVar[Mapping[Role, Found]] = {
        role: Found(name, SHIPPED_KINDS[role][name]) for role, name in DEFAULT_KINDS.items()
    }
    """What the devices are, where there is no backend."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        """Drives and a touch screen with what belongs to them, or a backend."""
        wired = {"bus", "drives", "phi", "theta", "touch", "cams"} & self.model_fields_set
        if self.backend is not None:
            if wired:
                names = ", ".join(sorted(wired))
                raise ValueError(f"{names}: a rig with a backend has none of these")
            return self
        if self.touch is None:
            raise ValueError("touch is missing: a rig needs a touch screen or a backend")
        if "own" in self.model_fields_set:
            raise ValueError("own: describes your own hardware; it needs backend = 'FILE.py:CLASS'")
        name = self.kinds["drives"].name
        if self.has_akd:
            self.servos(LONGEST_PERIOD)
        elif others := {"bus", "phi", "theta"} & self.model_fields_set:
            names = ", ".join(sorted(others))
            raise ValueError(f"{names}: only drives of kind 'akd' have these, not '{name}'")
        if not self.has_cams and self.cams is not None:
            raise ValueError(f"cams: drives of kind '{name}' are commanded rates of the plate")
        if self.has_cams and self.limits.angle_deg > CAMS_DEG:
            raise ValueError(f"limits.angle_deg: the cams reach {CAMS_DEG:g}")
        if self.has_lumio:
            self.uncalibrated_screen()
        return self

    @property
    def has_akd(self) -> bool:
        """Whether its drives are AKD drives."""
        return self.backend is None and self.kinds["drives"].name == "akd"

    @property
    def has_lumio(self) -> bool:
        """Whether its screen is a Lumio screen."""
        return self.backend is None and self.kinds["touch"].name == "lumio"

    @property
    def has_cams(self) -> bool:
        """Whether its motors turn the plate by cams."""
        return self.backend is None and self.kinds["drives"].kind.cams

    @property
    def fingerprint(self) -> str:
        """Hash of the whole content of the file, and of the files of cams and backend it names.

        A kind that is no default is part of it, with the version of the package that it is from.
        """
        every = self.model_dump(mode="json", exclude={"title", "patience"})
        if isinstance(self.drives, DriveSettings) and not self.drives.shaft_lag:
            del every["drives"]["shaft_lag"]  # hashes of files without it are kept as they were
        others = {role: (its.name, its.package) for role, its in self.kinds.items()}
        if [its.name for its in self.kinds.values()] != list(DEFAULT_KINDS.values()):
            every["kinds"] = others
        digest = hashlib.sha256(json.dumps(every, sort_keys=True).encode())
        halves = (getattr(half, "backend", None) for half in (self.drives, self.touch))
        classes = [(each or "").rpartition(":")[0] for each in (self.backend, *halves)]
        for named in (self.cams, *classes):
            if named and (file := Path(named)).is_file():
                digest.update(file.read_bytes())
        return digest.hexdigest()[:16]

    def limited(self, scenario: Scenario) -> Scenario:
        """A scenario within the narrower of its own limits and the rig's."""
        both = zip(scenario.rig.limits, self.limits, strict=True)
        kept = {
            name: tuple(map(min, one, other)) if name == "area" else min(one, other)
            for (name, one), (_, other) in both
        }
        limits = scenario.rig.limits.model_copy(update=kept)
        rig = scenario.rig.model_copy(update={"limits": limits})
        return scenario.model_copy(update={"rig": rig})

    def _on_the_wire(self, role: Role) -> None:
        """Refuse what is for AKD drives, or for a Lumio screen, on a rig that has others."""
        found, default = self.kinds[role], DEFAULT_KINDS[role]
        if self.backend is not None:
            raise ScenarioError(
                f"{self.title}: this is for drives and touch screens of the twin's own kinds; this "
                f"rig has a backend, {Path(self.backend).name}"
            )
        if found.name != default:
            raise ScenarioError(
                f"{self.title}: this is for {role}.kind = '{default}'; this rig has '{found.name}'"
            )

    def settings(self, role: Role, period: float) -> Any:
        """What the builder of a device's kind is given, for a control period in s.

        Raises:
            TwinError: If they do not go together, or a file that they name cannot be read.
        """
        if role == "drives":
            return self.servos(period) if self.has_akd else self.drives
        return self.screen() if self.has_lumio else self.touch

    def servos(self, period: float) -> AkdConfig:
        """The drives' settings, for a control period in s.

        Raises:
            TwinError: If they do not go together.
        """
        self._on_the_wire("drives")
        axes = self.phi, self.theta
        return AkdConfig(**vars(self.drives), bus=self.bus, axes=axes, period=period)

    def uncalibrated_screen(self) -> LumioConfig:
        """The touch screen's settings, without the calibration that a file has.

        Raises:
            TwinError: If they do not go together.
        """
        self._on_the_wire("touch")
        assert self.touch is not None
        if None not in (self.touch.calibration, self.touch.calibration_file):
            raise ScenarioError("touch: give calibration or calibration_file, not both")
        return self.touch

    def screen(self) -> LumioConfig:
        """The touch screen's settings.

        Raises:
            TwinError: If they do not go together, or the file of its calibration cannot be read.
        """
        known = self.uncalibrated_screen()
        if known.calibration_file is None:
            return known
        try:
            calibration = read_calibration(Path(known.calibration_file))
        except CalibrationError as error:
            raise ScenarioError(f"touch.calibration_file: {error}") from error
        return replace(known, calibration=calibration)

    def relaxed(self, period: float) -> tuple[str, ...]:
        """Every safety net of the rig file that is wider than by default, in words.

        Raises:
            TwinError: If the drives' settings do not go together.
        """
        if self.backend is None:
            drives = self.servos(period) if self.has_akd else self.drives
            touch = self.uncalibrated_screen().gate if self.has_lumio else self.touch
            found = [*getattr(drives, "relaxed", ()), *getattr(touch, "relaxed", ())]
        else:
            found = list(self.own.relaxed)
        if self.late_periods > LATE_PERIODS:
            found.append(f"late_periods = {self.late_periods} (default {LATE_PERIODS})")
        for name, default in RigLimitsTable():
            value = getattr(self.limits, name)
            if wider(value, default):
                found.append(f"limits.{name} = {value} (default {default})")
        return tuple(found)


def read_rig(file: Path) -> RigFile:
    """A rig file.

    Raises:
        TwinError: If it cannot be read, or anything in it is unknown or out of range.
    """
    if str(file) in shipped_in("rigs") and not file.exists():
        raise ScenarioError(
            f"--rig {file}: names a file of a real rig; '{file}' is a simulated one: --on {file}, "
            f"in Python parameters='{file}'"
        )
    tables = read_tables(file, f"--rig {file}")
    places = [(tables, "backend"), (tables, "cams"), (tables.get("touch"), "calibration_file")]
    halves = (tables.get("drives"), tables.get("touch"))
    places += [(each, "backend") for each in halves if is_own(each)]
    for table, key in places:
        if isinstance(table, dict) and isinstance(named := table.get(key), str):
            local = file.parent / named
            table[key] = str(local if key == "backend" or local.is_file() else named)
    return check_rig(tables, file.name)


def is_own(table: object) -> bool:
    """Whether a table of a rig file describes a device of one's own."""
    return isinstance(table, dict) and table.get("kind") == "own"


@cache
def _model(drives: Found, touch: Found) -> type[RigFile]:
    """A rig file with devices of two kinds.

    Raises:
        ScenarioError: If no file can hold the settings of one of them.
    """
    kinds: dict[Role, Found] = {"drives": drives, "touch": touch}
    if kinds == RigFile.kinds:
        return RigFile
    keys: dict[str, Any] = {}
    for role, found in kinds.items():
        if found.name == DEFAULT_KINDS[role]:
            continue
        settings = found.kind.settings
        try:
            create_model("Table", __config__=RigFile.model_config, table=(settings, ...))
        except (PydanticUserError, NameError, TypeError) as error:
            raise ScenarioError(
                f"{role}.kind = '{found.name}': the package {found.package}: no rig file can hold "
                f"its settings: {' '.join(str(error).split())[:200]}"
            ) from error
        keys[role] = (settings, ...)
    made = create_model("RigFile", __base__=RigFile, **keys)
    made.kinds = kinds
    return made


def check_rig(tables: Tables, source: str) -> RigFile:
    """The rig that the tables describe.

    Raises:
        TwinError: If anything in them is unknown or out of range.
    """
    axes = {
        name: {"name": name, "node": node, **axis}
        for node, name in enumerate(("phi", "theta"), start=1)
        if isinstance(axis := tables.get(name), dict)
    }
    whole = {**tables, **axes}
    try:
        found = []
        for role, default in DEFAULT_KINDS.items():
            table = tables.get(role)
            kind = table.get("kind", default) if isinstance(table, dict) else default
            if isinstance(table, dict) and "kind" in table and "backend" in tables:
                raise ScenarioError(f"{role}.kind: a rig with a backend has one class for both")
            found.append(find_kind(role, kind))
            if isinstance(table, dict):
                whole[role] = {key: value for key, value in table.items() if key != "kind"}
        model = _model(*found)
    except ScenarioError as error:
        raise ScenarioError(f"{source}: {error}") from error
    return validate(model, whole, source)
