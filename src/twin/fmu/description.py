"""An FMU's variables, the model description of FMI 2.0 and 3.0, and what the C source is told."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.data_file import packaged
from twin.hal.interface import Limits
from twin.page import filled
from twin.scenario.describe import UNIT, meanings
from twin.scenario.schema import Scenario
from twin.settings import Setting, Unit, settings_of
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import BallStart, Parts
from twin.sim.rig import DriveModel, TransmissionError
from twin.sim.sensors import EncoderModel, TouchModel

SOURCES: tuple[type, ...] = (
    *(BallStart, Parts, Friction, DriveModel, TransmissionError),
    *(Limits, TouchModel, EncoderModel),
)
"""Whose settings are parameters, where the exact equations know them."""
NO_SUFFIX = {Unit.MM: "_mm", Unit.UM: "_um", Unit.DEG: "_deg", Unit.PERCENT: "_percent"}
"""Units whose name ends a key; the parameter is in SI, so its name does without."""
TUNABLE = ("plant.friction.", "plant.servo.", "plant.level", "disturbance.", "rig.cam_")
"""How the names of parameters begin that may be set while it runs; so may variances."""
TABLES = packaged("twin.fmu", "variables.toml")
"""What every FMU has besides these settings; the file says what is what."""
SEEDS = 2**31
"""Number of seeds, which an integer of FMI 2.0 can be."""


class Variable(NamedTuple):
    """One variable of a model description; its value reference is its place in the list.

    Attributes:
        name: Its name; ``[1]`` and ``[2]`` end those of a pair (x, y) or (phi, theta).
        causality: As FMI has it: independent, input, output, local or parameter.
        variability: continuous, discrete, fixed, tunable or constant.
        meaning: What it is, in a sentence.
        unit: SI unit; empty for none.
        type: Real, Integer or Boolean.
        start: Its value at the beginning; None for what is calculated.
        low: The smallest number it may be.
        high: The largest.
    """

    name: str
    causality: str
    variability: str
    meaning: str
    unit: str = ""
    type: str = "Real"
    start: float | None = None
    low: float = -math.inf
    high: float = math.inf

    @property
    def numbers(self) -> dict[str, str]:
        """What a description says of its type: least, largest and first value, where there are."""
        limits = {"min": self.low, "max": self.high} if self.type != "Boolean" else {}
        found = {name: limit for name, limit in limits.items() if abs(limit) < LARGEST}
        found |= {} if self.start is None else {"start": self.start}
        if self.type == "Boolean":
            return {name: "true" if value else "false" for name, value in found.items()}
        how = int if self.type == "Integer" else float
        return {name: str(how(value)) for name, value in found.items()}

    @property
    def settable(self) -> str:
        """When it may be set, as the C source says it."""
        when = {"tunable": "ALWAYS", "fixed": "AT_START"}.get(self.variability, "NEVER")
        return "ALWAYS" if self.causality == "input" else when

    @property
    def range(self) -> tuple[float, float, float]:
        """Its first, least and largest value for the C source."""
        largest = INTEGER if self.type == "Integer" else LARGEST
        low, high = np.clip((self.low, self.high), -largest, largest).tolist()
        return float(self.start or 0.0), low, high


def variables(scenario: Scenario, phase: float, *, path: bool = False) -> list[Variable]:
    """All variables of the rig of a scenario on the exact equations.

    Args:
        scenario: The scenario.
        phase: At which share of a frame the first frame of the screen comes.
        path: Whether its reference is an output, too.
    """
    model: BallPlate = scenario.plant.ball.model
    values = {
        "rig.period": scenario.rig.period,
        "plant.step": scenario.plant.step,
        "gravity": model.gravity,
        "height": model.height,
        "noise": 1,
        "seed": scenario.seed % SEEDS,
        "sensors.noise_hold": scenario.sensors.noise_hold,
        "sensors.touch.frame_phase": phase,
    }
    listed = [*TABLES["signal"], *TABLES["reference"] * path]
    found = [Variable(**each) for each in listed]
    found += [Variable(start=values[each["name"]], **each) for each in TABLES["own"]]
    return [*found, *parameters(scenario)]


def parameters(scenario: Scenario) -> Iterator[Variable]:
    """The keys of a scenario that the exact equations, drives, sensors and limits know, in SI."""
    for source in SOURCES:
        for field, about in settings_of(source).items():
            if not about.exact:
                yield from _parameter(scenario, about, meanings(source).get(field, ""))


def _parameter(scenario: Scenario, about: Setting, meaning: str) -> Iterator[Variable]:
    suffix = NO_SUFFIX.get(about.unit, "")
    base = about.key.removesuffix(suffix)
    values: Any = about.unit.to_si(about.of(scenario))
    pair = isinstance(values, tuple)
    found = UNIT.search(meaning)
    unit = TABLES["said"].get(base, found["unit"] if found else "")
    tunable = base.startswith(TUNABLE) or base.endswith(".variance")
    kind = "Integer" if isinstance(about.default, int) else "Real"
    limits = {name: about.unit.to_si(limit) for name, limit in about.bounds.items()}
    low = limits.get("ge", math.nextafter(limits.get("gt", -math.inf), math.inf))
    high = limits.get("le", math.nextafter(limits.get("lt", math.inf), -math.inf))
    meaning += f" Key of `ballplate describe`: {about.key}." if suffix else ""
    for i, value in enumerate(values if pair else (values,)):
        name = f"{base}[{i + 1}]" if pair else base
        how = "tunable" if tunable else "fixed"
        yield Variable(name, "parameter", how, meaning, unit, kind, value, low, high)


LARGEST = float(np.finfo(float).max)
INTEGER = 2.0**31 - 1
BRACES = str.maketrans("[]", "{}")
REMEMBERED = 0.25
"""Least time in s for which the screen remembers the ball, so that its dead time may be set."""


TEMPLATES = Path(__file__).with_name("templates")


def model_description(
    scenario: Scenario, variables: Sequence[Variable], *, fmi: int, **names: Any
) -> dict[str, str]:
    """The descriptions of FMI 2.0 or 3.0 as XML, by the names of their files.

    Args:
        scenario: Whose rig it is.
        variables: In the order of their value references.
        fmi: 2 or 3.
        names: ``name`` of the model and its binaries; ``token``, by which FMU and description know
            each other; ``compiled``, the source files.
    """
    given = {"scenario": scenario, "variables": variables, "fmi": fmi, **names}
    given |= {"version": version("ballplate"), "exponents": exponents}
    files = {"modelDescription.xml": "", "buildDescription.xml": "sources/"}
    return {
        f"{place}{file}": filled(TEMPLATES / f"{file}.j2", **given)
        for file, place in list(files.items())[: fmi - 1]
    }


def exponents(unit: str) -> dict[str, int]:
    """Those of the base units in an SI unit, as ``kg m^2`` or ``rad/s^2``; all factors are 1."""
    if unit == "Hz":
        return {"s": -1}
    found = re.findall(r"(/?)([a-z]+)\^?(\d?)", unit)
    return {base: int(power or 1) * (-1 if over else 1) for over, base, power in found}


def c_name(variable: str) -> str:
    """What the C source calls a variable: the first of a pair without number, ``PLANT_LEVEL``."""
    bare = re.sub(r"\[(\d+)\]$", lambda n: "" if n[1] == "1" else f"_{n[1]}", variable)
    return bare.replace(".", "_").upper()


def c_source(
    scenario: Scenario,
    variables: Sequence[Variable],
    token: str,
    surface: Array | None,
    path: Array | None,
) -> dict[str, str]:
    """The two files that tell the C source of its scenario, by name.

    Args:
        scenario: Whose rig it is.
        variables: In the order of their value references.
        token: By which FMU and description know each other; hexadecimal.
        surface: Relative friction and slope along x and y over the screen, shape (n, m, 3).
        path: The reference at the control periods, x, y and their first and second derivatives,
            shape (K, 6); None where it is no output.
    """
    rows = np.zeros((1, 6)) if path is None else path
    grid = np.zeros((1, 1, 3)) if surface is None else surface
    touch = scenario.sensors.touch
    waits = touch.dead_time + 4 * touch.dead_time_spread
    waits += 1 / touch.frame_rate if touch.frame_rate else 0.0
    given = {
        "scenario": scenario,
        "variables": variables,
        "token": token,
        "c_name": c_name,
        "ring": 2 + math.ceil(max(waits, REMEMBERED) / scenario.rig.period),
        "size": (0, 0) if surface is None else surface.shape,
        "sloping": int(bool(grid[..., 1:].any())),
        "path_rows": 0 if path is None else len(path),
        "surface": json.dumps(grid.tolist()).translate(BRACES),
        "path": json.dumps(rows.tolist()).translate(BRACES),
    }
    names = ("scenario.h", "scenario.c")
    return {name: filled(TEMPLATES / f"{name}.j2", **given) for name in names}
