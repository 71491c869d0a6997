"""The packages that this one is made of: those installed with it, wherever it is imported.

Imported before everything else of ours, as other packages of these names may lie in the current
folder, where Python looks first.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

HOME = Path(__file__).resolve().parents[1]


def _take_twin() -> None:
    """Import ``twin`` from beside this package; it finds all others there.

    Raises:
        ImportError: If something else is called so already.
    """
    sys.path.insert(0, str(HOME))
    try:
        found = Path(str(import_module("twin").__file__)).resolve()
    finally:
        sys.path.remove(str(HOME))
    if found.parent != HOME / "twin":
        raise ImportError(f"another module called twin was imported before ballplate: {found}")


_take_twin()
