"""The packages of this installation are those that lie together, whatever else has their names.

Python looks in the current folder first, and another package called ``twin`` or ``controllers`` may
lie there. Once ``twin`` is imported these names are ours, wherever it is imported from.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec, spec_from_file_location
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


def problem() -> str | None:
    """One line if another package hides ``controllers`` or lies over ``scenarios``, else None.

    Both are found by a general name: whatever of that name comes first on ``sys.path`` is taken.
    """
    spec = find_spec("controllers")
    if spec is None or spec.origin is None:
        return f"the package controllers is missing beside {TWIN}: install ballplate again"
    package = Path(spec.origin).resolve().parent
    if package.parent not in HOMES:
        return (
            f"another package called controllers shadows ours: {package}; rename it, or take its "
            "folder off PYTHONPATH"
        )
    scenarios = package.parent / "scenarios"
    if not scenarios.is_dir():
        return f"the folder {scenarios} is missing: install ballplate again"
    if (scenarios / "__init__.py").exists():
        return (
            f"another package called scenarios lies over ours: {scenarios}; use an environment of "
            "its own for ballplate"
        )
    return None


if not any(isinstance(finder, OwnPackages) for finder in sys.meta_path):
    sys.meta_path.insert(0, OwnPackages())
