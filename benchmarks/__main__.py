"""Measures every figure of speed that has a goal; makes docs/performance.md of what was measured.

uv run python -m benchmarks                              # measure and print
uv run python -m benchmarks --only loop                  # some of it
uv run python -m benchmarks --add                        # measure and keep; best on a quiet machine
uv run python -m benchmarks --add --earlier ../old        # and compared with commit 2a000bf6
uv run python -m benchmarks --doc docs/performance.md    # the page of all that is kept
"""

from __future__ import annotations

import argparse
import os
from itertools import chain
from pathlib import Path

from benchmarks import measurements, physics_step
from benchmarks.figures import GROUPS, Figure, beside
from twin.base.page import markdown, render_template
from twin.base.writing import write_whole

TEMPLATE = Path(__file__).parent.parent / "docs" / "performance.template.md"
ROUNDS, BESIDE_ROUNDS = 5, 3


def measured(names: list[str], old: Path | None) -> list[Figure]:
    """Figures of some groups, and against an earlier commit, each printed as it is found."""
    found = []
    groups = [GROUPS[name](ROUNDS) for name in names]
    if old is not None:
        groups.append(beside(old.resolve(), BESIDE_ROUNDS))
    for figure in chain(*groups):
        print(f"{figure.what}: {figure.found:.2f} {figure.note}", flush=True)
        found.append(figure)
    return found


def page() -> str:
    """docs/performance.md, of all measurements and of the physics as it is now."""
    known = measurements.kept()
    deviations = chain(physics_step.paths(), physics_step.numbers())
    return render_template(
        TEMPLATE,
        figures=measurements.figures_table(known),
        measurements=measurements.measurements_table(known),
        deviations=markdown(("", "at 0.25 ms", "1 ms off by", "2 ms off by"), deviations),
    )


def parser() -> argparse.ArgumentParser:
    """What may be asked."""
    made = argparse.ArgumentParser("benchmarks", description=__doc__.partition("\n")[0])
    made.add_argument("--only", action="append", choices=GROUPS, help="measure this alone")
    made.add_argument("--add", action="store_true", help="keep it in docs/data/performance.toml")
    made.add_argument("--earlier", type=Path, help="compare with this checkout of 2a000bf6")
    made.add_argument("--machine", default="", help="what to call this one there")
    made.add_argument("--doc", type=Path, help="write the page here; without --add measure nothing")
    return made


def main() -> None:
    """Measure and tell, or make the page."""
    options = parser().parse_args()
    load = os.getloadavg()[0]
    if options.add or options.doc is None:
        found = measured(options.only or list(GROUPS), options.earlier)
        measurement = measurements.now(found, load, options.machine)
        print(measurements.figures_table([measurement]))
        if options.add:
            measurements.add(measurement)
    if options.doc is not None:
        write_whole(options.doc, page().strip() + "\n")


if __name__ == "__main__":
    main()
