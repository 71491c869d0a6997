"""Processor time of drawing a run's picture, matplotlib already imported.

Run with ``uv run python -m benchmarks.drawing``. The shipped circle of 25 s and its baseline, as
``run circle`` draws them, several times in one process; the least counts.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from twin.run.execute import run
from twin.run.overview_plot import draw
from twin.scenario import load


def seconds(rounds: int = 5) -> float:
    """Processor seconds of one picture."""
    circle = load("circle", ["plant.kind=lagrange"])
    motions = {"one": run(circle).motion, "other": run(load("circle")).motion}
    times = []
    with TemporaryDirectory() as folder:
        for _ in range(rounds):
            begin = time.process_time()
            draw(Path(folder) / "picture.png", motions, circle.title, (0.25, 0.15))
            times.append(time.process_time() - begin)
    return min(times)


def main() -> None:
    """Print it."""
    print(f"{seconds():.2f} s")


if __name__ == "__main__":
    main()
