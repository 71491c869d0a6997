"""Lateness of an empty 2 ms loop under RealTimeClock, and with a touch screen being read beside it.

Run with ``uv run python -m benchmarks.realtime``. The ways to wait are a sleep to the deadline and
the hybrid that spins its end, each with and without real-time priority; then the hybrid reads an
emulated screen in another process over a pty. The numbers are those of the machine it runs on.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from multiprocessing.connection import Connection

from twin.devices.lumio.config import LumioConfig
from twin.devices.lumio.screen import LumioScreen
from twin.devices.realtime import RealTimeClock
from twin.devices.scheduling import real_time
from twin.devices.timing import TimingLog
from twin.emulator.screen import EmulatedScreen, ScreenLine

PERIOD = 0.002


def loop(
    seconds: float, spin: float, prioritised: bool, work: Callable[[], object]
) -> tuple[TimingLog, float]:
    """Run an otherwise empty loop; return its timing and the share of a processor it took."""
    about: AbstractContextManager[object] = real_time() if prioritised else nullcontext()
    with about:
        clock = RealTimeClock(PERIOD, spin=spin)
        clock.start()
        begin = time.process_time()
        while clock.tick * PERIOD < seconds:
            clock.timing.begin()
            work()
            clock.timing.mark("work")
            clock.wait()
        busy = (time.process_time() - begin) / seconds
    return clock.timing, busy


def show(name: str, timing: TimingLog, busy: float) -> None:
    late = timing.lateness.as_dict()
    print(
        f"{name:34} p50 {late['p50_us']:5} us  p99 {late['p99_us']:5} us  max {late['max_us']:6} us"
        f"  missed {timing.missed:3} of {timing.ticks + timing.missed}  processor {busy:6.1%}"
    )


def serve(pipe: Connection) -> None:
    """An emulated screen in a process of its own."""
    with EmulatedScreen(ScreenLine(lambda: [(0.1, 0.05)])) as screen:
        pipe.send(str(screen.path))
        pipe.recv()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds = parser.parse_args().seconds
    for prioritised in (False, True):
        for spin in (0.0, 2e-4):
            way = ("hybrid" if spin else "sleep") + (", priority" if prioritised else "")
            show(way, *loop(seconds, spin, prioritised, lambda: None))
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=serve, args=(theirs,))
    server.start()
    with LumioScreen(LumioConfig(port=ours.recv())) as screen:
        time.sleep(0.5)
        ages = []

        def read() -> None:
            ages.append(float(screen.read().age[0]))
            screen.faults()

        timing, busy = loop(seconds, 2e-4, True, read)
        show("hybrid, priority, touch screen", timing, busy)
        work = timing.stages["work"].as_dict()
        print(f"read and faults of the screen: p50 {work['p50_us']} us, p99 {work['p99_us']} us")
        print(f"reports: {screen.reports}, oldest sample {1000 * max(ages):.1f} ms")
    ours.send(None)
    server.join()


if __name__ == "__main__":
    main()
