"""What the twin beside a 500 Hz rig costs: python benchmarks/shadow.py. Linux only."""

import os
import resource
import time
from pathlib import Path

import numpy as np

from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.shadow.live import beside
from twin.view.live_process import LiveProcess

SECONDS = 60.0
CHANGE = 'change=[{at=20.0, set={"plant.friction.rolling_mm"=0.234}}]'
WARM = 10.0
"""Seconds in which the process starts and loads what it needs."""


def used(pid: int) -> float:
    """Processor time in s of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def children() -> float:
    """Processor time in s of the processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def paced(settings: tuple[str, ...], twin: LiveProcess) -> np.ndarray:
    """Time in us that handing over a row took in a loop of 2 ms."""
    chosen = load("excite", (f"duration={SECONDS}", "plant.kind=lagrange", *settings))
    rig, controller = assemble(chosen)
    period = chosen.rig.period
    record = Recorder(round(SECONDS / period), 1, period, rig.channels)
    costs: list[float] = []
    begun: list[float] = []

    def timed(now: float, channels: dict[str, np.ndarray]) -> None:
        begun[:] = begun or [time.perf_counter()]
        begin = time.perf_counter_ns()
        twin.observe(now, channels)
        costs.append((time.perf_counter_ns() - begin) / 1000)
        time.sleep(max(0.0, begun[0] + now + period - time.perf_counter()))

    twin.watch(record)
    record.observers[:] = [timed]
    drive(rig, controller, SECONDS, record)
    return np.array(costs)


def main() -> None:
    """Print what it costs."""
    chosen = load("excite", (f"duration={SECONDS}", "plant.kind=lagrange"))
    for name, settings in (("healthy rig", ()), ("friction +30 % at 20 s", (CHANGE,))):
        earlier = children()
        twin = beside(chosen)
        time.sleep(WARM)
        before = used(twin._process.pid or 0)
        costs = paced(settings, twin)
        twin.finish(60)
        twin.close()
        spent = children() - earlier - before
        print(
            f"{name}: {100 * spent / SECONDS:.1f} % of one core over {SECONDS:g} s; a tick takes "
            f"longer by {np.median(costs):.1f} us (median), {np.quantile(costs, 0.99):.1f} us "
            f"(p99); dropped {twin.dropped}"
        )


if __name__ == "__main__":
    main()
