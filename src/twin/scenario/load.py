"""Loads a checked scenario from a name and overrides, or gives one clear line about an error."""

from __future__ import annotations

import copy
import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from controllers.catalog import LAWS_FOLDER, broken, describe_incomplete_classes, left_alone
from twin.base.data_file import read_tables
from twin.base.errors import ScenarioError, list_first, nearest
from twin.base.shipped import chosen, find, shipped_in
from twin.base.validation import BeyondModel, Model, first_finding, keys_of
from twin.scenario import schema
from twin.scenario.changing import at_time, problem_of_changes
from twin.scenario.merging import Tables, find_replaced, merge_tables, put, scale_lengths, setting
from twin.scenario.rig_tables import RigLimitsTable
from twin.scenario.schema import CATALOG_TABLES, Scenario
from twin.scenario.titles import restate_kinds, restate_numbers


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
    found = _resolve_without_lag(own, source, settings)
    rig = found[0].get("rig")
    lag = rig.get("plate_lag", 0.0) if isinstance(rig, Mapping) else 0.0
    above, over = lagging.get("above", 0.0), {k: v for k, v in lagging.items() if k != "above"}
    if not isinstance(above, int | float) or not above >= 0:
        raise ScenarioError(f"{source}: {LAGGING}.above: must be a lag in s, got {above!r:.40}")
    late = isinstance(lag, int | float) and lag > above
    if not (over and late):
        return found
    return _resolve_without_lag(merge_tables(own, over), source, settings)


LAGGING = "lagging"
"""Tables of a scenario that lie over its own on a rig with a longer ``rig.plate_lag``."""


def _resolve_without_lag(
    tables: Mapping[str, Any], source: str, settings: Collection[tuple[str, Any]]
) -> tuple[Tables, str]:
    """The tables of ``resolve`` without a choice by the plate's lag."""
    merged, share, one_left = put(tables, settings), 1.0, False
    file = merged.pop("parameters", None)
    if file is not None:
        if not isinstance(file, str):
            raise ScenarioError(f"{source}: parameters: must be the name of a file, got {file!r}")
        more = _parameters(file, source)
        if more.keys() >= LAB_RIG_KEYS:  # values by dotted key: under the overrides, like them
            more, settings = {}, [*_known_values(file, more), *settings]
        merged, share, one_left = _merge_parameters(tables, more, settings)
        merged.pop("parameters", None)
        source = f"{source} with {file}"
    merged = _judge_in_time(tables, merged, settings)
    if "title" not in dict(settings):
        with suppress(OverflowError):  # the check of the tables reports the number
            merged = restate_numbers(tables, merged, share, one_left=one_left)
        merged = restate_kinds(tables, merged)
    return merged, source


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
    return merge_tables(_parameters(under, source, file, *over), tables)


def _merge_parameters(
    tables: Mapping[str, Any], more: Mapping[str, Any], settings: Collection[tuple[str, Any]]
) -> tuple[Tables, float, bool]:
    """The tables of a scenario, replaced first by a parameter file and then by settings.

    If the operating area is then smaller than the one that the scenario was made for, the lengths
    of its reference and the start of the ball are scaled down in proportion. On a rig of one axis
    the reference keeps its motion along x only.

    Returns:
        The tables, the factor on lengths, and whether one axis of two is left.
    """
    merged = put(merge_tables(tables, more), settings)
    try:
        limits = (each.get("rig", {}).get("limits", {}) for each in (tables, merged))
        was, now = (each.get("area", RigLimitsTable().area) for each in limits)
        axes = [each.get("plant", {}).get("axes", 2) for each in (tables, merged)]
        areas = list(zip(now, was, strict=True))[: axes[1]]
        share = min(1.0, *(new / old for new, old in areas))
        one_left = axes[1] < axes[0]
        if share >= 1 and not one_left:
            return merged, 1.0, False
        own, kind = tables["reference"], merged["reference"].get("kind")
        own = own if own.get("kind") == kind else {"kind": kind}
        cls: Any = schema.choices("reference")[kind]
        smaller = {}
        if share < 1:
            known = {name: own.get(name, getattr(cls, name, None)) for name in cls.lengths}
            smaller = {
                name: scale_lengths(value, share) for name, value in known.items() if np.any(value)
            }
        found = copy.deepcopy(dict(tables)) | {"reference": {**own, **smaller}}
        start = found.get("plant", {}).get("start", {})
        start.update({key: scale_lengths(start[key], share) for key in start.keys() & set("xy")})
        if one_left:
            for key in ("y", "y_rate", "spin"):
                start.pop(key, None)
    except (AttributeError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return merged, 1.0, False  # the check of the tables reports the mistake
    return put(merge_tables(found, more), settings), share, one_left


def _judge_in_time(
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


def describe_replaced(name: str, settings: Collection[tuple[str, Any]]) -> str:
    """The settings of a scenario's law that changes replace, in one line; empty if there are none.

    Args:
        name: A shipped scenario, or a TOML file.
        settings: Dotted keys and values, as ``resolve`` takes them.

    Raises:
        ScenarioError: If the scenario cannot be read, or a key leads through a value.
    """
    tables, source = read(name)
    kinds = [(key, value) for key, value in settings if key == "controller.kind"]
    old = find_replaced(put(tables, kinds), [key for key, _ in settings])
    new, replaced = (
        " and ".join(f"controller.{each}" for each in dict.fromkeys(names))
        for names in (old.values(), old)
    )
    return f"{new} replaces {replaced} of {source}" if old else ""


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
        if not each.over:
            continue
        for share in (0.001, 0.999):
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
        found = first_finding(model, error, _catalog_beyond(model, prefix.removesuffix(".")))
        raise ScenarioError(f"{source}: {prefix}{found}") from None


MAX_NAMED_KINDS = 4
"""Number of kinds with a key that a message names."""


def _catalog_beyond(model: type[BaseModel], table: str) -> BeyondModel:
    """What the catalog has beyond the model of a scenario, or of the settings of one kind.

    Args:
        model: The scenario, or the settings of a law, observer or reference.
        table: Of settings the table they are in.
    """
    if model is Scenario:
        kinds = {f"{each}.kind": list(schema.choices(each)) for each in CATALOG_TABLES}
        return BeyondModel(keys=every_key(), values=kinds)
    having: dict[str, list[str]] = {}
    kinds_of_table = schema.choices(table) if table in CATALOG_TABLES else {}
    for kind, cls in kinds_of_table.items():
        for key in schema.settings_model(cls).model_fields:
            having.setdefault(key, []).append(kind)
    owners = {
        key: f"{table}.kind = {list_first(kinds, MAX_NAMED_KINDS)}" for key, kinds in having.items()
    }
    return BeyondModel(owners=owners)


def every_key() -> list[str]:
    """Every dotted key of a scenario, with the settings of every law, observer and reference."""
    found = list(keys_of(Scenario))
    for table in CATALOG_TABLES:
        for cls in schema.choices(table).values():
            found += [f"{table}.{name}" for name in schema.settings_model(cls).model_fields]
    return list(dict.fromkeys(found))
