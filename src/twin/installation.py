"""Whether the packages beside this one are those that were installed with it."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path


def problem() -> str | None:
    """One line if another package hides ``controllers`` or lies over ``scenarios``, else None.

    Both are found by a general name: whatever of that name comes first on ``sys.path`` is taken.
    """
    twin = Path(__file__).resolve().parent
    # Installed, all lie in one folder; in a checkout this one is in src/.
    homes = (twin.parent, twin.parents[1])
    spec = find_spec("controllers")
    if spec is None or spec.origin is None:
        return f"the package controllers is missing beside {twin}: install ballplate again"
    package = Path(spec.origin).resolve().parent
    if package.parent not in homes:
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
