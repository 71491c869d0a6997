"""`controllers`.

Every range holds: of laws, observers and references for objects and for scenarios alike."""

import math
import re
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import pytest
from annotated_types import Len
from pydantic import ValidationError

from controllers.arrays import NotNegative, Positive, check
from controllers.ballplate import BallPlate
from controllers.observers import Luenberger
from controllers.smith import Smith
from twin.base.errors import ScenarioError
from twin.scenario.describe import every_kind, find_keys
from twin.scenario.schema import checked_settings, choices


def outside(allowed, whole):
    """The numbers next to a range in words, as ``> 0, <= 10``, or to a choice, as ``1, 2``."""
    bounds = [*filter(None, allowed.split(", "))]
    if bounds and bounds[0][0] not in "<>":
        yield from (float(bounds[0]) - 1, float(bounds[-1]) + 1)
        return
    for bound in bounds:
        sign, value = bound.split()[0], float(bound.split()[1])
        way = math.inf if sign[0] == "<" else -math.inf
        beyond = value + math.copysign(1, way) if whole else math.nextafter(value, way)
        yield beyond if sign[1:] else value


def wrong(key):
    """Values that a key described in words does not allow, in every way."""
    kind, _, several = key.type.partition("list of ")
    if "text" in key.type or "number" not in key.type or key.default == []:
        return
    whole = "whole" in key.type
    numbers = [int(n) if whole else n for n in outside(key.allowed, whole)]
    numbers += [] if whole else [math.nan, math.inf, -math.inf]
    if not several or " or " in kind:
        yield from numbers
    if several:
        given = key.default if isinstance(key.default, list) else [1.0]
        nested = isinstance(given[0], list)
        count = int(several.split()[0]) if several[0].isdigit() else len(given)
        full = given if len(given) == count else given * count
        for number in numbers:
            last = [*full[-1][:-1], number] if nested else number
            yield [*full[:-1], last]
        if several[0].isdigit():
            yield full[:-1]
            yield [*full, full[-1]]


KINDS = every_kind()


POLES_ALONE = {"controller.pole_placement"} | {
    f"observer.{name}" for name in ("luenberger", "nonlinear_luenberger", "ideal")
}
"""Kinds without a range in words."""


@pytest.mark.parametrize("kind", KINDS)
def test_a_value_outside_its_range_is_refused_by_class_and_scenario(kind):
    table, _, name = kind.partition(".")
    cls, tried = choices(table)[name], 0
    needed = {"file": __file__} if kind == "controller.fmu" else {}
    for key in KINDS[kind]:
        field = key.key.partition(".")[2]
        for value in wrong(key):
            tried += 1
            with pytest.raises(ValueError, match=rf"\A{field} must be .*\Z"):
                cls(**needed, **{field: value})
            with pytest.raises(ValidationError):
                checked_settings(cls, needed | {field: value})
    assert bool(tried) == (kind not in POLES_ALONE)


@pytest.mark.long
@pytest.mark.parametrize(
    "key", [key for key in find_keys() if list(wrong(key))], ids=lambda key: key.key
)
def test_a_value_outside_its_range_is_refused_by_a_scenario_that_names_its_key(scenario, key):
    for value in wrong(key):
        with pytest.raises(ScenarioError, match=re.escape(key.key.rpartition(".")[2])):
            scenario(f"{key.key}={value}")


@pytest.mark.parametrize(
    ("made", "field", "beyond", "allowed"),
    [
        *((cls, "period", 0, "above 0") for cls in choices("observer").values()),
        (partial(Smith, observer=Luenberger()), "delay", -1e-9, "0 or more"),
        *((BallPlate, name, 0, "above 0") for name in ("mass", "radius", "inertia", "gravity")),
        (BallPlate, "height", -1e-9, "0 or more"),
    ],
)
def test_what_is_given_by_whoever_builds_it_has_a_range_too(made, field, beyond, allowed):
    for value in (beyond, -1.0, math.inf, math.nan):
        with pytest.raises(ValueError, match=rf"\A{field} must be a finite number, {allowed}"):
            made(**{field: value})


@dataclass
class Odd:
    one: NotNegative | None = None
    few: tuple[Positive, ...] = ()
    two: Annotated[tuple[NotNegative, ...], Len(2, 2)] | None = None
    points: tuple[tuple[float, float], ...] = ()
    whole: int = 0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"one": -1}, "one must be a finite number, 0 or more, got -1"),
        ({"few": (1, 0)}, r"few must be a list, each a finite number, above 0, got \[1, 0\]"),
        (
            {"two": (1,)},
            r"two must be a list, each a finite number, 0 or more, 2 of them, got \[1\]",
        ),
        (
            {"points": ((1, 2), (1, 2, 3))},
            "points must be a list, each a list of 2, each a finite number",
        ),
        ({"points": 3.0}, "points must be a list, each a list of 2, each a finite number, got 3.0"),
        ({"whole": 1.5}, "whole must be a whole number, got 1.5"),
        ({"one": "much"}, "one must be a finite number, 0 or more, got much"),
    ],
    ids=str,
)
def test_what_is_allowed_is_said_in_one_line(wrong, said):
    with pytest.raises(ValueError, match=rf"\A{said}.*\Z"):
        check(Odd(**wrong))
    check(Odd(one=0, few=(1, 2.5), two=(0, 1), points=((1, 2),), whole=3))
