"""How runs on the virtual rig end here, and what a command of a law and a trace of the bus cost.

uv run python -m benchmarks.realtime --ticks 10
uv run python -m benchmarks.realtime --wire 20 --beside 2 --ordinary
uv run python -m benchmarks.realtime --trace 5
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

import ballplate as bp
from controllers.arrays import Array
from twin.base.page import markdown
from twin.devices.realtime import real_time
from twin.run.assemble import assemble
from twin.scenario.load import load

COMMANDS = (
    ("afl, luenberger", "circle", ()),
    (
        *("stable_inversion, friction_kalman", "circle"),
        ("controller.kind=stable_inversion", "observer.kind=friction_kalman"),
    ),
    ("the cure", "cure", ()),
)
FRAMES = (500, 58)
"""Of the screen in a second: one a control period, and what the known panels give."""
ROUNDS = 3
SCENARIOS = ("circle", "cure_afl", "cure")
ERROR = "tracking_error_percent"
ALONE = ["baseline=false"]
SCREEN = "sensors.touch.frame_rate=57.6"
"""The frames of the virtual rig's screen, for the same run simulated."""
ORDINARY = ("setpriv", "--inh-caps=-sys_nice", "--bounding-set=-sys_nice")
"""A program behind this has no real-time priority."""
QUANTILES = (0.5, 0.99, 0.999)


@contextmanager
def busy(number: int) -> Iterator[None]:
    """Meanwhile, so many ordinary processes compute without a pause."""
    with ExitStack() as ended:
        for _ in range(number):
            process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            ended.callback(process.wait)
            ended.callback(process.kill)
        yield


def wired(scenario: str, before: Sequence[str] = ()) -> Any:
    """A run of a scenario on the virtual rig, as a command of its own behind another one."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        words = ["run", scenario, "--rig", "emulated", "--set", *ALONE, "--out", str(out)]
        call = [*before, sys.executable, "-m", "twin", *words]
        subprocess.run(call, capture_output=True, check=False)
        return bp.load(out)


def lateness(runs: Sequence[Any]) -> Array:
    """How late each period of some runs began, ms."""
    return np.concatenate([1e3 * np.asarray(run.rows["lateness"]) for run in runs])


def row(scenario: str, simulated: float, runs: Sequence[Any]) -> list[str]:
    """What runs of one scenario came to, as cells of the table."""
    errors = np.array([run.metrics[ERROR] for run in runs if run.outcome == "finished"])
    late, missed = lateness(runs), sum(run.ledger["missed"] for run in runs)
    pauses = sum(sum(run.ledger["pauses_us"]) for run in runs)
    return [
        scenario,
        f"{len(errors)} of {len(runs)}",
        f"{np.median(errors):.2f} ({errors.min():.2f} to {errors.max():.2f})"
        if len(errors)
        else "-",
        f"{simulated:.2f}",
        f"{100 * missed / (missed + len(late)):.2f}",
        *(f"{each:.3f}" for each in np.quantile(late, QUANTILES)),
        f"{late.max():.1f}",
        f"{1e-3 * pauses:.0f}",
    ]


HEADINGS = (
    *("scenario", "finished", "error [%]", "simulated [%]", "missed [%]"),
    *(f"late, {each} [ms]" for each in ("p50", "p99", "p99.9", "largest")),
    "paused [ms]",
)


def on_the_wire(number: int, beside: int, before: Sequence[str] = ()) -> str:
    """The table of so many runs of each scenario, beside a number of busy processes."""
    rows = []
    for scenario in SCENARIOS:
        simulated = bp.run(scenario, [*ALONE, SCREEN]).metrics[ERROR]
        with busy(beside):
            runs = [wired(scenario, before) for _ in range(number)]
        rows.append(row(scenario, simulated, runs))
        ends = [run.metrics["reason"] for run in runs if run.metrics.get("reason")]
        click.echo("  ".join([*rows[-1], *ends]), err=True)
    return markdown(HEADINGS, rows)


def emulating() -> str:
    """Part of one processor that the virtual rig takes over a run, in %, its start included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = bp.run("circle", ALONE, on="emulated")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return f"{100 * used / run.rows['time'][-1]:.0f}"


def tracing(number: int) -> str:
    """The table of so many runs each with the trace of the bus and without it, in turn.

    Lateness of the periods, and the stage in which what is said is handed over.
    """
    found: dict[str, list[Any]] = {"without": [], "with": []}
    with TemporaryDirectory() as folder:
        for _ in range(number):
            for way, runs in found.items():
                file = Path(folder) / "trace.log" if way == "with" else None
                changes = [*ALONE, "duration=10"]
                runs.append(bp.run("circle", changes, on="emulated", trace=file))
    rows = [
        [
            way,
            *(f"{each:.4f}" for each in np.quantile(lateness(runs), QUANTILES)),
            f"{sum(run.ledger['missed'] for run in runs)}",
            f"{1e-3 * np.median([run.ledger['stages']['write']['p99_us'] for run in runs]):.3f}",
        ]
        for way, runs in found.items()
    ]
    heads = ("trace", "late, p50 [ms]", "p99 [ms]", "p99.9 [ms]", "missed", "writing, p99 [ms]")
    return markdown(heads, rows)


def command_times(scenario: str, changes: Sequence[str], seconds: float) -> Array:
    """Processor time of each command, observer and law, on the simulated rig, in us.

    Only what this thread computes counts; what interrupts it leaves cold caches, which is in it.

    Args:
        scenario: Its name.
        changes: Settings of it, as on the command line.
        seconds: Simulated time, after a second of it.
    """
    rig, controller = assemble(load(scenario, list(changes)))
    times = []
    with real_time(), rig:
        measurement = rig.read()
        controller.start(measurement)
        rig.start()
        for _ in range(round((seconds + 1) / rig.period)):
            begin = time.thread_time_ns()
            step = controller.command(measurement)
            passed = time.thread_time_ns() - begin
            rate = rig.write(step.rate)
            begin = time.thread_time_ns()
            controller.applied(rate)
            times.append(passed + time.thread_time_ns() - begin)
            rig.wait()
            measurement = rig.read()
    return np.array(times[round(1 / rig.period) :]) / 1e3


def command_table(seconds: float) -> str:
    """The table of the processor time of a command, by law and frames of the screen.

    Runs of one scenario are the same to the last bit: of each command the least of a few counts,
    which no other process has disturbed.
    """
    rows = []
    for name, scenario, changes in COMMANDS:
        for rate in FRAMES:
            screen = f"sensors.touch.frame_rate={rate}"
            runs = [command_times(scenario, [*changes, screen], seconds) for _ in range(ROUNDS)]
            found = np.min(runs, axis=0)
            told = (np.median(found), *np.quantile(found, (0.99, 0.999)), found.max())
            rows.append([name, f"{rate}", *(f"{each:.0f}" for each in told)])
    heads = ("law and observer", "frames/s", "median [us]", "p99", "p99.9", "largest")
    return markdown(heads, rows)


@click.command(no_args_is_help=True)
@click.option("--ticks", type=float, default=0, help="Seconds of commands timed, by law.")
@click.option("--wire", type=int, default=0, help="Runs of each scenario on the virtual rig.")
@click.option("--beside", type=int, default=0, help="Busy processes beside them.")
@click.option("--ordinary", is_flag=True, help="Without real-time priority.")
@click.option("--trace", type=int, default=0, help="Runs each with a trace of the bus and without.")
def main(ticks: float, wire: int, beside: int, trace: int, *, ordinary: bool) -> None:
    """Print what commands cost, how runs on the virtual rig end, or what a trace costs."""
    if ticks:
        click.echo(command_table(ticks))
    if trace:
        click.echo(tracing(trace))
    if wire:
        click.echo(on_the_wire(wire, beside, ORDINARY if ordinary else ()))
        click.echo(f"virtual rig: {emulating()} % of a processor, its start included")


if __name__ == "__main__":
    main()
