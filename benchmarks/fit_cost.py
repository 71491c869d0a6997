"""What a fit of chapter 9 costs: processor time of one sample of all its 25 experiments.

    uv run python -m benchmarks.fit_cost --samples 1 12 24

Runs share batches, and a batch costs little more for many rigs than for few: told for some numbers
of samples asked for at once. A fit asks for 24, two searches of 12, and then for some 20 to 50.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from twin.fit.runs import Runs
from twin.study.store import Store
from twin.thesis.experiments.explained import sample, stored
from twin.thesis.experiments.explanation import table


def cost(samples: int) -> float:
    """Processor seconds of one sample when so many are asked for at once, on this process.

    Args:
        samples: How many; each has another friction.
    """
    about = table()
    friction, *others = sample(stored()["all"])
    asked = [(friction * (1 + 1e-3 * k), *others) for k in range(samples)]
    with TemporaryDirectory() as folder:
        runs = Runs(about, Store(Path(folder)))
        begin = time.process_time()
        runs.indicators((each, place) for each in asked for place in range(len(about.experiments)))
        return (time.process_time() - begin) / samples


def main() -> None:
    """Print the cost, and what a fit of the stored size costs by it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, nargs="+", default=[1, 12, 24])
    options = parser.parse_args()
    each = stored()["runs"] / len(table().experiments)
    for samples in options.samples:
        seconds = cost(samples)
        print(
            f"{samples} samples at once: {seconds:.2f} s of one core each, {seconds / 2:.2f} s on "
            f"two; a fit of {each:.0f} samples {each * seconds / 120:.1f} min on two",
            flush=True,
        )


if __name__ == "__main__":
    main()
