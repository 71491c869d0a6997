"""Describes every key that may be set, with its type, unit, range, default and meaning.

Types, ranges and defaults come from the models that check a scenario, meanings from the docstrings
of the dataclasses and models with the fields that the keys set; nothing is written a second time.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import chain
from types import ModuleType
from typing import Any, get_args, get_origin

from docstring_parser import Docstring, DocstringParam, parse, parse_from_object
from docstring_parser.attrdoc import AttributeDocstrings
from pydantic import BaseModel

from twin.base.errors import ScenarioError, shorten, suggest
from twin.base.settings import Setting, Unit, settings_of
from twin.base.validation import is_table
from twin.scenario.load import not_run
from twin.scenario.rig_tables import Section
from twin.scenario.schema import CATALOG_TABLES, Choice, Scenario, choices, settings_model

TYPE_WORDS = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "boolean": "true or false",
}
PRINTED_UNITS = {
    Unit.MM: ("m", "mm"),
    Unit.UM: ("m", "um"),
    Unit.DEG: ("rad", "deg"),
    Unit.PERCENT: ("dimensionless", "%"),
}
"""What a key's unit is called, and the SI unit in the field's docstring that it stands for."""
UNIT_PATTERN = re.compile(
    r"(?:,| in) (?P<unit>\(rad/s\^2\)\^2(?: s)?|m\^2 s and rad\^2 s|kg m\^2|kg|N/m|N m|N|"
    r"1/s\^2|1/s|Hz|%|mm per m/s|mm|um|m/s\^2|m/s|m s|m\^2|m|rad/s\^2|rad/s|rad\^2|rad|"
    r"deg/s\^2|deg/s|deg|s)(?=[\s.,;:]|$)"
)
"""The unit in a sentence, after a comma or the word in."""
BOUND_SIGNS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
"""Bounds of a range as JSON schema calls them, and in signs."""
FOREIGN_PACKAGES = ("abc", "builtins", "pydantic", "typing")
"""Packages that define classes without settings."""


@dataclass(frozen=True, kw_only=True)
class Key:
    """One key of a scenario.

    Attributes:
        key: Dotted name, as on the command line after ``--set``.
        type: What its value is, in words.
        unit: Its unit; empty where it has none.
        default: Its value where a scenario gives none; None for none.
        required: Whether every scenario must give it.
        allowed: Range or choices in words; empty for any.
        meaning: The meaning of the key, in a sentence.
        plants: The plant that alone has it; empty for all.
        kind: The law, observer or reference that has it; empty for a key of every scenario.
    """

    key: str
    type: str
    unit: str
    default: Any
    required: bool
    allowed: str
    meaning: str
    plants: str = ""
    kind: str = ""

    @property
    def value(self) -> str:
        """Its default as a scenario would say it, ``required``, or ``none``."""
        if self.required or self.default is None:
            return "required" if self.required else "none"
        return json.dumps(self.default, ensure_ascii=False)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def find_keys(name: str = "") -> list[Key]:
    """The keys that a name stands for.

    Args:
        name: A key, a table (``plant.friction``), the last part of a key (``rolling_mm``), or a
            law, observer or reference with or without its table (``lqr``, ``reference.path``).
            Empty for the keys of every scenario.

    Raises:
        ScenarioError: If there is nothing of that name.
    """
    general = list(keys(Scenario))
    if not name:
        return general
    kinds = every_kind()
    every = [*general, *chain.from_iterable(kinds.values())]
    word = re.compile(rf"\b{re.escape(name)}", re.IGNORECASE)
    full, _, leaf = name.rpartition(".")
    called = {kind for kind in kinds if name in (kind, *kind.split("."))}
    found = [key for key in general if f"{key.key}.".startswith(f"{name}.")]
    found += chain.from_iterable(kinds[kind] for kind in kinds if kind in called)
    if not (found or called):
        found = [key for key in every if f".{key.key}".endswith(f".{name}")]
        # one setting of a kind, as reference.path.points
        found += [key for key in kinds.get(full, ()) if key.key.endswith(f".{leaf}")]
        # a table within a table, as servo; then a word of a meaning, as vibration
        found = found or [key for key in every if name in key.key.split(".")]
        found = found or [key for key in every if len(name) > 2 and word.search(key.meaning)]
        # a word of a name, as dither
        found = found or [key for key in every if name in re.split(r"[._]", key.key)]
    if not (found or called):
        names = {key.key for key in every} | {part for key in every for part in key.key.split(".")}
        names |= kinds.keys() | {kind.partition(".")[2] for kind in kinds}
        hint = suggest(name, sorted(names)) or ";"
        raise ScenarioError(
            f"nothing called '{shorten(name)}'{hint} `ballplate describe` lists every key"
            + not_run()
        )
    return found


def every_kind() -> dict[str, list[Key]]:
    """The settings of every law, observer and reference, by table and name."""
    return {
        f"{table}.{kind}": list(_settings(table, kind))
        for table in CATALOG_TABLES
        for kind in choices(table)
    }


def about(kind: str) -> str:
    """The first sentence about a law, observer or reference; empty for anything else."""
    for table in CATALOG_TABLES:
        cls = choices(table).get(kind.rpartition(".")[2])
        if cls is not None:
            text = str(_docstring(cls).short_description or "")
            is_default = text.startswith(f"{cls.__name__}(")  # the docstring of a dataclass
            return "" if is_default else text
    return ""


def keys(model: type[BaseModel], prefix: str = "") -> Iterator[Key]:
    """Every key of a table and the tables in it."""
    properties = _properties(model)
    sources = model.sources if issubclass(model, Section) else {}
    for name, field in model.model_fields.items():
        inner = _table(field.annotation)
        if name == "kind" and issubclass(model, Choice):
            table = prefix.rstrip(".")
            meaning = f"The {table}; its own settings stand next to it."
            kind = _key(f"{table}.kind", properties[name], meaning)
            yield replace(kind, allowed=", ".join(choices(table)))
        elif inner is not None:
            yield from keys(inner, f"{prefix}{name}.")
        else:
            source, attribute = sources.get(name, (model, name))
            yield _key(
                f"{prefix}{name}",
                properties[name],
                meanings(source).get(attribute, ""),
                settings_of(source)[attribute] if name in sources else None,
            )


def _settings(table: str, kind: str) -> Iterator[Key]:
    """The settings of a law, observer or reference."""
    cls = choices(table)[kind]
    texts = meanings(cls)
    for name, schema in _properties(settings_model(cls)).items():
        yield replace(_key(f"{table}.{name}", schema, texts.get(name, "")), kind=kind)


def _key(key: str, schema: Mapping[str, Any], meaning: str, about: Setting | None = None) -> Key:
    """A key from its part of the JSON schema, its meaning, and the setting it is, if it is one."""
    if about is not None and about.unit in PRINTED_UNITS:
        was, own = PRINTED_UNITS[about.unit]
        meaning = re.sub(rf"((?:,| in) ){was}\b", rf"\g<1>{own}", meaning)
    unit = UNIT_PATTERN.search(meaning)
    return Key(
        key=key,
        type=_type(schema),
        unit=unit["unit"] if unit else "",
        default=schema.get("default"),
        required="default" not in schema,
        allowed=_range(schema),
        meaning=meaning,
        plants="mujoco" if about is not None and about.followed_by.lacking("equations") else "",
    )


def _type(schema: Mapping[str, Any]) -> str:
    """The type of a value in words."""
    if "anyOf" in schema:
        parts = [_type(part) for part in schema["anyOf"] if part.get("type") != "null"]
        return " or ".join(dict.fromkeys(parts))
    if schema.get("type") == "array":
        inner = schema.get("items") or schema.get("prefixItems", [{}])[0]
        number = f"{schema['minItems']} " if "minItems" in schema else ""
        several = re.sub(r"\b(number|text|list|table)\b", r"\1s", _type(inner))
        return f"list of {number}{several}"
    return "table" if "$ref" in schema else TYPE_WORDS.get(str(schema.get("type")), "value")


def _range(schema: Mapping[str, Any]) -> str:
    """The range or the choices of a value in words."""
    for part in schema.get("anyOf", ()):
        if inner := _range(part):
            return inner
    if schema.get("type") == "array":
        return _range(schema.get("items") or schema.get("prefixItems", [{}])[0])
    if "enum" in schema:
        return ", ".join(map(str, schema["enum"]))
    if "const" in schema:
        return str(schema["const"])
    return ", ".join(
        f"{sign} {schema[key]:g}" for key, sign in BOUND_SIGNS.items() if key in schema
    )


def _table(annotation: object) -> type[BaseModel] | None:
    """The model of a table, of one that may be left out too; None for a value or a list."""
    parts = () if get_origin(annotation) is tuple else (annotation, *get_args(annotation))
    return next(filter(is_table, parts), None)


@cache
def _properties(model: type[BaseModel]) -> dict[str, Any]:
    """The JSON schema of every field of a model, by its name."""
    return model.model_json_schema()["properties"]


@cache
def _docstring(cls: type) -> Docstring:
    """The docstring of a class and those below its attributes, parsed once."""
    node = _class_nodes(sys.modules[cls.__module__]).get(cls.__qualname__)
    if node is None:
        return parse_from_object(cls)
    reader = AttributeDocstrings()
    reader.attr_docs, reader.prev_attr = {}, None
    reader.visit(node)  # type: ignore[no-untyped-call]
    found = parse(cls.__doc__ or "")
    known = {item.arg_name for item in found.params}
    for name, (text, of_type, default) in reader.attr_docs.items():
        if name not in known:
            parts = ["attribute", name], text, name, of_type, default is not None, default
            found.meta.append(DocstringParam(*parts))
    return found


@cache
def _class_nodes(module: ModuleType) -> dict[str, ast.ClassDef]:
    """The classes of a module in its source, parsed once; ``inspect`` parses it for each class."""
    try:
        source = inspect.getsource(module)
    except (OSError, TypeError):  # typed at a prompt or in a notebook
        return {}
    return {node.name: node for node in ast.parse(source).body if isinstance(node, ast.ClassDef)}


@cache
def meanings(cls: type) -> dict[str, str]:
    """Meaning of the fields of a dataclass or model, by their names."""
    return {
        item.args[1]: " ".join((item.description or "").split())
        for source in reversed(cls.__mro__)
        if source.__module__.partition(".")[0] not in FOREIGN_PACKAGES
        for item in _docstring(source).params
    }
