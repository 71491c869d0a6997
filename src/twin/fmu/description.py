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
from controllers.ballplate import STATES, BallPlate
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
SAID = {
    "plant.friction.viscous": "s",  # m per m/s
    "sensors.touch.dead_time": "s",
    "sensors.touch.frame_rate": "Hz",
}
"""Units that the meaning of a key does not give, or gives in words."""
MEASURED = {"x": "m", "phi": "rad", "y": "m", "theta": "rad"}
SEEDS = 2**31
"""Number of seeds, which an integer of FMI 2.0 can be."""
FAULTS = (
    "0 none, 1 ball outside its area, 2 plate past its limit, 3 ball lost, 4 ball too fast, "
    "5 command not finite; from a fault on the rig levels its plate"
)
WISHED = "Where the scenario's reference wants the ball; after its end as at its end."


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
        how = {"Boolean": lambda value: str(bool(value)).lower(), "Integer": int, "Real": float}
        return {name: str(how[self.type](value)) for name, value in found.items()}

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
    along = [
        Variable(f"reference_{axis}{order}", "output", "continuous", WISHED, f"m{unit}")
        for order, unit in (("", ""), ("_rate", "/s"), ("_acc", "/s^2"))
        for axis in "xy"
    ]
    return [*_signals(), *along * path, *_own(scenario, phase), *parameters(scenario)]


def _signals() -> Iterator[Variable]:
    """Time, inputs, outputs and the truth; columns of a record have their names."""
    smooth, jumps = "continuous", "discrete"
    yield Variable("time", "independent", smooth, "Time.", "s")
    for axis in ("phi", "theta"):
        what = f"Commanded plate rate {axis}', held for each control period."
        yield Variable(f"rate_{axis}", "input", smooth, what, "rad/s", start=0.0)
    for name, unit in MEASURED.items():
        yield Variable(f"measured_{name}", "output", smooth, f"{name} as measured.", unit)
    yield Variable("age", "output", smooth, "How long ago the frame of the screen came.", "s")
    what = "Whether the screen feels the ball."
    yield Variable("touched", "output", jumps, what, type="Boolean")
    yield Variable("fault", "output", jumps, FAULTS, type="Integer")
    for axis in ("phi", "theta"):
        what = f"Commanded plate rate {axis}' within the limits of the rig."
        yield Variable(f"applied_{axis}_rate", "local", smooth, what, "rad/s")
    for name in STATES:
        unit = MEASURED[name.removesuffix("_rate")] + "/s" * name.endswith("_rate")
        what = f"{name} as it is; no rig can measure it."
        yield Variable(f"true_{name}", "local", smooth, what, unit)
    what = "Whether the ball has never left the screen."
    yield Variable("true_on_plate", "local", jumps, what, type="Boolean")


def _own(scenario: Scenario, phase: float) -> Iterator[Variable]:
    """What is of the FMU as a whole, or of no dataclass with settings."""
    model: BallPlate = scenario.plant.ball.model
    for name, value, unit, what in (
        ("rig.period", scenario.rig.period, "s", "Control period."),
        ("plant.step", scenario.plant.step, "s", "Time step of the simulation."),
        ("gravity", model.gravity, "m/s^2", "Gravitational acceleration."),
        ("height", model.height, "m", "From the cardan joint up to the screen."),
    ):
        yield Variable(name, "local", "constant", what, unit, start=value)
    given = "parameter", "fixed"
    what = "Whether there is noise at all."
    yield Variable("noise", *given, what, "", "Boolean", 1, 0, 1)
    seed = scenario.seed % SEEDS
    yield Variable("seed", *given, "Which noise is drawn.", "", "Integer", seed, 0, SEEDS - 1)
    what = "How long one draw of the noise holds; 0 for a new one every control period."
    hold = scenario.sensors.noise_hold
    yield Variable("sensors.noise_hold", *given, what, "s", "Real", hold, 0)
    what = "At which share of a frame the first frame comes."
    name = "sensors.touch.frame_phase"
    yield Variable(name, *given, what, "", "Real", phase, 0, math.nextafter(1, 0))


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
    unit = SAID.get(base, found["unit"] if found else "")
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
