"""The 2 ms loop on the machine as it is and with a load, with and without real-time priority.

Run with ``uv run python -m benchmarks.realtime``; the numbers are those of the machine it runs on,
which is idle only if its load average, printed first, says so.
First an otherwise empty loop (a sleep to the deadline, or the hybrid that spins its end), then the
loop with a touch screen and two drives behind ports, emulated in another process. That process says
how far it was itself behind the clock: a host that is late and an emulator that starves both make
answers come late, and only the two columns together tell which it was.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing.connection import Connection

from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, BusConfig, MonitorConfig
from twin.devices.akd.servos import AkdServos
from twin.devices.lumio.config import LumioConfig
from twin.devices.lumio.screen import LumioScreen
from twin.devices.realtime import LatencyHistogram, RealTimeClock, TimingLog
from twin.devices.scheduling import real_time
from twin.emulator.can_bus import EmulatedBus
from twin.emulator.can_slcan import BusServer, SlcanPort
from twin.emulator.drive import DriveSettings, EmulatedDrive
from twin.emulator.process import come_forward
from twin.emulator.screen import EmulatedScreen, ScreenLine

PERIOD = 0.002
PATIENT = MonitorConfig(stale=250, unsteady=51, lag_time=2.0, frozen=10.0, answer=10.0)
"""Nothing but the timing is judged here."""


def loop(
    seconds: float, spin: float, prioritised: bool, work: Callable[[float], object]
) -> tuple[TimingLog, float]:
    """Run a loop; return its timing and the share of a processor it took.

    Args:
        seconds: How long.
        spin: Time in s before a deadline that is spent spinning.
        prioritised: Whether with real-time priority.
        work: Called once per period with the time left of it, s.
    """
    about: AbstractContextManager[object] = real_time() if prioritised else nullcontext()
    with about:
        clock = RealTimeClock(PERIOD, spin=spin)
        clock.start()
        begin = time.process_time()
        while clock.tick * PERIOD < seconds:
            clock.timing.begin()
            work(clock.left)
            clock.timing.mark("work")
            clock.wait()
        busy = (time.process_time() - begin) / seconds
    return clock.timing, busy


def show(name: str, timing: TimingLog, busy: float, more: str = "") -> None:
    late = timing.lateness.as_dict()
    print(
        f"{name:44} p50 {late['p50_us']:5} us  p99 {late['p99_us']:6} us  "
        f"max {late['max_us']:6} us  missed {timing.missed:4} of {timing.ticks + timing.missed}  "
        f"processor {busy:6.1%}{more}",
        flush=True,
    )


def spin_for_ever() -> None:
    while True:
        pass


@contextmanager
def load(processes: int) -> Iterator[None]:
    """So many busy processes of ordinary priority."""
    context = multiprocessing.get_context("spawn")
    busy = [context.Process(target=spin_for_ever, daemon=True) for _ in range(processes)]
    for each in busy:
        each.start()
    time.sleep(1.0 if busy else 0.0)
    try:
        yield
    finally:
        for each in busy:
            each.kill()
            each.join()


def serve(pipe: Connection, forward: bool) -> None:
    """An emulated screen and two emulated drives in a process of their own."""
    if forward:
        come_forward()
    bus = EmulatedBus([EmulatedDrive(DriveSettings(node=node)) for node in (1, 2)])
    line = ScreenLine(lambda: [(0.1, 0.05)])
    with EmulatedScreen(line) as screen, SlcanPort(bus) as port, BusServer(bus, port) as server:
        pipe.send((str(screen.path), port.channel))
        while pipe.recv() == "begin":
            with server.lock:
                server.lag = LatencyHistogram()
            pipe.recv()
            with server.lock:
                pipe.send(server.lag.as_dict())


def devices(seconds: float, loaded: str, prioritised: bool, forward: bool) -> None:
    """Run the loop with drives and screen, and print both processes' timing."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    server = context.Process(target=serve, args=(theirs, forward))
    server.start()
    screen_port, channel = ours.recv()
    bus = BusConfig(interface="slcan", channel=channel, options={"sleep_after_open": 0.0})
    servos = AkdServos(AkdConfig(bus=bus, silence=1.0, answer=10.0, watch=PATIENT))
    stale = [0]

    def work(left: float) -> None:
        servos.receive()
        screen.read()
        screen.faults()
        servos.faults()
        servos.send()
        servos.settle(left - 5e-4)
        stale[0] += servos.round_trip is None

    name = f"{loaded}, devices{', priority' if prioritised else ''}"
    try:
        with LumioScreen(LumioConfig(port=screen_port)) as screen:
            servos.start()
            ours.send("begin")
            timing, busy = loop(seconds, 2e-4, prioritised, work)
            ours.send("end")
            lag = ours.recv()
        share = stale[0] / max(1, timing.ticks)
        show(
            f"{name}{', emulator too' if forward else ''}",
            timing,
            busy,
            f"  answers late {share:6.2%}  emulator behind: p99 {lag['p99_us']:6} us, "
            f"max {lag['max_us']:6} us",
        )
    except DriveError as error:
        print(f"{name}: {error}")
    finally:
        servos.stop()
        ours.send("stop")
        server.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--busy", type=int, default=2 * (os.cpu_count() or 1), help="of the load")
    options = parser.parse_args()
    print(f"load average before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    for processes in (0, options.busy):
        loaded = f"{processes} busy" if processes else "as it is"
        with load(processes):
            for prioritised in (False, True):
                for spin in (0.0, 2e-4):
                    way = ("hybrid" if spin else "sleep") + (", priority" if prioritised else "")
                    name = f"{loaded}, {way}"
                    show(name, *loop(options.seconds, spin, prioritised, lambda _: None))
            for prioritised in (False, True):
                for forward in (False, True):
                    devices(options.seconds, loaded, prioritised, forward)


if __name__ == "__main__":
    main()
