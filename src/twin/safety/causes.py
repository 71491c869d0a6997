"""What can go wrong with drives, bus and rig, as ``causes.toml`` says it."""

from __future__ import annotations

from typing import Any, NamedTuple

from twin.data_file import packaged
from twin.emulator.can_bus import Towards
from twin.emulator.drive import Power
from twin.emulator.screen import Protocol

NAMES = {each.name: each for kind in (Power, Protocol, Towards) for each in kind}
"""What a text in a step names."""


class Cause(NamedTuple):
    """Something that can go wrong; called with what it goes wrong with, it does.

    Attributes:
        name: What rows call it.
        words: What it is, in words.
        steps: How it comes about: each a way, and what is given there.
    """

    name: str
    words: str
    steps: tuple[tuple[Any, ...], ...]

    def __call__(self, target: Any) -> None:
        """Make it go wrong with two drives and their bus, or with a rig."""
        for way, *given in self.steps:
            *through, last = way.split(".")
            place = target
            for part in through:
                place = place[int(part)] if part.isdigit() else getattr(place, part)
            if callable(there := getattr(place, last)):
                more = given.pop() if given and isinstance(given[-1], dict) else {}
                there(*given, **more)
            else:
                setattr(place, last, *given)


def _meant(value: Any) -> Any:
    """What a value in a step stands for."""
    if isinstance(value, list):
        return tuple(map(_meant, value))
    if isinstance(value, dict):
        return {key: _meant(each) for key, each in value.items()}
    return NAMES.get(value, value.encode()) if isinstance(value, str) else value


def _causes(table: dict[str, Any]) -> dict[str, Cause]:
    return {
        name: Cause(name, words, tuple((way, *map(_meant, given)) for way, *given in steps))
        for name, (words, *steps) in table.items()
    }


_TABLES = packaged("twin.safety", "causes.toml")
OF_DRIVES = _causes(_TABLES["drives"])
"""What can go wrong with two drives and their bus, `LockstepDrives`."""
OF_RIG = _causes(_TABLES["rig"])
"""What can go wrong with a rig, `LockstepRig`."""
