"""Makes benchmark.md and its picture, and freezes what the benchmark is.

uv run python docs/benchmark.py            # all shipped laws: an hour on two cores
uv run python docs/benchmark.py --freeze   # draws the rigs and locks, once for a version
uv run python docs/benchmark.py --lock     # locks the errors again of a law that has changed
What was found of a law is in data/benchmark/. Finished runs are kept in runs/bench and used again
while what a run executes stays the same.
"""

from __future__ import annotations

import csv
import io
import json
from typing import Any

import click
import numpy as np
import pandas as pd

from docs.pages import HERE, filled, write
from twin.base.writing import write_whole
from twin.lab.bench import FAMILY_NAME, LOCKED_FILES, MODEL_FILES, Benchmark, hash_file
from twin.lab.bench_entries import enter
from twin.run.loop import simulate
from twin.run.picture import styled_figure
from twin.study.experiments import Store
from twin.study.schema import draw_rigs as rigs_of
from twin.study.schema import read_family

DRAW, RIGS = 2026, 128
EXPECTED, FIRST = ("lqr", "afl", "cure"), 4
"""The laws whose errors on the first rigs are locked, and how many rigs."""
BESIDE = (0.0, 1e-6, 2e-6, 3e-6)
"""Where the ball also begins, m on along x, to see what goes by the last bit."""
HELD = ("Hold-v1",)
"""Tasks in which the ball is held: what an error is goes by the last bit there, as nowhere else."""
LEAST = 0.005
"""Least error of the picture."""
KEPT = HERE.parent / "runs" / "bench"
FOUND = HERE / "data" / "benchmark"
"""Of each law a table of its runs, in the order of reference.csv: the error in m, empty where the
ball was lost, and the RMS plate acceleration in rad/s^2.
"""


def rigs() -> str:
    """The rigs as a table: a column for each parameter, and the first of their seeds."""
    family, file = read_family(FAMILY_NAME), io.StringIO()
    table = csv.writer(file, lineterminator="\n")
    table.writerow([*family.parameters, "seed"])
    for each in rigs_of(family, DRAW, RIGS):
        table.writerow([*map(json.dumps, each.point.values()), each.seed])
    return file.getvalue()


def measured(bench: Benchmark, law: str) -> Any:
    """The runs of a shipped law."""
    entry = bench.about.laws[law]

    def told(done: int, failed: int) -> None:
        click.echo(f"{entry.title}: {done} runs, {failed} not finished", err=True)

    return bench.run_entry(entry, bench.folder, Store(KEPT), progress=told)


def write_found(bench: Benchmark, law: str, rows: pd.DataFrame) -> None:
    """Write what was found of a law."""
    rows = bench.known().merge(rows, "left", on=["task", "rig", "noise"], validate="1:1")
    error = rows[bench.about.metric].where(rows["outcome"] == "finished")
    table = pd.DataFrame({"error": error, "effort": rows["u_rms"]})
    text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_whole(FOUND / f"{law}.csv", text)


def found_before(bench: Benchmark, law: str) -> pd.DataFrame:
    """The runs of a law as its table has them."""
    table = pd.read_csv(FOUND / f"{law}.csv")
    rows = bench.known()[["task", "rig", "noise"]].copy()
    outcome = np.where(table["error"].notna(), "finished", "lost")
    rows["outcome"], rows[bench.about.metric] = outcome, table["error"]
    return rows.assign(u_rms=table["effort"])


def freeze(folder: Any) -> None:
    """Draw the rigs, run the reference law on them, and lock."""
    write_whole(folder / "rigs.csv", rigs())
    bench = Benchmark(folder)
    rows = measured(bench, bench.about.reference)
    known = bench.as_reference(rows)
    write_whole(folder / "reference.csv", known.to_csv(index=False, lineterminator="\n"))
    lock(folder)


def lock(folder: Any) -> None:
    """Write hashes of the files that stay as they are, and the errors of laws on the first rigs.

    A law of this project may change; its errors are then locked again, and nothing else.
    """
    bench = Benchmark(folder)
    lines = ["# What version 1 was when it was frozen: docs/benchmark.py --freeze.", "[files]"]
    lines += [f'"{name}" = "{hash_file(folder, name)}"' for name in (*LOCKED_FILES, *MODEL_FILES)]
    for law in EXPECTED:
        rows = bench.run_entry(bench.about.laws[law], folder, Store(KEPT), rigs=FIRST)
        lines += ["", f"[expected.{law}]"]
        for task, its in rows.groupby("task", sort=False):
            lines.append(f'"{task}" = {its[bench.about.metric].tolist()}')
        lines += ["", f"[rounding.{law}]"]
        lines += [f'"{task}" = {apart}' for task, apart in rounding(bench, law).items()]
    write_whole(folder / "lock.toml", "\n".join(lines) + "\n")


def rounding(bench: Benchmark, law: str) -> dict[str, list[float]]:
    """By task of ``HELD``, how far apart in m an error is with the ball begun ``BESIDE`` on."""
    with enter(bench.about.laws[law], bench.folder) as (fixed, _):
        listed = bench.runs(fixed, rigs=FIRST)
    found = {}
    for task in HELD:
        its = [each.scenario for each in listed if each.task == task]
        errors = [
            [row[bench.about.metric] for row in simulate([moved(each, by) for each in its])]
            for by in BESIDE
        ]
        found[task] = [float(f"{each:.1g}") for each in np.ptp(errors, axis=0)]
    return found


def moved(scenario: Any, shift: float) -> Any:
    """The scenario with the ball's beginning so many m on along x."""
    start = scenario.plant.start.model_copy(update={"x": scenario.plant.start.x + shift})
    return scenario.model_copy(update={"plant": scenario.plant.model_copy(update={"start": start})})


def picture(bench: Benchmark, errors: dict[str, Any]) -> Any:
    """For every task the share of runs whose relative error is at most so much."""
    with styled_figure(10, 6) as figure:
        panels = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
        for panel, task in zip(panels, bench.about.tasks, strict=False):
            for law, rows in errors.items():
                its = np.sort(rows.loc[rows["task"] == task.name, "error"])
                share = 100 * np.arange(1, len(its) + 1) / len(its)
                own = {"color": "black"} if law == bench.about.reference else {}
                panel.step([LEAST, *its], [0, *share], where="post", label=law, **own)
            panel.set(title=task.name, xscale="log", xlim=(LEAST, bench.about.most), ylim=(0, 100))
        for panel in panels[3:]:
            panel.set_xlabel(f"error relative to {bench.about.reference}, same rig and noise")
        figure.supylabel("share of runs [%]")
        handles = panels[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside lower center", ncols=6)
    return figure


@click.command()
@click.option("--freeze", "freezing", is_flag=True, help="Draw the rigs and lock; no page.")
@click.option("--lock", "locking", is_flag=True, help="Lock the laws' errors again; no page.")
def main(*, freezing: bool, locking: bool) -> None:
    """Run what is not kept, then write the page."""
    folder = HERE.parent / "scenarios" / "bench" / "v1"
    if freezing:
        freeze(folder)
        return
    if locking:
        lock(folder)
        return
    bench = Benchmark(folder)
    for law in bench.about.laws:
        write_found(bench, law, measured(bench, law))
    found = {law: found_before(bench, law) for law in bench.about.laws}
    scores = {law: bench.scores(rows) for law, rows in found.items()}
    figure = picture(bench, {law: bench.relative(rows) for law, rows in found.items()})
    file = HERE / "figures" / "benchmark.png"
    write_whole(file, lambda path: figure.savefig(path, format="png", dpi=110))
    text = filled("benchmark", bench=bench, scores=scores, rig=len(bench.points))
    write(HERE / "benchmark.md", text)


if __name__ == "__main__":
    main()
