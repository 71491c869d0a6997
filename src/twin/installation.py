"""The packages of this installation are those that lie together, whatever else has their names.

Python looks in the current folder first, and a foreign package called ``twin`` or ``controllers``
may lie there. Once ``twin`` is imported these names are ours, wherever it is imported from. It is
the first import of every program, and so imports little itself.
"""

# ruff: noqa: PTH113, PTH118, PTH120 - pathlib takes longer than all the rest

from __future__ import annotations

import sys
from importlib.util import spec_from_file_location
from os.path import dirname, isfile, join, realpath

TYPE_CHECKING = False  # without typing
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

SOURCES = dirname(dirname(realpath(__file__)))
PACKAGE_FOLDERS = (SOURCES, dirname(SOURCES))
"""Where packages of ours lie: installed, all in one folder; in a checkout this one is in src/."""
PACKAGE_NAMES = ("ballplate", "controllers", "twin")


class OwnPackages:
    """Finds our packages in the folder of this file, before ``sys.path`` is searched."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of one of our packages; None leaves the name to other finders."""
        folders = [join(home, name) for home in PACKAGE_FOLDERS] if name in PACKAGE_NAMES else []
        for folder in folders:
            if isfile(first := join(folder, "__init__.py")):
                return spec_from_file_location(name, first, submodule_search_locations=[folder])
        return None


if not any(isinstance(finder, OwnPackages) for finder in sys.meta_path):
    sys.meta_path.insert(0, OwnPackages())
