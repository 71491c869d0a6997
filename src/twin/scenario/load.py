"""The clean model of a scenario: what the designer of its controller saw.

From a name and overrides to a checked scenario, or one clear line about what is wrong.
"""

from __future__ import annotations

import copy
import json
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from controllers.catalog import broken
from twin.data_file import DEEPEST, DataError, parse_toml
from twin.errors import ScenarioError, nearest, shortened
from twin.scenario import changing
from twin.scenario.schema import KINDS, TABLES, Scenario, choices, settings_model, without_ball
from twin.shipped import chosen, find, shipped_in
from twin.validation import Model, keys_of, one_line, read_tables


def clean(scenario: Scenario) -> Scenario:
    """The same controller and motion on the exact equations that the controller is designed on.

    Nothing a scenario may say of its rig is left but the ball that the designer knows, where it
    starts, control period and limits: no friction, tilt or mechanism, no dead time, quantisation or
    noise, no computing time, and no predictor, which has nothing to predict.
    """
    known = scenario.designed_on
    none = (0.0, 0.0)
    ball = {name: getattr(known, name) for name in ("mass", "radius", "inertia")}
    said: dict[str, Any] = {
        "plant": {
            "kind": "lagrange",
            "step": scenario.plant.step,
            "ball": ball,
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
    tables = {name: TABLES[name].model_validate(table) for name, table in said.items()}
    prompt = scenario.without_computing_time
    return prompt.model_copy(update={**tables, "predictor": None, "change": ()})


Tables = dict[str, Any]


def load(name: str, overrides: Sequence[str] = ()) -> Scenario:
    """The scenario of a shipped name or a TOML file, with ``key=value`` overrides.

    A key ``parameters`` names a shipped rig, or a file of identified parameters; they lie over the
    scenario's own keys and under the overrides.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    return check(*resolved(*read(name), [setting(text) for text in overrides]))


def resolved(
    tables: Mapping[str, Any], source: str, settings: Collection[tuple[str, Any]]
) -> tuple[Tables, str]:
    """A scenario's tables with its parameter file and, over that, settings; and their source.

    Raises:
        ScenarioError: If the file cannot be read, or a key leads through a value.
    """
    merged = put(tables, settings)
    file = merged.pop("parameters", None)
    if file is not None:
        if not isinstance(file, str):
            raise ScenarioError(f"{source}: parameters: must be the name of a file, got {file!r}")
        path = Path(file) if Path(file).suffix else chosen("rig", file, shipped_in("rigs"))
        more = read_tables(path, f"{source}: parameters: {file}")
        merged = put(laid_over(tables, more), settings)
        merged.pop("parameters", None)
        source = f"{source} with {file}"
    return _judged_in_time(tables, merged, settings), source


def _judged_in_time(
    tables: Mapping[str, Any], merged: Tables, settings: Collection[tuple[str, Any]]
) -> Tables:
    """Tables whose judging begins in time.

    A run that settings cut short of ``metrics.start`` is judged from the same share of it on,
    unless they say from when.
    """
    judged = merged.get("metrics")
    start = judged.get("start") if isinstance(judged, dict) else None
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

    Another ``kind`` of controller, observer or reference drops the settings of the old.
    """
    result = dict(tables)
    for key, value in more.items():
        old = result.get(key)
        match old, value:
            case dict(), dict() if key not in KINDS or value.get("kind") in {None, old.get("kind")}:
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
        raise ScenarioError(f"override '{shortened(text)}': write key=value, as in duration=10")
    try:
        return key, parse_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key, value
    except DataError as error:
        raise ScenarioError(f"override '{shortened(key)}': {error}") from None


def put(tables: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> Tables:
    """The tables with the values of dotted keys put in.

    Naming another ``kind`` of controller, observer or reference drops the settings of the old; the
    ball that is known stays.

    Raises:
        ScenarioError: If a key leads through a value.
    """
    result = copy.deepcopy(dict(tables))
    for key, new in sorted(settings, key=lambda item: not item[0].endswith(".kind")):
        names = key.split(".")
        if len(names) > DEEPEST:
            raise ScenarioError(f"override '{shortened(key)}': at most {DEEPEST} parts")
        table = result
        for depth, name in enumerate(names[:-1]):
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                path = ".".join(names[: depth + 1])
                raise ScenarioError(f"override '{key}': {path} is a value, not a table")
        if key in {f"{each}.kind" for each in KINDS} and table.get("kind") != new:
            for other in table.keys() - {"model"}:
                del table[other]
        if names == ["plant", "ball", "kind"] and table.get("kind", new) != new:
            without_ball(result["plant"], table["kind"])
        table[names[-1]] = copy.deepcopy(new)
    return result


def check(tables: Mapping[str, Any], source: str) -> Scenario:
    """The scenario that the tables describe.

    Raises:
        ScenarioError: If anything in them is unknown, of the wrong type, or out of range.
    """
    scenario, absent = recorded(tables, source)
    for line in absent.values():
        raise ScenarioError(line)
    return scenario


def recorded(tables: Mapping[str, Any], source: str) -> tuple[Scenario, dict[str, str]]:
    """The scenario that the tables describe, though this program may lack what it names.

    Returns:
        The scenario; and of each of the tables controller, observer and reference that no class
        here can be made of, one line that says why.

    Raises:
        ScenarioError: If anything else in them is unknown, of the wrong type, or out of range.
    """
    scenario = validated(Scenario, tables, source)
    absent = {}
    for table in KINDS:
        choice = getattr(scenario, table)
        known = choices(table)
        if choice.kind not in known:
            absent[table] = (
                f"{source}: {table}.kind: no '{choice.kind}'{nearest(choice.kind, known)}"
                + "".join(f"; not imported: {line}" for line in broken())
            )
            continue
        try:
            validated(settings_model(known[choice.kind]), choice.settings, source, f"{table}.")
        except ScenarioError as error:
            absent[table] = str(error)
    _check_changes(scenario, source)
    return scenario, absent


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
        validated(Scenario, tables, source, f"change.{number}.set: ")
    if wrong := changing.problem(scenario):
        raise ScenarioError(f"{source}: {wrong}")
    for number, each in enumerate(scenario.change):
        for share in (0.001, 0.999) if each.over else ():
            between = changing.at_time(scenario, each.at + share * each.over)
            on_the_way = between.model_dump(mode="json", exclude={"change"})
            validated(Scenario, on_the_way, source, f"change.{number}: on the way: ")


def validated(
    model: type[Model], tables: Mapping[str, Any], source: str, prefix: str = ""
) -> Model:
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
        raise ScenarioError(f"{source}: {prefix}{one_line(model, error, known)}") from None


def every_key() -> list[str]:
    """Every dotted key of a scenario, with the settings of every law, observer and reference."""
    found = list(keys_of(Scenario))
    for table in KINDS:
        for cls in choices(table).values():
            found += [f"{table}.{name}" for name in settings_model(cls).model_fields]
    return list(dict.fromkeys(found))
