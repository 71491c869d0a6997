"""The title of a scenario, with reference, numbers and law as they run after changes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twin.scenario import schema
from twin.scenario.merging import Tables, scale_lengths


def restate_numbers(
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
    by_factor = all(
        scale_lengths(was, share) == scale_lengths(now, 1.0) for was, now in lengths.values()
    )
    changed = any(
        scale_lengths(was, 1.0) != scale_lengths(now, 1.0) for was, now in lengths.values()
    )
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


def restate_kinds(tables: Mapping[str, Any], merged: Tables) -> Tables:
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
        if ("m" if given == "mm" else given) != unit:
            return match[0]
        for was, now in known:
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
    if unit == "m":
        for wrong in directions:
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
