"""Packages that an installation may be without: extras, and what ``ballplate-core`` leaves out.

The distribution ``ballplate-core`` has the same code as ``ballplate`` and requires fewer packages.
Where a module of ours imports a package that is missing, the error is one line that states its
purpose and how to install it.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from twin.base.errors import TwinError
from twin.installation import PACKAGE_NAMES

DISTRIBUTIONS = ("ballplate", "ballplate-core")
"""What this program may be installed as; the first one requires all parts."""


class Part(NamedTuple):
    """Packages that ``ballplate-core`` does not require.

    Attributes:
        purpose: What they are for.
        modules: Top-level modules that they install and that we import.
    """

    purpose: str
    modules: tuple[str, ...]


PARTS = {
    "records": Part("records of runs, logs and studies", ("pyarrow",)),
    "pictures": Part("pictures and pages", ("matplotlib", "PIL")),
    "tables": Part("tables of studies and classes, and FMUs", ("pandas",)),
    "control": Part("pole placement, margins and systems of python-control", ("control",)),
    "can": Part("drives on a CAN bus", ("can", "canopen")),
    "viewer": Part("the viewer Rerun", ("rerun", "rerun_cli")),
}
"""The parts by the extra of ``ballplate-core`` that installs them; see ``pyproject.toml``."""


class AbsentPartError(TwinError, ModuleNotFoundError):
    """A package is needed that this installation is without."""


class PartFinder:
    """Names the part of this program that is missing; Python asks it after all other finders."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Find nothing: any other program finds that a package is missing in the ordinary way.

        Raises:
            AbsentPartError: If a module of ours imports a package of a part that is missing.
        """
        for extra_name, part in PARTS.items():
            if name in part.modules and _importing_package() in PACKAGE_NAMES:
                whole = own_distribution() == DISTRIBUTIONS[0]
                how = DISTRIBUTIONS[0] if whole else f"'{DISTRIBUTIONS[-1]}[{extra_name}]'"
                line = f"needs {name}, for {part.purpose}: pip install {how}"
                raise AbsentPartError(line, name=name)
        return None


IMPORT_MODULES = ("importlib", "importlib._bootstrap", __name__)
"""Modules between the finder and the module that imports; ``importlib.util`` only searches."""


def _importing_package() -> str:
    """The top-level package of the module that imports something."""
    frame = sys._getframe(1)
    while frame.f_globals.get("__name__") in IMPORT_MODULES and frame.f_back is not None:
        frame = frame.f_back
    return str(frame.f_globals.get("__name__")).partition(".")[0]


if not any(isinstance(finder, PartFinder) for finder in sys.meta_path):
    sys.meta_path.append(PartFinder())


@contextmanager
def left_out(file: Path) -> Iterator[None]:
    """Write a file, or, if the part that writes it is missing, warn that there is none.

    One of an earlier run, which may lie there, is removed.
    """
    try:
        yield
    except AbsentPartError as error:
        file.unlink(missing_ok=True)
        warnings.warn(f"{file.name}: not written: {error}", stacklevel=3)


@contextmanager
def extra(name: str, what: str) -> Iterator[None]:
    """Import the packages of an extra; if one is missing, the error names who needs it.

    Raises:
        TwinError: If it is not installed.
    """
    try:
        yield
    except ImportError as error:
        where = f"pip install '{own_distribution()}[{name}]'"
        raise TwinError(f"{what}: needs the extra {name}: {where}") from error


def own_distribution() -> str:
    """What this program is installed as; if as both, or from a folder of sources, the first."""
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415  slow

    for name in DISTRIBUTIONS:
        with suppress(PackageNotFoundError):
            version(name)
            return name
    return DISTRIBUTIONS[0]


def own_version() -> str:
    """The version of this program, as it is installed.

    Raises:
        PackageNotFoundError: If it is not installed.
    """
    from importlib.metadata import version  # noqa: PLC0415  slow

    return version(own_distribution())
