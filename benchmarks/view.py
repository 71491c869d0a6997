"""What watching a run costs it: python benchmarks/view.py."""

import os
import resource
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from twin.errors import ViewError
from twin.run.assemble import assemble
from twin.run.execute import run, save
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.run.replay import open_run
from twin.scenario import load
from twin.view import live, viewer
from twin.view.live_process import LiveProcess
from twin.view.recording import write
from twin.view.terminal import work

SECONDS = 8.0
ROUNDS = 3


def one_run(tap=None):
    """Wall and processor time in s of the loop of one simulated run, watched or not."""
    chosen = load("circle", (f"duration={SECONDS}", "metrics.start=0"))
    rig, controller = assemble(chosen)
    record = Recorder(round(SECONDS / chosen.rig.period), 1, chosen.rig.period, rig.channels)
    if tap is not None:
        tap.watch(record)
    begin, used = time.perf_counter(), time.thread_time()
    drive(rig, controller, SECONDS, record)
    return time.perf_counter() - begin, time.thread_time() - used


def tick_costs(tap):
    """Time in us that each observed tick takes longer, in a loop paced at 2 ms."""
    chosen = load("circle", ("duration=2", "metrics.start=0"))
    rig, controller = assemble(chosen)
    record = Recorder(1000, 1, chosen.rig.period, rig.channels)
    costs = []

    def timed(now, channels):
        begin = time.perf_counter_ns()
        tap.observe(now, channels)
        costs.append((time.perf_counter_ns() - begin) / 1000)
        time.sleep(0.0015)

    tap._plant = record.plant
    record.observers.append(timed)
    drive(rig, controller, 2.0, record)
    return np.array(costs)


def main():
    print(f"{os.cpu_count()} processors; circle on the mechanism, {SECONDS:g} s simulated")
    taps = {"terminal": lambda chosen: LiveProcess(work, (chosen,))}
    try:
        opened = viewer.page(viewer.free_port())
        taps["viewer"] = lambda chosen: live.show(chosen, "circle", opened.url)
    except ViewError as error:
        opened = None
        print(f"no viewer to measure with: {error}")
    chosen = load("circle", (f"duration={SECONDS}", "metrics.start=0"))
    try:
        for name, make in taps.items():
            pairs = []
            for _ in range(ROUNDS):
                alone = one_run()
                tap = make(chosen)
                time.sleep(4)  # the process has started
                pairs.append((alone, one_run(tap)))
                tap.finish(20)
                dropped = tap.dropped
                tap.close()
            wall, used = (
                [np.median([pair[which][kind] for pair in pairs]) for which in (0, 1)]
                for kind in (0, 1)
            )
            print(
                f"{name}: loop {wall[0]:.2f} -> {wall[1]:.2f} s wall "
                f"({100 * (wall[1] / wall[0] - 1):+.1f} %), {used[0]:.2f} -> {used[1]:.2f} s of "
                f"its own processor ({100 * (used[1] / used[0] - 1):+.1f} %), dropped {dropped}"
            )
            tap = make(chosen)
            time.sleep(4)
            costs = tick_costs(tap)
            tap.finish(20)
            tap.close()
            print(
                f"{name}: a tick takes longer by {np.median(costs):.1f} us (median), "
                f"{np.quantile(costs[1:], 0.99):.1f} us (p99), {costs[1:].max():.0f} us (worst), "
                f"{costs[0]:.0f} us (first)"
            )
        done = run(chosen)
        with TemporaryDirectory() as folder:
            save(done, Path(folder), {"circle": done.motion})
            begin = time.perf_counter()
            write(Path(folder) / "view.rrd", open_run(Path(folder)))
            spent = time.perf_counter() - begin
        print(
            f"--rrd: {spent:.2f} s after the run for {SECONDS:g} s simulated "
            f"({100 * spent / SECONDS:.1f} % of the simulated time)"
        )
    finally:
        if opened is not None:
            opened.close()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"memory of the control process at most {peak:.0f} MiB")


if __name__ == "__main__":
    main()
