"""python-can without asammdf, which it imports with itself and needs for measurement files alone.

asammdf brings pandas, lxml and 1,200 modules. Where it is installed, `import can` takes ten times
as long for it, in each process that opens a bus, emulates one or writes its frames. While modules
of ours import python-can, asammdf is therefore not found; ``load_measurement_files`` adds it.
Imported by any other program, python-can is as it always is.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module, reload
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import FrameType, ModuleType

from twin.installation import PACKAGE_NAMES

HIDDEN = "asammdf"
ENDING = ".mf4"
"""Of measurement files."""
ASKING_MODULE = "can.io.mf4"
"""The module of python-can that imports it, and goes on without it where there is none."""
BETWEEN = ("can", "canopen", "importlib")
"""Packages between that module and who imports python-can."""


class LeanCanFinder:
    """Keeps asammdf from being found while a module of ours imports python-can."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find nothing, so that the finders after this one are asked.

        Raises:
            ModuleNotFoundError: For python-can, if one of our modules imports it.
        """
        if name == HIDDEN and _is_import_of_ours(sys._getframe(1)):
            raise ModuleNotFoundError(f"{name}: left out until it is needed", name=name)
        return None


def _is_import_of_ours(frame: FrameType | None) -> bool:
    """Whether python-can asks for it and one of our modules imports python-can."""
    asked = False
    while frame is not None:
        name = str(frame.f_globals.get("__name__"))
        asked = asked or name == ASKING_MODULE
        package = name.partition(".")[0]
        if package not in BETWEEN:
            return asked and package in PACKAGE_NAMES
        frame = frame.f_back
    return False


def load_measurement_files() -> None:
    """Let python-can read and write measurement files (.mf4), if asammdf is installed."""
    module = import_module(ASKING_MODULE)
    if getattr(module, HIDDEN) is None and find_spec(HIDDEN) is not None:
        import_module(HIDDEN)
        # its classes are the same as before and look asammdf up in this module
        reload(module)


if not any(isinstance(finder, LeanCanFinder) for finder in sys.meta_path):
    sys.meta_path.insert(0, LeanCanFinder())
