"""What of a scenario a slider moves: plant, sensors, and the numbers of law and observer."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

from controllers.interfaces import DelayedObserver, Law, Observer
from twin.scenario.describe import every_kind
from twin.scenario.schema import choices


class Slider(NamedTuple):
    """A slider.

    Attributes:
        key: Of the scenario.
        entry: Which of the key's numbers; None if it has one.
        label: In words.
        unit: Of what is shown.
        scale: What is shown of one of the key's own unit.
        low: Least of what is shown.
        high: Largest.
        step: From one value to the next.
        help: What it does, in a sentence.
    """

    key: str
    entry: int | None
    label: str
    unit: str
    scale: float
    low: float
    high: float
    step: float
    help: str


DELAY = ("ms", 1000, 0, 150, 1)
"""Unit, scale and range of a delay."""
ARM = "Lever arm of the rolling resistance: the larger, the harder the ball is to set rolling."
LATE = "How late the controller learns where the ball is."
LEVEL = "The rig does not stand level: the ball rolls although the plate seems to be level."
PLANT = (
    Slider("plant.friction.rolling_mm", None, "rolling friction", "mm", 1, 0, 0.5, 0.01, ARM),
    Slider("sensors.touch.dead_time", None, "dead time of the touch screen", *DELAY, LATE),
    Slider("plant.level_deg", 0, "tilted base, along x", "deg", 1, -2, 2, 0.05, LEVEL),
    Slider("plant.level_deg", 1, "tilted base, along y", "deg", 1, -2, 2, 0.05, LEVEL),
)
ASSUMED = "What the controller takes the dead time to be."
PREDICTOR = Slider("predictor.delay", None, "dead time that is assumed", *DELAY, ASSUMED)


class Gain(NamedTuple):
    """A number of a law or an observer that a slider multiplies.

    Attributes:
        key: Of the scenario.
        entry: Which of its numbers; None if it has one.
        label: In words.
        value: As it is now.
        help: What it is, in words; of several numbers of a key the first has it.
    """

    key: str
    entry: int | None
    label: str
    value: float
    help: str = ""


def value_in(tables: Mapping[str, Any], key: str, entry: int | None = None) -> Any:
    """The value of a dotted key, or one of its numbers; None if there is none."""
    value: Any = tables
    for name in key.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value if entry is None or value is None else value[entry]


def moved(tables: Mapping[str, Any], slider: Slider, shown: float) -> dict[str, Any]:
    """The setting that a slider stands for when it shows a value."""
    value = shown / slider.scale
    if slider.entry is None:
        return {slider.key: value}
    values = list(value_in(tables, slider.key))
    values[slider.entry] = value
    return {slider.key: values}


def shown_by(tables: Mapping[str, Any], slider: Slider) -> float:
    """The value that a slider shows of a scenario."""
    return slider.scale * float(value_in(tables, slider.key, slider.entry))


def multiplied(found: Sequence[Gain], gain: Gain, factor: float) -> dict[str, Any]:
    """The setting in which one of the numbers found is multiplied."""
    values = [
        each.value * (factor if each == gain else 1.0) for each in found if each.key == gain.key
    ]
    return {gain.key: values[0] if gain.entry is None else values}


def sliders(tables: Mapping[str, Any]) -> list[Slider]:
    """The sliders of a scenario's plant, sensors and predictor."""
    predictor = [] if tables.get("predictor") is None else [PREDICTOR]
    return [*PLANT, *predictor]


def gains(tables: Mapping[str, Any], table: str) -> list[Gain]:
    """The numbers of the present law or observer other than 0, as written or by default.

    Args:
        tables: A scenario's.
        table: ``controller`` or ``observer``.
    """
    present = tables[table]
    cls = choices(table)[present["kind"]]
    given = {item.name for base in (Law, Observer, DelayedObserver) for item in fields(base)}
    found: list[Gain] = []
    meanings = {each.key: each.meaning for each in every_kind()[f"{table}.{present['kind']}"]}
    for item in fields(cls):
        if item.name in given or not item.init:
            continue
        value = present.get(item.name, item.default)
        if _unused(item.name, present):
            continue
        numbers = list(value) if isinstance(value, list | tuple) else [value]
        if not all(isinstance(each, int | float) and each for each in numbers):
            continue
        if any(isinstance(each, bool) for each in numbers):
            continue
        key = f"{table}.{item.name}"
        meaning = meanings.get(key, "")
        if not isinstance(value, list | tuple):
            found.append(Gain(key, None, item.name, float(value), meaning))
            continue
        for entry, (part, number) in enumerate(
            zip(_parts(meaning, len(numbers)), numbers, strict=True)
        ):
            label, more = f"{item.name}: {part}", "" if entry else meaning
            found.append(Gain(key, entry, label, float(number), more))
    return found


def _parts(meaning: str, count: int) -> list[str]:
    """What each of a key's numbers is, if its meaning lists as many things; else their numbers."""
    for listed in re.findall(r"\(([^()]+,[^()]+)\)|(?:of|on) ([^;:.]+)", meaning):
        whole = re.sub(r" in [^,]*$", "", "".join(listed))
        for text in (whole, whole.partition(",")[0]):  # a comma may be followed by units
            parts = re.split(r",? and |, ", text)
            if len(parts) == count:
                return [part.removeprefix("the ") for part in parts]
    return [str(number) for number in range(1, count + 1)]


def _unused(name: str, present: Mapping[str, Any]) -> bool:
    """Whether a setting does nothing, as another takes its place: gains that of poles."""
    return name == "poles" and present.get("gains") is not None
