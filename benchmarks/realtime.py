"""What part of its period each law computes for, by control period, on this computer.

uv run python -m benchmarks.realtime
uv run python -m benchmarks.realtime --wire 20     # and how many runs on the virtual rig finish
"""

from __future__ import annotations

import os
from typing import Any

import click

import ballplate as bp
from twin.run.connect import ComputingTime
from twin.scenario.load import load

PERIODS = (0.001, 0.002, 0.004, 0.01)
LAWS = {
    "afl": (),
    "lqr": ("controller.kind=lqr",),
    "mpc": ("controller.kind=mpc",),
    "stable_inversion, friction known": (
        "controller.kind=stable_inversion",
        "observer.kind=friction_kalman",
    ),
}
SCENARIOS = ("circle", "cure_afl", "cure")
ALONE, ERROR = ["baseline=false"], "tracking_error_percent"


def share(scenario: str, changes: tuple[str, ...], period: float) -> str:
    """Median and largest of a thousand as parts of a period; marked where it is too much."""
    found = ComputingTime.measured(load(scenario, [*changes, f"rig.period={period}"]))
    mark = "" if found.enough else " !!" if found.never else " !"
    return f"{found.median / period:.2f} / {found.worst / period:.2f}{mark}"


@click.command()
@click.option("--wire", type=int, default=0, help="Runs of each scenario on the virtual rig.")
def main(wire: int) -> None:
    """Print the table; !: may be late now and then, !!: keeps no period."""
    click.echo(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    rows = [("circle", name, changes) for name, changes in LAWS.items()]
    rows += [(name, name, ()) for name in SCENARIOS[1:]]
    click.echo(f"{'median / p99.9':34}" + "".join(f"{1e3 * each:>16g} ms" for each in PERIODS))
    for scenario, name, changes in rows:
        cells = (share(scenario, changes, period) for period in PERIODS)
        click.echo(f"{name:34}" + "".join(f"{cell:>19}" for cell in cells))
    for scenario in SCENARIOS if wire else ():
        simulated = bp.run(scenario, ALONE).metrics[ERROR]
        for number in range(wire):
            click.echo(f"{scenario} {number + 1}: {wired(scenario)}, simulated {simulated:.2f} %")


def wired(scenario: str, **changes: Any) -> str:
    """How a run of a scenario on the virtual rig ended, and how late this computer was."""
    run = bp.run(scenario, ALONE, on="emulated", **changes)
    ledger, error = run.account["ledger"], run.metrics.get(ERROR)
    late = ledger["lateness"]
    return (
        f"{run.outcome}, missed {ledger['missed']} of {ledger['ticks'] + ledger['missed']}, "
        f"late p99 {late['p99_us']} us, at most {late['max_us']} us, "
        f"{len(ledger['pauses_us'])} pauses, error {'-' if error is None else f'{error:.2f} %'}"
    )


if __name__ == "__main__":
    main()
