"""Loads a checked scenario from a name and overrides, or gives one clear line about an error.

Also made of a scenario here: its clean model, and the same cut short.
"""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from controllers.catalog import LAWS_FOLDER, broken, describe_incomplete_classes, left_alone
from twin.base.data_file import MAX_NESTING, DataError, parse_toml
from twin.base.errors import ScenarioError, list_first, nearest, shorten
from twin.base.shipped import chosen, find, shipped_in
from twin.base.validation import BeyondModel, Model, first_finding, keys_of, read_tables
from twin.scenario import schema
from twin.scenario.changing import at_time, problem_of_changes
from twin.scenario.rig_tables import SCENARIO_TABLES, RigLimitsTable, without_ball
from twin.scenario.schema import CATALOG_TABLES, Scenario


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
        name: SCENARIO_TABLES[name].model_validate(table) for name, table in tables_of.items()
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
    found = _resolve_without_lag(own, source, settings)
    rig = found[0].get("rig")
    lag = rig.get("plate_lag", 0.0) if isinstance(rig, Mapping) else 0.0
    above, over = lagging.get("above", 0.0), {k: v for k, v in lagging.items() if k != "above"}
    if not isinstance(above, int | float) or not above >= 0:
        raise ScenarioError(f"{source}: {LAGGING}.above: must be a lag in s, got {above!r:.40}")
    late = isinstance(lag, int | float) and lag > above
    return _resolve_without_lag(laid_over(own, over), source, settings) if over and late else found


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
        merged, share, one_left = _merge_tables(tables, more, settings)
        merged.pop("parameters", None)
        source = f"{source} with {file}"
    merged = _judge_in_time(tables, merged, settings)
    if "title" not in dict(settings):
        with suppress(OverflowError):  # the check of the tables reports the number
            merged = _with_real_title(tables, merged, share, one_left=one_left)
        merged = _with_real_kinds(tables, merged)
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
    return laid_over(_parameters(under, source, file, *over), tables)


def _merge_tables(
    tables: Mapping[str, Any], more: Mapping[str, Any], settings: Collection[tuple[str, Any]]
) -> tuple[Tables, float, bool]:
    """The tables of a scenario, replaced first by a parameter file and then by settings.

    If the operating area is then smaller than the one that the scenario was made for, the lengths
    of its reference and the start of the ball are scaled down in proportion. On a rig of one axis
    the reference keeps its motion along x only.

    Returns:
        The tables, the factor on lengths, and whether one axis of two is left.
    """
    merged = put(laid_over(tables, more), settings)
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
        known = {name: own.get(name, getattr(cls, name, None)) for name in cls.lengths}
        lengths = known.items() if share < 1 else ()
        smaller = {name: _times(value, share) for name, value in lengths if np.any(value)}
        found = copy.deepcopy(dict(tables)) | {"reference": {**own, **smaller}}
        start = found.get("plant", {}).get("start", {})
        start.update({key: _times(start[key], share) for key in start.keys() & set("xy")})
        for key in ("y", "y_rate", "spin") if one_left else ():
            start.pop(key, None)
    except (AttributeError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return merged, 1.0, False  # the check of the tables reports the mistake
    return put(laid_over(found, more), settings), share, one_left


def _with_real_title(
    tables: Mapping[str, Any], merged: Tables, share: float, *, one_left: bool
) -> Tables:
    """Tables with a title that states the reference as it runs.

    Rates, and lengths that a setting changed or that are along one axis of two, are stated as they
    are. Where all lengths are smaller by the factor alone, the title keeps the old ones with the
    factor.

    Args:
        tables: Those of the scenario, with the title.
        merged: Those of the run.
        share: Factor on the lengths of its reference.
        one_left: Whether the rig has one axis and the scenario was made for two.
    """
    before, after, title = tables.get("reference"), merged.get("reference"), merged.get("title")
    if not (isinstance(before, dict) and isinstance(after, dict) and isinstance(title, str)):
        return merged
    cls: Any = schema.choices("reference").get(str(after.get("kind")))
    if cls is None:  # the check of the tables reports it
        return merged
    before = before if before.get("kind") == after["kind"] else {}

    def values_of(name: str) -> tuple[Any, Any]:
        default = getattr(cls, name, None)
        return before.get(name, default), after.get(name, default)

    lengths = {name: values_of(name) for name in cls.lengths}
    by_factor = all(_times(was, share) == _times(now, 1.0) for was, now in lengths.values())
    changed = any(_times(was, 1.0) != _times(now, 1.0) for was, now in lengths.values())
    places = [lengths[name] for name in ("x", "y") if name in lengths]
    real = title
    if one_left or not by_factor or share == 1:
        pairs = [*lengths.values()]
        if len(places) == 2:
            (x_before, x), (y_before, y) = places
            pairs.insert(0, ((x_before, y_before), (x, y)))
        real = _state_numbers(real, pairs, "m", one_left=one_left)
    if any(now for _, now in places):
        real = real.replace(" on the centre", "")
    stated = [f"lengths x {share:.3g}"] if changed and by_factor and real == title else []
    real = _state_numbers(real, [values_of("omega")], "rad/s", one_left=one_left)
    if one_left and _goes_along_y(after):
        stated.append("along x")
    return {**merged, "title": ", ".join((real, *stated))}


def _with_real_kinds(tables: Mapping[str, Any], merged: Tables) -> Tables:
    """Tables with a title that names reference and law as they run, where the kind was changed.

    Of a reference the part of the title that names one goes, with its numbers; where none does, the
    new one is named at the end. A law is named only where the old one was.
    """
    title = merged.get("title")
    if not isinstance(title, str):
        return merged
    for table in ("reference", "controller"):
        was, now = (_kind_of(each, table) for each in (tables, merged))
        if not was or not now or was == now:
            continue
        if table == "reference":
            title = _state_reference(title, now.replace("_", " "))
        else:
            named = rf"\b{re.escape(was.replace('_', ' '))}\b"
            title = re.sub(named, _law_in_words(now), title, flags=re.IGNORECASE)
    return {**merged, "title": title[:1].upper() + title[1:]}


def _kind_of(tables: Mapping[str, Any], table: str) -> str:
    """The kind of law or reference that tables name; empty if there is none of that name."""
    found = tables.get(table)
    kind = found.get("kind") if isinstance(found, Mapping) else None
    return kind if isinstance(kind, str) and kind in schema.choices(table) else ""


MAX_ACRONYM = 3
"""Letters of the names of laws that are initials, as LQR."""


def _law_in_words(kind: str) -> str:
    """A kind of law as titles have it: ``LQR``, ``sliding mode``."""
    return kind.upper() if len(kind) <= MAX_ACRONYM else kind.replace("_", " ")


def _state_reference(title: str, now: str) -> str:
    """A title with the new reference in place of the part that names one.

    Args:
        title: Parts with commas between them, as ``Sine on both axes, 150 mm at 0.5 rad/s``.
        now: The new one's name.
    """
    kinds = "|".join(each.replace("_", " ") for each in schema.choices("reference"))
    named = re.compile(rf"\b({kinds})\b", re.IGNORECASE)
    parts = re.findall(r"(?:\([^)]*\)|[^,(])+", title)
    at = next((i for i, part in enumerate(parts) if named.search(part)), None)
    if at is None:
        return f"{title}, reference {now}"
    after = at + 1
    while after < len(parts) and re.match(r" *[-(\d]", parts[after]):  # numbers of the old one
        after += 1
    return ", ".join(part.strip() for part in (*parts[:at], now, *parts[after:]))


def _state_numbers(
    title: str, pairs: Sequence[tuple[Any, Any]], unit: str, *, one_left: bool
) -> str:
    """A title with numbers of its reference as they are in place of those before.

    Args:
        title: As ``Circle of 150 mm at 0.75 rad/s`` or ``Step to (150, 150) mm``.
        pairs: A number or one along each axis, before and as it is; the first that fits is taken.
        unit: Theirs, m or rad/s; of numbers in other units none is replaced.
        one_left: Whether only the first axis is there.
    """
    known = [(_along_axes(was), _along_axes(now)) for was, now in pairs]
    known = sorted((each for each in known if all(each)), key=lambda each: each[0] == each[1])
    directions: set[str] = set()

    def rewrite(match: re.Match[str]) -> str:
        given = match[2]
        scale = 1000 if given == "mm" else 1
        stated = tuple(round(float(each) / scale, 9) for each in match[1].split(","))
        for was, now in known if ("m" if given == "mm" else given) == unit else ():
            if stated != was and (len(stated) > 1 or {*was} - {0.0} != {*stated}):
                continue
            alike = now[0] == now[1] or (0.0 in now and [*map(bool, now)] == [*map(bool, was)])
            single = one_left or (len(stated) == 1 and alike)
            numbers = (now[0] or (0.0 if one_left else now[1]),) if single else now
            if now[1] and not one_left:
                directions.add(" along x")
            if one_left or bool(now[0]) != bool(now[1]):
                directions.add(" on both axes")
            if numbers == stated:
                return match[0]
            factor, shown = (1000, "mm") if unit == "m" else (1, unit)
            text = ", ".join(f"{factor * each:.3g}" for each in numbers)
            return f"{text} {shown}" if single else f"({text}) {shown}"
        return match[0]

    number = r"-?\d+\.?\d*"
    found = re.sub(rf"\(?((?:{number}, )?{number})\)? (mm|m|rad/s)\b", rewrite, title)
    for wrong in directions if unit == "m" else ():
        found = found.replace(wrong, "")
    return found


def _along_axes(value: Any) -> tuple[float, ...]:
    """A number for each axis, rounded; empty for anything else."""
    numbers = _as_tuple(value)
    both = numbers * 2 if len(numbers) == 1 else numbers
    return tuple(round(float(each), 9) for each in both) if len(both) == 2 else ()


def _as_tuple(value: Any) -> tuple[float, ...]:
    """A number or a pair of them; empty for anything else."""
    numbers = tuple(value) if isinstance(value, list | tuple) else (value,)
    return numbers if all(isinstance(each, int | float) for each in numbers) else ()


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


def laid_over(tables: Mapping[str, Any], more: Mapping[str, Any]) -> Tables:
    """Tables with those of more tables put in, key by key.

    A new ``kind`` of controller, observer or reference drops the settings of the old, and a setting
    drops those that it replaces.
    """
    law = more.get("controller")
    given = [f"controller.{name}" for name in law] if isinstance(law, Mapping) else []
    return _without_replaced(_laid_over(tables, more), given)


def _laid_over(tables: Mapping[str, Any], more: Mapping[str, Any]) -> Tables:
    """Tables with those of more tables put in, key by key, without a look at what is replaced."""
    result = dict(tables)
    for key, value in more.items():
        old = result.get(key)
        match old, value:
            case dict(), dict() if key not in CATALOG_TABLES or value.get("kind") in {
                None,
                old.get("kind"),
            }:
                result[key] = _laid_over(old, value)
            case _:
                result[key] = value
    return result


def _replaced(tables: Mapping[str, Any], given: Collection[str]) -> dict[str, str]:
    """Settings of the law in tables that given keys replace, as gains do poles, and by which.

    A setting that is given itself stays: the check of the tables refuses the two together.
    """
    controller: Any = tables.get("controller")
    kind = controller.get("kind") if isinstance(controller, dict) else None
    law: Any = schema.choices("controller").get(kind) if isinstance(kind, str) else None
    replaces: Mapping[str, tuple[str, ...]] = getattr(law, "replaces", {})
    pairs = [(one, other) for one, others in replaces.items() for other in others]
    return {
        old: new
        for pair in pairs
        for new, old in (pair, pair[::-1])
        if f"controller.{new}" in given and f"controller.{old}" not in given and old in controller
    }


def _without_replaced(tables: Tables, given: Collection[str]) -> Tables:
    """Tables without the settings of the law that given keys replace."""
    if not (old := _replaced(tables, given)):
        return tables
    law = {name: value for name, value in tables["controller"].items() if name not in old}
    return tables | {"controller": law}


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
    old = _replaced(put(tables, kinds), [key for key, _ in settings])
    new, replaced = (
        " and ".join(f"controller.{each}" for each in dict.fromkeys(names))
        for names in (old.values(), old)
    )
    return f"{new} replaces {replaced} of {source}" if old else ""


TEXT_KEYS = ("parameters", "board.program")
"""Keys that hold names of files: a text, also where it looks like a number."""


def setting(text: str, called: str = "override") -> tuple[str, Any]:
    """Key and value of an override.

    Args:
        text: The override.
        called: What a message calls it.

    Raises:
        ScenarioError: If it is not of the form ``key=value``.
    """
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not all(key.split(".")):
        raise ScenarioError(f"{called} '{shorten(text)}': write key=value, as in duration=10")
    try:
        found = parse_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key, value
    except DataError as error:
        raise ScenarioError(f"{called} '{shorten(key)}': {error}") from None
    return key, value if key in TEXT_KEYS and not isinstance(found, str) else found


def split_settings(text: str) -> tuple[str, ...]:
    """The overrides in one text, ``key=value; key=value``."""
    return tuple(part.strip() for part in text.split(";") if part.strip())


def put(tables: Mapping[str, Any], settings: Iterable[tuple[str, Any]]) -> Tables:
    """The tables with the values of dotted keys put in.

    Naming a new ``kind`` of controller, observer or reference drops the settings of the old; the
    ball that is known stays. A setting drops those that it replaces.

    Raises:
        ScenarioError: If a key leads through a value.
    """
    result, settings = copy.deepcopy(dict(tables)), list(settings)
    for key, new in sorted(settings, key=lambda item: not item[0].endswith(".kind")):
        names = key.split(".")
        if len(names) > MAX_NESTING:
            raise ScenarioError(f"{shorten(key)}: a key has at most {MAX_NESTING} parts")
        table = result
        for depth, name in enumerate(names[:-1]):
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                path = ".".join(names[: depth + 1])
                raise ScenarioError(f"{key}: {path} is a value, not a table")
        if key in {f"{each}.kind" for each in CATALOG_TABLES} and table.get("kind") != new:
            for other in table.keys() - {"model"}:
                del table[other]
        if names == ["plant", "ball", "kind"] and table.get("kind", new) != new:
            without_ball(result["plant"], table["kind"])
        table[names[-1]] = copy.deepcopy(new)
    return _without_replaced(result, [key for key, _ in settings])


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
    for kind, cls in schema.choices(table).items() if table in CATALOG_TABLES else ():
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
