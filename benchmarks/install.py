"""What an installation costs: megabytes on disk and seconds, plain and with each extra.

Run with ``uv run python -m benchmarks.install``. The wheel is built, and installed into a fresh
environment by ``uv pip install`` with the pinned versions: once with nothing kept from before, so
that everything is fetched, and once from what uv keeps. Sizes are of the files installed.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from twin.markdown import table

ROOT = Path(__file__).parents[1]
HEADINGS = ("installed", "MB on disk", "more than plain", "packages", "s, all fetched", "s, kept")


class Cost(NamedTuple):
    """What an installation costs."""

    megabytes: float
    packages: int
    fetched: float
    kept: float


def uv(*arguments: object) -> float:
    """Seconds that uv takes for a command."""
    program = os.environ.get("UV") or shutil.which("uv")
    if program is None:
        raise SystemExit("uv is not found: pip install uv")
    begin = time.perf_counter()
    subprocess.run([program, *map(str, arguments)], check=True, capture_output=True)
    return time.perf_counter() - begin


def installed(wheel: Path, extra: str, pins: Path, folder: Path) -> Cost:
    """The cost of a wheel with an extra in a fresh environment; without one for ''."""
    wanted = f"{wheel}[{extra}]" if extra else str(wheel)
    taken = {}
    for how in ("--no-cache", "--offline"):
        environment = folder / f"environment{how}"
        uv("venv", "--python", sys.executable, environment)
        target = ("--python", environment, "--constraint", pins)
        if how == "--offline":
            # everything there may be to keep is kept before
            uv("pip", "install", *target, wanted)
            shutil.rmtree(environment)
            uv("venv", "--python", sys.executable, environment)
        taken[how] = uv("pip", "install", how, *target, wanted)
    (packages,) = environment.glob("lib/python*/site-packages")
    size = sum(path.lstat().st_size for path in packages.rglob("*")) / 1e6
    count = len(list(packages.glob("*.dist-info")))
    return Cost(size, count, taken["--no-cache"], taken["--offline"])


def costs() -> Iterator[tuple[str, Cost]]:
    """What is installed, plain first, and its cost."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        pins = folder / "pins.txt"
        pins.write_text("\n".join(project["tool"]["uv"]["constraint-dependencies"]), "utf-8")
        uv("build", "--wheel", "--out-dir", folder, ROOT)
        (wheel,) = folder.glob("*.whl")
        for extra in ("", *sorted(project["project"]["optional-dependencies"])):
            with TemporaryDirectory(dir=folder) as own:
                yield extra, installed(wheel, extra, pins, Path(own))


def main() -> None:
    """Print the table."""
    rows, plain = [], 0.0
    for extra, cost in costs():
        plain = plain or cost.megabytes
        rows.append(
            (
                f"`ballplate[{extra}]`" if extra else "`ballplate`",
                f"{cost.megabytes:.0f}",
                f"{cost.megabytes - plain:.0f}" if extra else "",
                str(cost.packages),
                f"{cost.fetched:.0f}",
                f"{cost.kept:.1f}",
            )
        )
    print(table(HEADINGS, rows, words=(0,)))


if __name__ == "__main__":
    main()
