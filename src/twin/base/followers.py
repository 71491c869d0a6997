"""Followers of the settings of a rig: one entry by every setting, from which all lists derive.

An entry names each part of the project that acts on settings, and for each how it follows or why it
leaves the setting out. Parameters of an FMU, effects of ``explain``, symbols, what a scenario
refuses and the page of settings are derived from the entries.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any


class Follows(Enum):
    """How a part follows a setting."""

    GIVEN = "given"
    """It has the scenario's value."""
    FREE = "free"
    """The value stays open: a parameter of the FMU, an entry of p, a number that is fitted."""


GIVEN, FREE = Follows.GIVEN, Follows.FREE


class Off(Enum):
    """Ways to switch an effect off that are no value of its setting."""

    DEFAULT = "default"
    """The default of the setting."""
    SHAPE = "shape"
    """Nothing: the setting shapes an effect that some other setting switches."""


DEFAULT, SHAPE = Off.DEFAULT, Off.SHAPE


@dataclass(frozen=True)
class Effect:
    """The effect of ``explain`` to which a setting belongs.

    Attributes:
        name: Its name in ``twin/whatif/effects.toml``.
        off: Value in the key's unit that switches it off, None to take the key out; or ``DEFAULT``
            or ``SHAPE``.
    """

    name: str
    off: Any = DEFAULT


@dataclass(frozen=True, kw_only=True)
class Followers:
    """The parts that follow a setting; a text is why a part leaves it out, and follows its subject.

    Attributes:
        mechanism: The mechanism in MuJoCo with what surrounds it, "the mechanism ...".
        equations: The exact equations with what surrounds them, "the exact equations ...".
        source: The C source of an FMU, "the C source ...".
        identify: What is fitted to a log of this kind of rig, "identify ...".
        symbols: ``ballplate.symbolic``, "the symbols ...".
        explain: The effects that ``explain`` switches, "explain ..."; empty only where several
            settings share what else is stated.
        rods: Why a mechanism on rods leaves out what the one on cams follows; empty if it does not.
    """

    mechanism: Follows | str
    equations: Follows | str
    source: Follows | str
    identify: Follows | str
    symbols: Follows | str
    explain: Effect | str = ""
    rods: str = ""

    def by(self, effect: str, off: Any = DEFAULT) -> Followers:
        """The same for a setting of an effect of ``explain``; ``off`` switches it off."""
        return replace(self, explain=Effect(effect, off))

    @property
    def unstated(self) -> tuple[str, ...]:
        """Parts of which nothing is stated."""
        return tuple(part for part in FOLLOWER_LABELS if not getattr(self, part))

    def lacking(self, part: str) -> str:
        """Why a part leaves the setting out; empty if it follows."""
        how = getattr(self, part)
        return how if isinstance(how, str) else ""


FOLLOWER_LABELS: dict[str, str] = {
    "mechanism": "the mechanism",
    "equations": "the exact equations",
    "source": "the C source of an FMU",
    "explain": "explain",
    "identify": "identify",
    "symbols": "the symbols",
}
"""Name of each part in a sentence about settings that it leaves out."""
