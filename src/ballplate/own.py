"""The packages that this one is made of: those installed with it, wherever it is imported.

Imported before everything else of ours, as other packages of these names may lie in the current
folder, where Python looks first.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

SOURCE_FOLDER = Path(__file__).resolve().parents[1]


def _take_twin() -> None:
    """Import ``twin`` from the folder of this package; it finds all others there.

    Raises:
        ImportError: If something else is called so already.
    """
    sys.path.insert(0, str(SOURCE_FOLDER))
    try:
        found = Path(str(import_module("twin").__file__)).resolve()
    finally:
        sys.path.remove(str(SOURCE_FOLDER))
    if found.parent != SOURCE_FOLDER / "twin":
        raise ImportError(f"a different module called twin was imported before ballplate: {found}")


_take_twin()
