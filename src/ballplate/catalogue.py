"""What there is to run and to set."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ballplate.notebook import page, paragraphs, table
from twin.errors import ScenarioError
from twin.shipped import shipped, titles

if TYPE_CHECKING:
    from twin.scenario.describe import Key


class Keys(list["Key"]):
    """Settings with type, unit, default, range and meaning; a table in a notebook.

    Attributes:
        sentence: What the law, observer or reference is; empty for anything else.
    """

    sentence = ""

    def __str__(self) -> str:
        lines = [f"{key.key} = {key.value} {key.unit}".rstrip() for key in self]
        return "\n".join(filter(None, (self.sentence, *lines)))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        """For a notebook."""
        heads = ("key", "default", "unit", "type", "allowed", "meaning")
        lines = [
            (each.key, each.value, each.unit, each.type, each.allowed, each.meaning)
            for each in self
        ]
        return page("", paragraphs([self.sentence]), table(heads, lines))


def describe(name: str = "") -> Keys:
    """What may be set.

    Args:
        name: A key (``plant.friction.rolling_mm``) or its last part, a table
            (``plant.friction``), or a law, observer or reference (``lqr``); empty for the keys of
            every scenario.

    Raises:
        ScenarioError: If there is nothing of that name.
    """
    from twin.scenario.describe import about, described

    if not isinstance(name, str):
        raise ScenarioError(f"describe: give a key, a table or a kind as a text, got {name!r}")
    found = Keys(described(name))
    found.sentence = about(name)
    return found


def scenarios() -> dict[str, str]:
    """The shipped scenarios: name to title."""
    return titles(shipped())
