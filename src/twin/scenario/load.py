"""Loads a checked scenario from a name and overrides, or gives one clear line about an error.

Also made of a scenario here: its clean model, its values at a time where it changes while it runs,
and variants of it with the shortest names that distinguish them.
"""

from __future__ import annotations

import copy
import itertools
import json
import math
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ValidationError

from controllers.catalog import LAWS_FOLDER, broken, describe_incomplete_classes, left_alone
from twin.base.data_file import MAX_NESTING, DataError, parse_toml
from twin.base.errors import ScenarioError, list_first, nearest, shorten
from twin.base.settings import value_of
from twin.base.shipped import chosen, find, shipped_in
from twin.base.validation import UNKNOWN_KEY_ERRORS, Model, first_finding, keys_of, read_tables
from twin.scenario import schema
from twin.scenario.schema import CATALOG_TABLES, TIME_TOLERANCE_S, Change, Scenario

NONE_AT_ZERO = ("slew_deg", "acceleration_deg", "bandwidth_hz", "resonance_hz")
"""What of ``plant.servo`` is absent at 0 and the stronger the closer to it: no ramp leads there."""


def at_time(scenario: Scenario, time: float) -> Scenario:
    """The scenario with the values that its plant, drives and sensors have at a time in s."""
    values: dict[str, Any] = {}
    for change in sorted(scenario.change, key=lambda each: each.at):
        passed = time - change.at
        if passed < -TIME_TOLERANCE_S:
            break
        share = passed / change.over if passed < change.over - TIME_TOLERANCE_S else 1.0
        for key, goal in change.set.items():
            old = values[key] if key in values else value_of(scenario, key)
            values[key] = _between(old, _tuples(goal), share)
    return reduce(lambda model, item: _with(model, *item), values.items(), scenario)


def always_friction(scenario: Scenario) -> bool:
    """Whether the ball of a simulated rig rolls with friction all the time."""
    key = "plant.friction.rolling_mm"
    values = [each.set[key] for each in scenario.change if key in each.set]
    return all(value > 0 for value in (value_of(scenario, key), *values))


def times(scenarios: Sequence[Scenario]) -> list[float]:
    """When something changes in any of some scenarios, s, in order."""
    every = (time for each in scenarios for change in each.change for time in change.times())
    return sorted({round(time, 9) for time in every})


def problem_of_changes(scenario: Scenario) -> str:
    """Error of a scenario's changes taken together, in one line; empty if there is none.

    Each of them is known to be possible by itself.
    """
    for number, change in enumerate(scenario.change):
        found = _ramp_problem(scenario, change)
        if found:
            return f"change.{number}.set: {found}"
        if change.at >= scenario.duration:
            return (
                f"change.{number}.at: {change.at:g} s is not before the end at duration = "
                f"{scenario.duration:g} s"
            )
    for key in schema.RAMP_KEYS + schema.JUMP_KEYS:
        its = sorted((c for c in scenario.change if key in c.set), key=lambda each: each.at)
        for one, other in pairwise(its):
            if other.at < one.end or other.at == one.at:
                return (
                    f"change: {key}: changes again at {other.at:g} s, before what began at "
                    f"{one.at:g} s is over"
                )
    return ""


def _ramp_problem(scenario: Scenario, change: Change) -> str:
    """Why no ramp leads from the old values to the new ones; empty if one does."""
    before = at_time(scenario, change.at - 2 * TIME_TOLERANCE_S)
    for key in map("plant.servo.{}".format, NONE_AT_ZERO if change.over else ()):
        if key in change.set and not (change.set[key] and value_of(before, key)):
            return f"{key}: 0 stands for none, so no ramp leads there; leave out over"
    return ""


def _between(old: Any, new: Any, share: float) -> Any:
    """Interpolate between two numbers or tuples of them, at a share of the way."""
    if share == 1.0:
        return new
    if isinstance(old, tuple):
        return tuple(_between(*pair, share) for pair in zip(old, new, strict=True))
    return old + share * (new - old)


def _tuples(value: Any) -> Any:
    """Lists as the tuples that a scenario has."""
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value


def _with(model: Any, key: str, value: Any) -> Any:
    """A table with a new value under a dotted key."""
    name, _, rest = key.partition(".")
    inner = _with(getattr(model, name), rest, value) if rest else value
    return model.model_copy(update={name: inner})


def cut_short(scenario: Scenario, duration: float) -> Scenario:
    """A scenario that ends at a time in s, after one period at least, with all else as it is.

    Steady tracking is evaluated from the same time on, which may be after that end.
    """
    period = scenario.rig.period
    return scenario.model_copy(update={"duration": max(1, round(duration / period)) * period})


def clean(scenario: Scenario) -> Scenario:
    """The same controller and motion on the equations (5.9) that the controller is designed on.

    Nothing a scenario may say of its rig is left but the ball and the plate's height that the
    designer knows, where the ball starts, the plate's size and axes, control period and limits: no
    friction, tilt, wall or mechanism, no dead time, quantisation or noise, no computing time, no
    board, and no predictor, which has nothing to predict.
    """
    known = scenario.designed_on
    none = (0.0, 0.0)
    ball = {name: getattr(known, name) for name in ("mass", "radius", "inertia")}
    tables_of: dict[str, Any] = {
        "plant": {
            "kind": "lagrange",
            "axes": scenario.plant.axes,
            "ball_spin": "thesis",
            "step": scenario.plant.step,
            "size": scenario.plant.size,
            "shape": scenario.plant.shape,
            "ball": ball,
            "plate": {"height": known.height},
            "friction": {"rolling_mm": 0.0},
            "start": scenario.plant.start.model_dump() | {"spin": 0.0},
        },
        "rig": {"period": scenario.rig.period, "limits": scenario.rig.limits.model_dump()},
        "sensors": {
            "ideal": scenario.sensors.ideal,
            "touch": {"dead_time": 0.0, "grid": 0, "variance": none},
            "encoders": {"counts": 0, "variance": none},
        },
        "disturbance": {"variance": none},
    }
    tables = {
        name: schema.SCENARIO_TABLES[name].model_validate(table)
        for name, table in tables_of.items()
    }
    prompt = scenario.without_computing_time
    return prompt.model_copy(
        update={**tables, "predictor": None, "board": None, "change": (), "fault": ()}
    )


Tables = dict[str, Any]


def load(name: str, overrides: Sequence[str] = ()) -> Scenario:
    """The scenario of a shipped name or a TOML file, with ``key=value`` overrides.

    A key ``parameters`` names a shipped rig, a file of identified parameters, or the ``rig.toml``
    of a lab's student; they lie over the scenario's own keys and under the overrides. Where that
    leaves less room to the ball, reference and start become smaller in proportion, and the title
    states it.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    return check(*resolve(*read(name), [setting(text) for text in overrides]))


def resolve(
    tables: Mapping[str, Any], source: str, settings: Collection[tuple[str, Any]]
) -> tuple[Tables, str]:
    """A scenario's tables with its parameter file and, over that, settings; and their source.

    Where ``rig.plate_lag`` is then more than ``lagging.above``, in s, the other tables of
    ``lagging`` lie over the scenario's own: what leads the ball on a plate that follows late.

    Raises:
        ScenarioError: If the file cannot be read, or a key leads through a value.
    """
    lagging = tables.get(LAGGING, {})
    if not isinstance(lagging, Mapping):
        raise ScenarioError(f"{source}: {LAGGING}: must be a table of tables, got {lagging!r:.40}")
    own = {name: table for name, table in tables.items() if name != LAGGING}
    found = _merged(own, source, settings)
    rig = found[0].get("rig")
    lag = rig.get("plate_lag", 0.0) if isinstance(rig, Mapping) else 0.0
    above, over = lagging.get("above", 0.0), {k: v for k, v in lagging.items() if k != "above"}
    if not isinstance(above, int | float) or not above >= 0:
        raise ScenarioError(f"{source}: {LAGGING}.above: must be a lag in s, got {above!r:.40}")
    late = isinstance(lag, int | float) and lag > above
    return _merged(laid_over(own, over), source, settings) if over and late else found


LAGGING = "lagging"
"""Tables of a scenario that lie over its own on a rig with a longer ``rig.plate_lag``."""


def _merged(
    tables: Mapping[str, Any], source: str, settings: Collection[tuple[str, Any]]
) -> tuple[Tables, str]:
    """The tables of ``resolve`` without a choice by the plate's lag."""
    merged = put(tables, settings)
    file = merged.pop("parameters", None)
    if file is not None:
        if not isinstance(file, str):
            raise ScenarioError(f"{source}: parameters: must be the name of a file, got {file!r}")
        more = _parameters(file, source)
        if more.keys() >= LAB_RIG_KEYS:  # values by dotted key: under the overrides, like them
            more, settings = {}, [*_known_values(file, more), *settings]
        merged = _merge_tables(tables, more, settings)
        merged.pop("parameters", None)
        source = f"{source} with {file}"
    return _judged_in_time(tables, merged, settings), source


LAB_RIG_KEYS = {"lab", "student", "told"}
"""Keys by which the ``rig.toml`` of a lab's student is recognised."""


def _known_values(file: str, tables: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """The values of a lab's rig that its student knows, by dotted key.

    Raises:
        ScenarioError: If they are no table.
    """
    if not isinstance(tables["told"], dict):
        raise ScenarioError(f"{file}: told: must be a table of values, got {tables['told']!r}")
    return list(tables["told"].items())


def _parameters(file: str, source: str, *over: str) -> Tables:
    """The tables of a shipped rig or a parameter file, over those of one that it names itself.

    Raises:
        ScenarioError: If one cannot be read, or a file leads to itself.
    """
    path = Path(file) if Path(file).suffix else chosen("rig", file, shipped_in("rigs"))
    tables = read_tables(path, f"{source}: parameters: {file}")
    tables.pop("title", None)  # the rig file's; the scenario's title names the run
    under = tables.pop("parameters", None)
    if under is None:
        return tables
    if not isinstance(under, str) or under in (file, *over):
        raise ScenarioError(f"{file}: parameters: must name a different file, got {under!r}")
    return laid_over(_parameters(under, source, file, *over), tables)


def _merge_tables(
    tables: Mapping[str, Any], more: Mapping[str, Any], settings: Collection[tuple[str, Any]]
) -> Tables:
    """Tables with those of a parameter file and, over that, settings.

    Where the operating area is then smaller than the one that a scenario was made for, the lengths
    of its reference, and where the ball starts, become smaller in proportion. On a rig of one axis
    the reference does what it does along x. The title states both.
    """
    merged = put(laid_over(tables, more), settings)
    try:
        limits = (each.get("rig", {}).get("limits", {}) for each in (tables, merged))
        was, now = (each.get("area", schema.RigLimitsTable().area) for each in limits)
        axes = [each.get("plant", {}).get("axes", 2) for each in (tables, merged)]
        areas = list(zip(now, was, strict=True))[: axes[1]]
        share = min(1.0, *(new / old for new, old in areas))
        one_left = axes[1] < axes[0]
        if share >= 1 and not one_left:
            return merged
        own, kind = tables["reference"], merged["reference"].get("kind")
        own = own if own.get("kind") == kind else {"kind": kind}
        cls: Any = schema.choices("reference")[kind]
        known = {name: own.get(name, getattr(cls, name, None)) for name in cls.lengths}
        lengths = known.items() if share < 1 else ()
        smaller = {name: _times(value, share) for name, value in lengths if np.any(value)}
        found = copy.deepcopy(dict(tables)) | {"reference": {**own, **smaller}}
        start = found.get("plant", {}).get("start", {})
        start.update({key: _times(start[key], share) for key in start.keys() & set("xy")})
        for key in ("y", "y_rate", "spin") if one_left else ():
            start.pop(key, None)
    except (AttributeError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return merged  # the check of the tables reports the mistake
    found = put(laid_over(found, more), settings)
    stated = [f"lengths x {share:.3g}"] * (found["reference"] != merged["reference"])
    stated += ["along x"] * (one_left and _goes_along_y(found["reference"]))
    if stated and "title" not in dict(settings):
        title = str(found.get("title"))
        if one_left and (real := _shrink_lengths(title, known.values(), share)) != title:
            title, stated = real, [each for each in stated if not each.startswith("lengths")]
        found["title"] = ", ".join((title, *stated))
    return found


def _shrink_lengths(title: str, lengths: Iterable[Any], share: float) -> str:
    """A title with the lengths of its reference along x as they are after they have shrunk.

    Args:
        title: As ``Step to (150, 150) mm``.
        lengths: Those of the reference before, m; a length that is none of them stays.
        share: Factor on them.
    """
    flat = (np.ravel(np.array(each, dtype=object)) for each in lengths)
    known = {
        round(1000 * abs(each), 6)
        for each in itertools.chain(*flat)
        if isinstance(each, int | float)
    }

    def real(match: re.Match[str]) -> str:
        scale = 1000.0 if match[2] == "m" else 1.0
        numbers = [round(scale * float(each), 6) for each in match[1].split(",")]
        return f"{share * numbers[0]:.3g} mm" if {*numbers} <= known else match[0]

    changed = re.sub(r"\(?((?:\d+\.?\d*, )?\d+\.?\d*)\)? (mm|m)\b", real, title)
    return changed.replace(" on both axes", "") if changed != title else title


def _goes_along_y(table: Mapping[str, Any]) -> bool:
    """Whether a reference ever leaves the x axis; False of one that its check will refuse."""
    try:
        cls: Any = schema.choices("reference")[table["kind"]]
        settings = {key: value for key, value in table.items() if key != "kind"}
        with np.errstate(all="ignore"):
            motion = cls(**schema.checked_settings(cls, settings))(np.linspace(0, 60, 601))
    except (KeyError, TypeError, ValueError):
        return False
    return bool(motion[..., 1].any())


def _times(value: Any, share: float) -> Any:
    """Lengths times a share; of a row of three numbers the first is a time, which stays."""
    if isinstance(value, list | tuple):
        timed = len(value) == 3 and isinstance(value[0], int | float)
        return [*value[:timed], *(_times(each, share) for each in value[timed:])]
    return float(f"{value * share:.12g}") if isinstance(value, int | float) else value


def _judged_in_time(
    tables: Mapping[str, Any], merged: Tables, settings: Collection[tuple[str, Any]]
) -> Tables:
    """Tables with an evaluation that begins in time.

    A run that settings cut short of ``metrics.start`` is evaluated from the same share of it,
    unless they set the start.
    """
    metrics = merged.get("metrics")
    start = metrics.get("start") if isinstance(metrics, dict) else None
    match tables.get("duration"), merged.get("duration"), start:
        case (int() | float() as was, int() | float() as now, int() | float() as start) if (
            0 < now <= start < was and "metrics.start" not in dict(settings)
        ):
            return put(merged, [("metrics.start", start * now / was)])
    return merged


def read(name: str) -> tuple[Tables, str]:
    """The tables of a scenario and what to call their source in messages.

    Raises:
        ScenarioError: If there is no such scenario, or its file is not TOML.
    """
    path = find(name)
    return read_tables(path, str(path)), path.name


def laid_over(tables: Mapping[str, Any], more: Mapping[str, Any]) -> Tables:
    """Tables with those of more tables put in, key by key.

    A new ``kind`` of controller, observer or reference drops the settings of the old.
    """
    result = dict(tables)
    for key, value in more.items():
        old = result.get(key)
        match old, value:
            case dict(), dict() if key not in CATALOG_TABLES or value.get("kind") in {
                None,
                old.get("kind"),
            }:
                result[key] = laid_over(old, value)
            case _:
                result[key] = value
    return result


def setting(text: str) -> tuple[str, Any]:
    """Key and value of an override.

    Raises:
        ScenarioError: If it is not of the form ``key=value``.
    """
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not all(key.split(".")):
        raise ScenarioError(f"override '{shorten(text)}': write key=value, as in duration=10")
    try:
        return key, parse_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key, value
    except DataError as error:
        raise ScenarioError(f"override '{shorten(key)}': {error}") from None


def split_settings(text: str) -> tuple[str, ...]:
    """The overrides in one text, ``key=value; key=value``."""
    return tuple(part.strip() for part in text.split(";") if part.strip())


def put(tables: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> Tables:
    """The tables with the values of dotted keys put in.

    Naming a new ``kind`` of controller, observer or reference drops the settings of the old; the
    ball that is known stays.

    Raises:
        ScenarioError: If a key leads through a value.
    """
    result = copy.deepcopy(dict(tables))
    for key, new in sorted(settings, key=lambda item: not item[0].endswith(".kind")):
        names = key.split(".")
        if len(names) > MAX_NESTING:
            raise ScenarioError(f"override '{shorten(key)}': at most {MAX_NESTING} parts")
        table = result
        for depth, name in enumerate(names[:-1]):
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                path = ".".join(names[: depth + 1])
                raise ScenarioError(f"override '{key}': {path} is a value, not a table")
        if key in {f"{each}.kind" for each in CATALOG_TABLES} and table.get("kind") != new:
            for other in table.keys() - {"model"}:
                del table[other]
        if names == ["plant", "ball", "kind"] and table.get("kind", new) != new:
            schema.without_ball(result["plant"], table["kind"])
        table[names[-1]] = copy.deepcopy(new)
    return result


def check(tables: Mapping[str, Any], source: str) -> Scenario:
    """The scenario that the tables describe.

    Raises:
        ScenarioError: If anything in them is unknown, of the wrong type, or out of range.
    """
    scenario, absent = load_recorded(tables, source)
    for line in absent.values():
        raise ScenarioError(line)
    return scenario


def load_recorded(tables: Mapping[str, Any], source: str) -> tuple[Scenario, dict[str, str]]:
    """The scenario that the tables describe, though this program may lack the classes they name.

    Returns:
        The scenario; and of each of the tables controller, observer and reference that no class
        here can be made of, one line with the reason.

    Raises:
        ScenarioError: If anything else in them is unknown, of the wrong type, or out of range.
    """
    scenario = validate(Scenario, tables, source)
    absent = {}
    for table in CATALOG_TABLES:
        choice = getattr(scenario, table)
        known = schema.choices(table)
        if choice.kind not in known:
            absent[table] = (
                f"{source}: {table}.kind: no '{choice.kind}'{nearest(choice.kind, known)}"
                + "".join(
                    f"; not imported: {line}"
                    for line in (*broken(), *describe_incomplete_classes())
                )
                + not_run()
            )
            continue
        try:
            validate(
                schema.settings_model(known[choice.kind]), choice.settings, source, f"{table}."
            )
        except ScenarioError as error:
            absent[table] = str(error)
    _check_changes(scenario, source)
    return scenario, absent


def not_run() -> str:
    """The end of a message of a command that only reads: which files it did not run, and how to."""
    files = left_alone()
    if not files:
        return ""
    names = ", ".join(f"{LAWS_FOLDER}/{each.name}" for each in files)
    return (
        f"; {names}: not run by a command that only reads; --law {LAWS_FOLDER}/{files[0].name} does"
    )


def _check_changes(scenario: Scenario, source: str) -> None:
    """Make sure that a plant can follow every change, on the whole way to its new values.

    Raises:
        ScenarioError: If it cannot.
    """
    if not scenario.change:
        return
    tables: Tables = scenario.model_dump(mode="json", exclude={"change"})
    for number, each in sorted(enumerate(scenario.change), key=lambda item: item[1].at):
        if wrong := each.problem():
            raise ScenarioError(f"{source}: change.{number}.set: {wrong}")
        tables = put(tables, each.set.items())
        validate(Scenario, tables, source, f"change.{number}.set: ")
    if wrong := problem_of_changes(scenario):
        raise ScenarioError(f"{source}: {wrong}")
    for number, each in enumerate(scenario.change):
        for share in (0.001, 0.999) if each.over else ():
            between = at_time(scenario, each.at + share * each.over)
            on_the_way = between.model_dump(mode="json", exclude={"change"})
            validate(Scenario, on_the_way, source, f"change.{number}: on the way: ")


def validate(model: type[Model], tables: Mapping[str, Any], source: str, prefix: str = "") -> Model:
    """The tables as a model.

    Args:
        model: What they must be.
        tables: As read from a TOML file.
        source: What to call it in messages.
        prefix: Where in it the tables are.

    Raises:
        ScenarioError: If anything in them is unknown, of the wrong type, or out of range.
    """
    try:
        return model.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        known = every_key() if model is Scenario else []
        found = first_finding(model, error, known)
        if "; did you mean" not in found and (others := _kinds_with(model, error, prefix)):
            found = f"{found}; a key of {others}"
        raise ScenarioError(f"{source}: {prefix}{found}") from None


MAX_NAMED_KINDS = 4
"""Number of kinds with a key that a message names."""


def _kinds_with(model: type[BaseModel], error: ValidationError, prefix: str) -> str:
    """Kinds of a table that have its first unknown key, by name; empty if there is none."""
    table = prefix.removesuffix(".")
    unknown = [each["loc"] for each in error.errors() if each["type"] in UNKNOWN_KEY_ERRORS]
    if table not in CATALOG_TABLES or not unknown or len(unknown[0]) != 1:
        return ""
    kinds = [
        kind
        for kind, cls in schema.choices(table).items()
        if unknown[0][0] in schema.settings_model(cls).model_fields
    ]
    return f"{table}.kind = {list_first(kinds, MAX_NAMED_KINDS)}" if kinds else ""


def every_key() -> list[str]:
    """Every dotted key of a scenario, with the settings of every law, observer and reference."""
    found = list(keys_of(Scenario))
    for table in CATALOG_TABLES:
        for cls in schema.choices(table).values():
            found += [f"{table}.{name}" for name in schema.settings_model(cls).model_fields]
    return list(dict.fromkeys(found))


MAX_RANGE_VALUES = 1000
"""Values that a range may have."""


class Combination(NamedTuple):
    """One combination of values.

    Attributes:
        settings: Dotted key to value.
        label: ``KEY=VALUE`` of each, with spaces between.
        name: The shortest text that tells it from the others, with the last part of each key.
    """

    settings: tuple[tuple[str, Any], ...] = ()
    label: str = ""
    name: str = ""


def parse_variations(vary: Sequence[str]) -> dict[str, list[Any]]:
    """Key to values of each ``KEY=[A, B, ...]`` or ``KEY=A,B,...``.

    A value may be a table, as ``controller=[{kind="afl"}, {kind="lqr", rho=100}]``.

    Raises:
        ScenarioError: If a text is neither, or two have the same key.
    """
    found: dict[str, list[Any]] = {}
    for key, values in map(_parse_variation, vary):
        if key in found:
            raise ScenarioError(f"vary {key}: is given twice; give all its values in one list")
        found[key] = values
    return found


def swept(text: str) -> tuple[str, list[Any]]:
    """Key and values of ``KEY=FIRST:LAST:NUMBER``, evenly spaced, or ``KEY=[A, B, ...]``.

    Raises:
        ScenarioError: If the text is neither.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    form = f"sweep '{text[:200]}': write KEY=FIRST:LAST:NUMBER, as in duration=5:10:6, or KEY=[A,B]"
    if not key or not equals or not values:
        raise ScenarioError(form)
    if values.startswith("["):
        return _parse_variation(text)
    parts = values.split(":")
    try:
        first, last, number = float(parts[0]), float(parts[1]), int(parts[2])
    except (ValueError, IndexError):
        raise ScenarioError(form) from None
    if len(parts) != 3 or not math.isfinite(first + last) or not 2 <= number <= MAX_RANGE_VALUES:
        raise ScenarioError(f"{form}; NUMBER: 2 to {MAX_RANGE_VALUES}")
    spaced = [float(f"{value:.12g}") for value in np.linspace(first, last, number)]
    whole = "." not in parts[0] + parts[1] and all(value.is_integer() for value in spaced)
    return key, [int(value) for value in spaced] if whole else spaced


def variants(vary: Mapping[str, Sequence[Any]]) -> list[Combination]:
    """All combinations of the values of some keys; one without any if there is no key."""
    return [
        Combination(
            tuple(pair for item in each for pair in item.settings),
            " ".join(item.label for item in each),
            " ".join(item.name for item in each),
        )
        for each in itertools.product(*(_values(key, items) for key, items in vary.items()))
    ]


def comparison(what: str, keys: Iterable[str], changed: Sequence[str]) -> str:
    """The title of a comparison: what ran, over which keys, and what all runs share.

    Args:
        what: Title of the scenario, or names of several.
        keys: What is varied.
        changed: ``KEY=VALUE`` each; one of the title itself is left out.
    """
    varied_keys = ", ".join(keys)
    over = f" over {varied_keys}" if varied_keys else ""
    shown = [text for text in changed if text.partition("=")[0].strip() != "title"]
    return f"{what}{over} ({', '.join(shown)})" if shown else f"{what}{over}"


def headings(values: Sequence[Any]) -> list[str]:
    """What to call values of one key: of a table its kind, with its settings if others have it."""
    kinds = [value.get("kind") if isinstance(value, Mapping) else None for value in values]
    return [_heading(value, alone=kinds.count(kinds[i]) == 1) for i, value in enumerate(values)]


def format_toml_value(value: Any) -> str:
    """A value as TOML has it in a line; a text without its quotes."""
    return value.strip() if isinstance(value, str) else inline(value)


def _parse_variation(text: str) -> tuple[str, list[Any]]:
    key, equals, values = text.partition("=")
    key = key.strip()
    if not equals or not key or not values:
        raise ScenarioError(f"vary '{text[:200]}': write KEY=[A,B,...], as in duration=[5,10]")
    try:
        listed: Any = parse_toml(f"values = {values}")["values"]
    except tomllib.TOMLDecodeError:
        if values.count("[") != values.count("]"):
            raise ScenarioError(f"vary '{text[:200]}': brackets must match") from None
        listed = [setting(f"{key}={item}")[1] for item in values.strip("[]").split(",")]
    except DataError as error:
        raise ScenarioError(f"vary '{key[:200]}': {error}") from None
    setting(f"{key}=0")  # the key is one
    return key, listed if isinstance(listed, list) else [listed]


def _values(key: str, items: Sequence[Any]) -> list[Combination]:
    leaf = key.rpartition(".")[2]
    return [
        Combination(
            ((key, item),),
            f"{key}={format_toml_value(item)}",
            heading if leaf == "kind" or isinstance(item, Mapping) else f"{leaf}={heading}",
        )
        for item, heading in zip(items, headings(items), strict=True)
    ]


def _heading(value: Any, *, alone: bool) -> str:
    if not isinstance(value, Mapping):
        return format_toml_value(value)
    settings = [f"{key}={format_toml_value(item)}" for key, item in value.items() if key != "kind"]
    kind = str(value.get("kind", ""))
    if kind and alone:
        return kind
    return " ".join(filter(None, (kind, ", ".join(settings)))) or "{}"


def inline(value: Any) -> str:
    """A value as TOML has it in a line."""
    if isinstance(value, Mapping):
        inner = ", ".join(f"{key}={inline(item)}" for key, item in value.items())
        return f"{{{inner}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline, value))}]"
    return json.dumps(value, ensure_ascii=False, default=str)
