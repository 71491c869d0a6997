"""Parts of a tick of some rigs in a batch, next to what single calls of numpy take.

    uv run python -m benchmarks.tick
    uv run python -m benchmarks.tick --rigs 128 --set plant.kind=lagrange --set ...

Of each part the tenth percentile by the clock, so that other work of the machine counts little:
what is left of a goal when the engine's steps and the calls of numpy are taken away.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import click
import numpy as np

from twin.base.page import markdown
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load

SECONDS = 2.0
PERCENTILE = 10


class Stopwatch:
    """Times of named calls, in s."""

    def __init__(self) -> None:
        self.times = defaultdict[str, list[float]](list)

    def watch(self, owner: Any, method: str, name: str) -> None:
        """Take the time of every call of a method of an object from now on."""
        original, times = getattr(owner, method), self.times[name]

        def timed(*given: Any) -> Any:
            begin = time.perf_counter()
            result = original(*given)
            times.append(time.perf_counter() - begin)
            return result

        setattr(owner, method, timed)


def parts(rigs: int, settings: tuple[str, ...]) -> dict[str, float]:
    """What each part of a tick takes, in us."""
    fixed = (f"duration={SECONDS}", "metrics.start=0", "baseline=false", *settings)
    batch = [load("circle", [*fixed, f"seed={seed}"]) for seed in range(rigs)]
    rig, controller = assemble(batch, threads=1, unseen=True, as_alone=False)
    watch = Stopwatch()
    for owner, method, name in (
        (controller, "command", "controller: command"),
        (controller.observer, "correct", "of that the observer"),
        (controller, "applied", "controller: prediction"),
        (rig, "write", "rig: write"),
        (rig, "read", "rig: read"),
        (rig, "wait", "rig: plant"),
        (rig.devices.plant, "advance", "of that advance"),
    ):
        watch.watch(owner, method, name)
    engine = getattr(rig.devices.plant, "_batch", None)
    if engine is not None:
        watch.watch(engine.__class__, "step", "of that the engine's step")
    ticks = round(SECONDS / batch[0].rig.period)
    drive(rig, controller, SECONDS, Recorder(ticks, rigs, batch[0].rig.period, keep=("state",)))
    return {name: percentile_us(each) for name, each in watch.times.items()}


def percentile_us(times: list[float]) -> float:
    """The percentile of times in s, in us."""
    return 1e6 * float(np.percentile(times, PERCENTILE))


def calls(rigs: int) -> dict[str, float]:
    """What single calls of numpy with two numbers of each rig take, in us."""
    a, wide = np.ones((rigs, 2)), np.ones((rigs, 8))
    matrix, pair = np.ones((8, 8)), np.ones(2)
    jobs: dict[str, Callable[[], object]] = {
        "product of arrays of one piece and shape": lambda: a * a,
        "product with one that is repeated": lambda: a * pair,
        "product with every fourth number": lambda: a * wide[:, 0::4],
        "product of each row with a matrix": lambda: wide[:, None] @ matrix,
        "slice": lambda: wide[:, 0::4],
    }
    found = {}
    for name, job in jobs.items():
        times = []
        for _ in range(2000):
            begin = time.perf_counter()
            for _ in range(10):
                job()
            times.append((time.perf_counter() - begin) / 10)
        found[name] = percentile_us(times)
    return found


@click.command()
@click.option("--rigs", default=16, help="Number of rigs.")
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="Of the scenario.")
def main(rigs: int, settings: tuple[str, ...]) -> None:
    """Print what the parts of a tick take, and what calls of numpy do."""
    found = {**parts(rigs, settings), **calls(rigs)}
    rows = [(name, f"{microseconds:.1f} us") for name, microseconds in found.items()]
    click.echo(markdown((f"{rigs} rigs", "time"), rows, words=(0,)))


if __name__ == "__main__":
    main()
