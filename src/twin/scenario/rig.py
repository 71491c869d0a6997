"""What a rig file may say: bus, drives, touch screen, limits; checked like a scenario."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from twin.base.errors import ScenarioError
from twin.base.validation import read_tables
from twin.devices.akd.config import AkdConfig, AxisConfig, BusConfig, DriveSettings
from twin.devices.common import wider
from twin.devices.lumio.config import CalibrationError, LumioConfig, read_calibration
from twin.devices.own import OwnConfig
from twin.scenario.load import Tables, validate
from twin.scenario.schema import CAMS_DEG, RigLimitsTable, Scenario, Section

LATE_PERIODS = 25
LONGEST_PERIOD = 0.02
"""Control period in s at which a rig file is checked by itself; what a shorter one cannot have, as
the frames of a slow bus, is refused when the period is known."""


class RigFile(Section):
    """One real rig.

    ``backend``: file and class of hardware of one's own, in place of drives and touch screen.
    ``own``: what it is made with, and the thresholds that watch over it.
    ``home_deg``: plate angles (phi, theta) at which it stands when switched on.
    ``cams``: file of its cam table; that of the model if it is not given.
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

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        """Drives and a touch screen, or a backend."""
        wired = {"bus", "drives", "phi", "theta", "touch", "cams"} & self.model_fields_set
        if self.backend is None and self.touch is None:
            raise ValueError("touch is missing: a rig has a touch screen, or a backend")
        if self.backend is None and self.limits.angle_deg > CAMS_DEG:
            raise ValueError(f"limits.angle_deg: the cams reach {CAMS_DEG:g}")
        if self.backend is None and "own" in self.model_fields_set:
            raise ValueError("own is for hardware of one's own; it needs backend = 'FILE.py:CLASS'")
        if self.backend is not None and wired:
            raise ValueError(f"{', '.join(sorted(wired))}: a rig with a backend has none of these")
        if self.backend is None:
            self.servos(LONGEST_PERIOD), self.uncalibrated_screen()
        return self

    @property
    def fingerprint(self) -> str:
        """Hash of everything that the file says, and of the files of cams and backend it names."""
        said = json.dumps(
            self.model_dump(mode="json", exclude={"title", "patience"}), sort_keys=True
        )
        digest = hashlib.sha256(said.encode())
        for named in (self.cams, (self.backend or "").rpartition(":")[0]):
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

    def _on_the_wire(self) -> None:
        if self.backend is not None:
            raise ScenarioError(
                f"{self.title}: this is for drives and touch screens of the twin's own kinds; this "
                f"rig has a backend, {Path(self.backend).name}"
            )

    def servos(self, period: float) -> AkdConfig:
        """The drives' settings, for a control period in s.

        Raises:
            TwinError: If they do not go together.
        """
        self._on_the_wire()
        axes = self.phi, self.theta
        return AkdConfig(**vars(self.drives), bus=self.bus, axes=axes, period=period)

    def uncalibrated_screen(self) -> LumioConfig:
        """The touch screen's settings, without the calibration that a file has.

        Raises:
            TwinError: If they do not go together.
        """
        self._on_the_wire()
        assert self.touch is not None
        if None not in (self.touch.calibration, self.touch.calibration_file):
            raise ScenarioError("touch: calibration or calibration_file; both cannot hold")
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
            found = [*self.servos(period).relaxed, *self.uncalibrated_screen().gate.relaxed]
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
    tables = read_tables(file, f"--rig {file}")
    places = (tables, "backend"), (tables, "cams"), (tables.get("touch"), "calibration_file")
    for table, key in places:
        if isinstance(table, dict) and isinstance(named := table.get(key), str):
            beside = file.parent / named
            table[key] = str(beside if key == "backend" or beside.is_file() else named)
    return check_rig(tables, file.name)


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
    return validate(RigFile, {**tables, **axes}, source)
