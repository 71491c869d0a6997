"""Where the mechanism's files are: beside the installed package, or in the checkout."""

from __future__ import annotations

from pathlib import Path


def model_path(name: str = "ballplate.xml") -> Path:
    """Path of a file of ``models/``, installed (twin/models) or in the repository.

    The file itself need not exist; whoever opens it says so in its own words.
    """
    package = Path(__file__).resolve().parent
    installed = package / "models" / name
    return installed if installed.exists() else package.parents[1] / "models" / name
