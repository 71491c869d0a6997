"""Processor time of ``ballplate trace``, and of reading alone against python-can's own reader."""

from __future__ import annotations

import time
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import can

from benchmarks import start_up
from benchmarks.closed_loop import alternated
from twin.devices.akd.recording import TraceWriter
from twin.devices.akd.traces import read_trace
from twin.emulator.lockstep import LockstepRig
from twin.run.finished import run
from twin.scenario import load

FRAMES = 16_000
"""Frames of the trace: five seconds of two drives at 500 Hz."""


def write_run(file: Path) -> None:
    """Write the first ``FRAMES`` frames of a run on an emulated rig, in virtual time."""
    rig = LockstepRig(scenario := load("hold", ["duration=4.5"]))
    heard: list[can.Message] = []
    rig.lockstep.heard = heard.append
    run(scenario, rig=rig)
    begin = time.time()
    with closing(TraceWriter(file, "can0")) as writer:
        for message in heard[:FRAMES]:
            message.timestamp += begin
            writer.write([message])


def _ours(file: Path) -> float:
    begin = time.process_time()
    count = len(read_trace(file).frames)
    return _seconds_since(begin, count)


def _theirs(file: Path) -> float:
    begin = time.process_time()
    with can.LogReader(file) as reader:
        count = len(list(reader))
    return _seconds_since(begin, count)


def _seconds_since(begin: float, count: int) -> float:
    if count != FRAMES:
        raise RuntimeError(f"{count} of {FRAMES} frames were read")
    return time.process_time() - begin


def ratios(rounds: int) -> tuple[float, float, float]:
    """Seconds of ``import numpy``; how many times that ``trace`` takes; reading by python-can's."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "bus.log"
        write_run(file)

        jobs = partial(_ours, file), partial(_theirs, file)
        read, reference = alternated(2 * rounds, *jobs)["least"]
        numpy, found = start_up.ratios({"trace": ("trace", str(file))}, rounds)
    return numpy, found["trace"], read / reference
