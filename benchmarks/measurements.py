"""The measurements of ``docs/data/performance.toml``: added to, and what they say together."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from benchmarks.figures import GOALS, Figure
from twin.base.data_file import read_toml
from twin.base.page import markdown
from twin.base.writing import write_whole

FILE = Path(__file__).parent.parent / "docs" / "data" / "performance.toml"
LIBRARIES = ("mujoco-core", "numpy", "scipy")


class Measurement(NamedTuple):
    """What was found on one machine on one day.

    Attributes:
        date: As year-month-day.
        machine: Processors and system in words.
        software: Versions in words.
        load: Of the machine when it began; NaN if it is not known.
        found: Least and most of each figure, which are the same number if it was measured once.
        notes: What else there is to say of a figure.
    """

    date: str
    machine: str
    software: str
    load: float
    found: dict[str, list[float]]
    notes: dict[str, str]


def now(found: Sequence[Figure], load: float, machine: str = "") -> Measurement:
    """A measurement of today.

    Args:
        found: Its figures.
        load: Of the machine when it began.
        machine: What to call it; by default its processors and system.
    """
    about = f"{os.cpu_count()} cores ({platform.machine()}, {platform.system()})"
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return Measurement(
        f"{datetime.now(UTC):%Y-%m-%d}",
        machine or about,
        f"Python {platform.python_version()}, {libraries}",
        round(load, 1),
        {each.what: [round(each.found, 3)] * 2 for each in found},
        {each.what: each.note for each in found if each.note},
    )


def add(measurement: Measurement, file: Path = FILE) -> None:
    """Put a measurement behind those of a file."""
    head, (found, notes) = measurement[:4], measurement[4:]
    lines = ["", "[[measured]]"]
    words = zip(Measurement._fields, head, strict=False)
    lines += [f"{key} = {json.dumps(value)}" for key, value in words]
    for name, values in (("found", found), ("notes", notes)):
        lines += ["", f"[measured.{name}]"]
        lines += [f"{json.dumps(key)} = {json.dumps(value)}" for key, value in values.items()]
    text = file.read_text(encoding="utf-8") + "\n".join(lines) + "\n"
    write_whole(file, text)


def kept(file: Path = FILE) -> list[Measurement]:
    """The measurements of a file, in their order."""
    return [Measurement(**{"notes": {}, **each}) for each in read_toml(file)["measured"]]


def figures_table(measurements: Sequence[Measurement]) -> str:
    """Every figure as Markdown: its interval over all measurements, and whether that is reached."""
    rows = []
    for what, goal in GOALS.items():
        own = [each for each in measurements if what in each.found]
        if not own:
            continue
        every = [value for each in own for value in each.found[what]]
        low, high = min(every), max(every)
        said = f"{low:.2f}" if low == high else f"{low:.2f} to {high:.2f}"
        bound, reached = (goal.words, goal.reached(low, high)) if goal else ("-", "")
        rows.append((what, said, str(len(own)), bound, reached, own[-1].notes.get(what, "")))
    heads = ("figure", "found", "measurements", "goal", "reached", "the last one")
    return markdown(heads, rows, words=(0, -2, -1))


def measurements_table(measurements: Sequence[Measurement]) -> str:
    """When and where each was made, as Markdown."""
    rows = (
        (one.date, one.machine, one.software, "?" if one.load != one.load else f"{one.load:.1f}")
        for one in measurements
    )
    return markdown(("measured", "on", "with", "load when it began"), rows, words=(0, 1, 2))
