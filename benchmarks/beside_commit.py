"""Processor time of a batch of rigs, beside that of an earlier commit checked out next to it.

    git worktree add ../old COMMIT && (cd ../old && uv sync)
    uv run python -m benchmarks.beside_commit ../old
    uv run python -m benchmarks.beside_commit ../old --rigs 128 --rigs 16

Both take turns, each in a process of its own with its own environment and one thread of OpenBLAS;
the least of all rounds counts. Either simulates what its own scenario of that name says.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import click

from twin.base.page import markdown

CASES = {
    "cure, exact equations": ("cure", "plant.kind=lagrange"),
    "cure, mechanism": ("cure", "plant.kind=mujoco"),
    "stable_inversion, friction_kalman, exact equations": (
        *("cure", "plant.kind=lagrange", "observer.kind=friction_kalman"),
    ),
    "afl, luenberger, exact equations": ("circle", "controller.kind=afl", "plant.kind=lagrange"),
}
"""Scenario and settings of each row."""
PERIOD_S = 0.002
SIMULATED = """
import sys, time
from twin.run.loop import simulate
from twin.scenario import load
name, rigs, *settings = sys.argv[1:]
batch = [load(name, [*settings, f"seed={seed}"]) for seed in range(int(rigs))]
begin = time.process_time()
simulate(batch)
print(time.process_time() - begin)
"""
"""Read by the Python of either checkout, old ones too."""
SWEPT = """
import sys, time
import ballplate
name, rigs, *settings = sys.argv[1:]
ballplate.sweep(name, {"seed": [0]}, settings=settings, processes=1)
begin = time.process_time()
ballplate.sweep(name, {"seed": [*range(int(rigs))]}, settings=settings, processes=1)
print(time.process_time() - begin)
"""
"""The same as a sweep over seeds, on one process."""
SWEEPS = {"sweep, afl, mechanism": ("circle", "plant.kind=mujoco")}
"""Scenario and settings of each sweep."""


def spent(
    checkout: Path, rigs: int, seconds: float, case: tuple[str, ...], program: str = SIMULATED
) -> float:
    """Processor time in us of a rig and control period, of so many rigs under a program."""
    fixed = (f"duration={seconds}", f"metrics.start={seconds / 2}", "baseline=false")
    python = checkout / ".venv" / "bin" / "python"
    done = subprocess.run(
        (python, "-c", program, case[0], str(rigs), *case[1:], *fixed),
        cwd=checkout,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        check=True,
        text=True,
    )
    return 1e6 * float(done.stdout) * PERIOD_S / (rigs * seconds)


def table(old: Path, rigs: int, seconds: float, rounds: int) -> str:
    """What either needs in every case, and the ratio, as Markdown."""
    here, rows = Path(sys.prefix).parent, []
    cases = [(*each, SIMULATED) for each in CASES.items()]
    cases += [(*each, SWEPT) for each in SWEEPS.items()]
    for name, case, program in cases:
        turns = [
            [spent(each, rigs, seconds, case, program) for each in (old, here)]
            for _ in range(rounds)
        ]
        before, now = map(min, zip(*turns, strict=True))
        rows.append((f"{rigs} rigs, {name}", f"{before:.1f}", f"{now:.1f}", f"{now / before:.2f}"))
    return markdown(("batch", "earlier commit [us]", "here [us]", "ratio"), rows)


@click.command()
@click.argument("old", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--rigs", type=int, multiple=True, default=(128,), help="Rigs in a batch.")
@click.option("--seconds", type=float, default=3.0, help="Simulated time.")
@click.option("--rounds", type=int, default=3, help="Turns of either.")
def main(old: Path, rigs: tuple[int, ...], seconds: float, rounds: int) -> None:
    """Print what a rig and period costs at the checkout OLD and here."""
    for each in rigs:
        click.echo(table(old.resolve(), each, seconds, rounds) + "\n")


if __name__ == "__main__":
    main()
