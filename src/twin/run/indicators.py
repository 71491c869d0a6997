"""Indicators of runs by name: their units and words, and the nearest to an unknown name."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

from twin.base.data_file import read_toml
from twin.base.errors import nearest

INDICATORS: dict[str, dict[str, str]] = read_toml(Path(__file__).with_name("indicators.toml"))
"""Every indicator with ``unit``, ``words`` and the unit it is ``printed`` with."""
INDICATOR_UNITS = {name: about["unit"] for name, about in INDICATORS.items() if "unit" in about}
"""Unit of every indicator as JSON has it."""
BOARD_INDICATORS = ("command_difference", "instructions_median", "instructions_max")
"""Those that a run has only if its controller is a program."""
MOTION_INDICATORS = tuple(
    name
    for name in INDICATORS
    if name not in {"outcome", "outcome_time", "judged_from", "real_time_factor", *BOARD_INDICATORS}
)
"""Indicators that evaluate a motion."""


def nearest_indicator(name: object, known: Iterable[str] = MOTION_INDICATORS) -> str:
    """The end of a message about an unknown indicator: the one that is meant, and those known.

    Args:
        name: As it was given; also a word that a table prints for an indicator, as ``e_tt``.
        known: Names of those that there are.
    """
    names = list(known)
    word = str(name).casefold()
    called = {each: INDICATORS.get(each, {}).get("words", "").casefold().split() for each in names}
    meant = [each for each, words in called.items() if word in words]
    return nearest(meant[0] if len(meant) == 1 else name, names)


class Indicators(dict[str, Any]):
    """Indicators of a run by name; one that it lacks is a ``KeyError`` with the nearest name."""

    def __missing__(self, name: object) -> NoReturn:
        raise KeyError(f"no indicator '{name}'{nearest_indicator(name, self)}")


LOST_ENDINGS = ("fell", "lost", "diverged")
"""Endings after which no error is shown: a lost ball has none."""
