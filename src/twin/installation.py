"""The packages of this installation are those that lie together, whatever else has their names.

Python looks in the current folder first, and another package called ``twin`` or ``controllers`` may
lie there. Once ``twin`` is imported these names are ours, wherever it is imported from.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

TWIN = Path(__file__).resolve().parent
HOMES = (TWIN.parent, TWIN.parents[1])
"""Where packages of ours lie: installed, all in one folder; in a checkout this one is in src/."""
NAMES = ("ballplate", "controllers", "twin")


def _package(name: str) -> Path | None:
    """The folder of one of our packages."""
    places = (home / name for home in HOMES)
    return next((place for place in places if (place / "__init__.py").is_file()), None)


class OwnPackages(MetaPathFinder):
    """Finds our packages beside this file, before ``sys.path`` is asked."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """That of one of our packages; None leaves the name to others."""
        folder = _package(name) if name in NAMES else None
        if folder is None:
            return None
        return spec_from_file_location(
            name, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )


if not any(isinstance(finder, OwnPackages) for finder in sys.meta_path):
    sys.meta_path.insert(0, OwnPackages())
