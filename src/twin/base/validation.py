"""Tables that somebody wrote as a checked model, or one line: what, where, what is allowed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeGuard, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, ValidationError

from twin.base.data_file import read_tables
from twin.base.errors import ScenarioError, nearest, plural, shorten, suggest

Model = TypeVar("Model", bound=BaseModel)
UNION_MEMBER = re.compile(r"(constrained-)?(float|int|str)|literal\[.*\]")
"""How pydantic names the members of a union behind a key."""
UNKNOWN_KEY_ERRORS = ("extra_forbidden", "unexpected_keyword_argument")
"""Error types of pydantic for an unknown key, of a model and of a dataclass."""


class Checked(BaseModel):
    """A table of a file about many runs: unknown keys and non-finite numbers are refused."""

    model_config = ConfigDict(extra="forbid", strict=False, frozen=True, allow_inf_nan=False)


def read_model(model: type[Model], path: Path, *, regular: bool = False, **given: Any) -> Model:
    """The model that a TOML file describes.

    Args:
        model: Model that it must fit.
        path: The file.
        regular: Whether it is a stranger's, as of ``read_regular``.
        given: Keys in place of the file's own; None for those that are not.

    Raises:
        ScenarioError: If it cannot be read, or anything in it is unknown or out of range.
    """
    return check_model(model, read_tables(path, regular=regular), path.name, **given)


def check_model(
    model: type[Model], tables: Mapping[str, Any], source: str, /, **given: Any
) -> Model:
    """The model that tables describe.

    Args:
        model: Model that it must fit.
        tables: Tables as read from a TOML file.
        source: What a message calls them.
        given: Keys in place of their own; None for those that are not.

    Raises:
        ScenarioError: If anything in them is unknown or out of range.
    """
    instead = {key: value for key, value in given.items() if value is not None}
    try:
        return model.model_validate({**tables, **instead})
    except ValidationError as error:
        raise ScenarioError(f"{source}: {first_finding(model, error)}") from None


@dataclass(frozen=True)
class BeyondModel:
    """What messages about tables may name that their model does not know.

    Attributes:
        keys: Dotted keys of all tables; of an unknown key those of its name, or in a table of its
            name, are suggested.
        values: Allowed values of keys that the model takes as any text, by dotted key.
        owners: Of keys that belong to other choices, what has them, by dotted key.
    """

    keys: Sequence[str] = ()
    values: Mapping[str, Sequence[str]] = field(default_factory=dict)
    owners: Mapping[str, str] = field(default_factory=dict)


NOTHING_BEYOND = BeyondModel()


def first_finding(
    model: type[BaseModel], error: ValidationError, beyond: BeyondModel = NOTHING_BEYOND
) -> str:
    """The first finding of a validation: which key, what is wrong, what is allowed.

    Args:
        model: What the tables were to be.
        error: What was found.
        beyond: What the message may name that the model does not know.
    """
    # An unknown key, as a misspelt one, explains a missing one, so it comes first.
    first = min(error.errors(), key=lambda item: item["type"] not in UNKNOWN_KEY_ERRORS)
    place = ".".join(str(part) for part in first["loc"])
    if first["type"] in UNKNOWN_KEY_ERRORS:
        return f"{place}: unknown key{_describe_known(model, first['loc'], beyond)}"
    if first["type"] == "missing":
        if isinstance(first["loc"][-1], int):  # a place in a list
            place = place.rpartition(".")[0]
            return f"{place}: must have more values than {len(first['input'])}"
        values = beyond.values.get(place) or _values_of(model, first["loc"])
        return f"{place}: missing; {_list_values(values)}"
    if first["type"] in {"too_short", "too_long"}:
        bound, has = (first["ctx"].get(key) for key in ("min_length", "actual_length"))
        least, bound = ("at least", bound) if bound else ("at most", first["ctx"]["max_length"])
        wanted = f"must have {least} {plural(bound, 'value')}, has {has}"
        return f"{place}: {'name at least one' if has < bound == 1 else wanted}"
    if first["type"] == "value_error":
        text = first["msg"].removeprefix("Value error, ")
        return text if text.startswith(place) else f"{place}: {text}"
    *key, last = first["loc"] or ("",)
    kinds = [first]
    if UNION_MEMBER.fullmatch(str(last)):  # one of a union: whatever the key may be instead
        place = ".".join(map(str, key))
        kinds = [each for each in error.errors() if [*each["loc"][:-1]] == key]
    message = " or ".join(each["msg"].removeprefix("Input should be ") for each in kinds)
    for theirs, ours in PLAIN_WORDS.items():
        message = message.replace(theirs, ours)
    given = first["input"]
    shown = shorten(json.dumps(given, default=str))
    return f"{place}: must be {message}, got {shown}{_hint(message, given, str(last))}"


PLAIN_WORDS = {
    "a valid array": "a list",
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid dictionary": "a table",
    "a valid string": "a text",
    "a valid number": "a number",
}
"""Words for pydantic's names of kinds of values."""


def _hint(message: str, given: object, key: str) -> str:
    """What to write instead of a text or table that was meant otherwise; empty if unknown."""
    if key == "set" and isinstance(given, dict) and given:
        changes = ", ".join(json.dumps(f"{k}={v}", default=str) for k, v in given.items())
        return f"; write it as {shorten(f'[{changes}]')}"
    if not isinstance(given, str):
        return ""
    if message == "a number" and re.fullmatch(r"[-+.\d]+(e[-+]?\d+)? ?[^\W\d][\w/^%]*", given):
        return "; write it without its unit, which the key has"
    if message == "a list" and given.startswith("["):
        return "; is a bracket missing?" if given.count("[") != given.count("]") else ""
    return ""


def check_named_once(what: str, names: Sequence[str], hint: str = "") -> None:
    """Make sure that no two entries of a list have one name.

    Args:
        what: The list, as the message calls it.
        names: Of its entries.
        hint: What to do about it, behind the message.

    Raises:
        ValueError: If two have.
    """
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"{what}: two of them are called '{twice}'{hint}")


def keys_of(table: type, prefix: str = "") -> Iterator[str]:
    """Every dotted key of a table and the tables in it."""
    for name, hint in hints_of(table).items():
        inner = next(filter(is_table, get_args(hint) or (hint,)), None)
        if inner is None:
            yield f"{prefix}{name}"
        else:
            yield from keys_of(inner, f"{prefix}{name}.")


def _fields(table: type, path: Sequence[str]) -> list[str]:
    """The keys of the table at a path, or of the last one on the way to it."""
    return list(hints_of(_table_at(table, path)))


def _table_at(table: type, path: Sequence[str]) -> type:
    """The table at a path, or the last one on the way to it."""
    hint: Any = table
    for name in path:
        if is_table(hint):
            table = hint
            hint = hints_of(table).get(name)
            if get_origin(hint) in (Union, UnionType):  # a table that may be left out
                hint = next(filter(is_table, get_args(hint)), hint)
        else:  # a key of a dictionary, or a place in a list
            hint = next(filter(is_table, get_args(hint)), None)
    return hint if is_table(hint) else table


def _describe_known(model: type[BaseModel], at: Sequence[Any], beyond: BeyondModel) -> str:
    """The end of a message on an unknown key: the nearest ones, or those that are known."""
    *path, name = map(str, at)
    alike = [f"'{key}'" for key in beyond.keys if key.endswith(f".{name}")]
    alike = alike or [f"'{key}'" for key in beyond.keys if f".{name}." in key]
    if alike:
        return f"; did you mean {' or '.join(alike[:4])}?"
    known = _fields(model, path)
    owner = "" if suggest(name, known) else beyond.owners.get(".".join((*path, name)), "")
    return f"{nearest(name, known)}{owner and f'; a key of {owner}'}"


def _values_of(model: type[BaseModel], place: Sequence[Any]) -> Sequence[str]:
    """The few values that a key may have; none where they are not listed in its type."""
    *path, name = map(str, place)
    hint = hints_of(_table_at(model, path)).get(name)
    return get_args(hint) if get_origin(hint) is Literal else ()


def _list_values(values: Sequence[str]) -> str:
    """The values that a missing key may have, or that it has no default."""
    if not values:
        return "it has no default"
    *others, last = [f"'{each}'" for each in values]
    return f"give {' or '.join((', '.join(others), last) if others else (last,))}"


def is_table(hint: object) -> TypeGuard[type]:
    """Whether a type is the model of a table, or a dataclass that stands for one."""
    return isinstance(hint, type) and (issubclass(hint, BaseModel) or is_dataclass(hint))


def hints_of(table: Any) -> Mapping[str, Any]:
    """The keys of a table and their types."""
    if issubclass(table, BaseModel):
        return {name: field.annotation for name, field in table.model_fields.items()}
    hints = get_type_hints(table)
    return {each.name: hints[each.name] for each in fields(table)}
