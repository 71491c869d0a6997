"""What an FMU of a rig has of variables: inputs, outputs, truth, and the scenario's keys in SI."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.ballplate import STATES, BallPlate
from twin.hal.interface import Limits
from twin.scenario.describe import UNIT, meanings
from twin.scenario.schema import Scenario
from twin.settings import Setting, Unit, settings_of
from twin.sim.drives import DriveModel, TransmissionError
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import BallStart
from twin.sim.plant.parts import Parts
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
FAULTS = (
    "0 none, 1 ball outside its area, 2 plate past its limit, 3 ball lost, 4 ball too fast, "
    "5 command not finite; from a fault on the rig levels its plate"
)


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One variable of a model description; its value reference is its place in the list.

    Attributes:
        name: Its name; ``[1]`` and ``[2]`` end those of a pair (x, y) or (phi, theta).
        causality: As FMI has it: independent, input, output, local or parameter.
        variability: continuous, discrete, fixed, tunable or constant.
        type: Real, Integer or Boolean.
        unit: SI unit; empty for none.
        start: Its value at the beginning; None for what is calculated.
        bounds: Range as a setting has it: any of ge, gt, le, lt, in SI.
        meaning: What it is, in a sentence.
    """

    name: str
    causality: str
    variability: str
    type: str = "Real"
    unit: str = ""
    start: float | None = None
    bounds: tuple[tuple[str, float], ...] = ()
    meaning: str

    @property
    def range(self) -> tuple[float, float]:
        """The smallest and the largest number it may be."""
        low, high = -np.inf, np.inf
        for bound, limit in self.bounds:
            match bound:
                case "ge" | "gt":
                    low = limit if bound == "ge" else np.nextafter(limit, np.inf)
                case _:
                    high = limit if bound == "le" else np.nextafter(limit, -np.inf)
        return float(low), float(high)


def variables(scenario: Scenario, phase: float) -> list[Variable]:
    """All variables of the rig of a scenario on the exact equations.

    Args:
        scenario: The scenario.
        phase: At which share of a frame the first frame of the screen comes.
    """
    return [*_signals(), *_own(scenario, phase), *parameters(scenario)]


def _signals() -> Iterator[Variable]:
    """Time, inputs, outputs and the truth; columns of a record have their names."""
    yield _signal("time", "independent", "s", "Time.")
    for axis in ("phi", "theta"):
        yield Variable(
            name=f"rate_{axis}", causality="input", variability="continuous", unit="rad/s",
            start=0.0, meaning=f"Commanded plate rate {axis}', held for each control period.",
        )  # fmt: skip
    for name, unit in MEASURED.items():
        yield _signal(f"measured_{name}", "output", unit, f"{name} as it is measured.")
    yield _signal("age", "output", "s", "How long ago the frame of the screen came.")
    yield _signal("touched", "output", "", "Whether the screen feels the ball.", "Boolean")
    yield _signal("fault", "output", "", FAULTS, "Integer")
    for axis in ("phi", "theta"):
        what = f"Commanded plate rate {axis}' within the limits of the rig."
        yield _signal(f"applied_{axis}_rate", "local", "rad/s", what)
    for name in STATES:
        unit = MEASURED[name.removesuffix("_rate")] + "/s" * name.endswith("_rate")
        yield _signal(f"true_{name}", "local", unit, f"{name} as it is; no rig can measure it.")
    what = "Whether the ball has never left the screen."
    yield _signal("true_on_plate", "local", "", what, "Boolean")


def _signal(name: str, causality: str, unit: str, meaning: str, kind: str = "Real") -> Variable:
    variability = "continuous" if kind == "Real" else "discrete"
    return Variable(
        name=name, causality=causality, variability=variability, type=kind, unit=unit,
        meaning=meaning,
    )  # fmt: skip


def _own(scenario: Scenario, phase: float) -> Iterator[Variable]:
    """What is of the FMU as a whole, or of no dataclass with settings."""
    model: BallPlate = scenario.plant.ball.model
    for name, value, unit, what in (
        ("rig.period", scenario.rig.period, "s", "Control period."),
        ("plant.step", scenario.plant.step, "s", "Time step of the simulation."),
        ("gravity", model.gravity, "m/s^2", "Gravitational acceleration."),
        ("height", model.height, "m", "From the cardan joint up to the screen."),
    ):
        yield Variable(
            name=name, causality="local", variability="constant", unit=unit, start=value,
            meaning=what,
        )  # fmt: skip
    low, limits = ("ge", 0.0), ("le", 2.0**31 - 1)
    for name, kind, value, unit, bounds, what in (
        ("noise", "Boolean", 1, "", (low, ("le", 1)), "Whether there is noise at all."),
        ("seed", "Integer", scenario.seed % 2**31, "", (low, limits), "Which noise is drawn."),
        ("sensors.noise_hold", "Real", scenario.sensors.noise_hold, "s", (low,),
         "How long one draw of the noise holds; 0 for a new one every control period."),
        ("sensors.touch.frame_phase", "Real", phase, "", (low, ("lt", 1)),
         "At which share of a frame the first frame comes."),
    ):  # fmt: skip
        yield Variable(
            name=name, causality="parameter", variability="fixed", type=kind, unit=unit,
            start=value, bounds=bounds, meaning=what,
        )  # fmt: skip


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
    unit = UNIT.search(meaning)
    tunable = base.startswith(TUNABLE) or base.endswith(".variance")
    renamed = f" Key of `ballplate describe`: {about.key}." if suffix else ""
    for i, value in enumerate(values if pair else (values,)):
        yield Variable(
            name=f"{base}[{i + 1}]" if pair else base,
            causality="parameter",
            variability="tunable" if tunable else "fixed",
            type="Integer" if isinstance(about.default, int) else "Real",
            unit=SAID.get(base, unit["unit"] if unit else ""),
            start=value,
            bounds=tuple((name, about.unit.to_si(limit)) for name, limit in about.bounds.items()),
            meaning=meaning + renamed,
        )
