"""The page on chapter 9 of the thesis, experiments.md, and what the program keeps of its fit.

uv run python docs/chapter9.py                    # the page and its figure
uv run python docs/chapter9.py --keep FIT.json    # adds a fit of chapter_9 to those kept, first

"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pages import HERE, filled, said

from twin.fit.runs import cells as numbers_of
from twin.fit.schema import read
from twin.jobs import cores
from twin.thesis import chapter9
from twin.thesis.chapter9 import COLUMNS, Row, errors, goals, held_out_goals, stored
from twin.writing import write_json, write_whole

KEPT = HERE.parent / "src" / "twin" / "thesis" / "data" / "chapter_9.json"
FIGURE = "experiments.png"
LAWS = {
    "AFL": ("9.2", "9.3"),
    "AFL with integral": ("9.4", "9.5"),
    "backstepping": ("9.6", "9.7"),
    "sliding mode": ("9.8", "9.9"),
}
MEASURED, PREDICTED, CLEAN, HELD = "#222222", "#1f6fb4", "#e08214", "#4d9221"


def page(cells: list[Row], confirmed: list[Row]) -> str:
    """The page: goals, numbers, and all cells; ``confirmed`` is explained on the mechanism."""
    about = read("chapter_9")
    # with all tables, then without each
    ends = zip(*(chapter9.best(group) for group in ("", *about.groups)), strict=True)
    return filled(
        "experiments",
        figure=FIGURE,
        goals=goals(cells),
        known=stored(),
        parameters=about.parameters,
        values=dict(zip(about.parameters, ends, strict=True)),
        number=len(numbers_of(about)),
        held_out=zip(held_out_goals(cells), held_out_goals(confirmed), strict=True),
        scatter=chapter9.scatter(),
        cells=cells,
        confirmed=zip(cells, confirmed, strict=True),
        columns=COLUMNS,
        said=said,
    )


def draw(path: Path, cells: list[Row]) -> None:
    """Tracking error over frequency, one panel per law, without predictor and with."""
    figure = Figure(figsize=(11, 6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 4, sharex=True, sharey=True)
    for column, (law, pair) in enumerate(LAWS.items()):
        for line, number in enumerate(pair):
            _panel(axes[line, column], cells, number)
            fitted = " (fitted)" if number == "9.3" else ""
            axes[line, column].set_title(f"{law}, {number}{fitted}", fontsize=10)
    for line, side in enumerate(("without predictor", "with Smith predictor")):
        axes[line, 0].set_ylabel(f"{side}\ntracking error [%]")
    for ax in axes[1]:
        ax.set_xlabel("ω [rad/s]")
    axes[0, 0].set_ylim(0)  # of all, and after all are drawn
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    write_whole(path, lambda target: figure.savefig(target, dpi=110, metadata={"Software": None}))


def _panel(ax: Axes, cells: list[Row], number: str) -> None:
    omega = (0.5, 0.75, 1.0)

    def values(key: str) -> Any:
        return errors(cells, [number], key)

    look: dict[str, Any] = {
        "color": PREDICTED,
        "alpha": 0.2,
        "lw": 0,
        "label": "its 95 % interval of friction",
    }
    ax.fill_between(omega, values("low"), values("high"), **look)
    ax.plot(omega, values("predicted"), "o-", color=PREDICTED, ms=5, label="predicted")
    ax.plot(omega, values("frictionless"), "s-", color=CLEAN, ms=4, label="frictionless twin")
    ax.plot(omega, values("held_out"), "^-", color=HELD, ms=4, label="explained, held out")
    ax.plot(omega, values("thesis"), "D", color=MEASURED, ms=6, label="measured on the rig")
    ax.set_xticks(omega)
    ax.grid(alpha=0.3)


def keep(found: Path) -> None:
    """Add a fit to those that the program keeps, each with the goals it comes to."""
    new, about = json.loads(found.read_text(encoding="utf-8")), read("chapter_9")
    search: dict[str, Any] = {
        "by": "CMA-ES",
        "chi2": new["chi2"],
        "parameters": {each["name"]: each["value"] for each in new["parameters"]},
        "without": {
            group: {"chi2": new["chi2_without"][group], "parameters": numbers}
            for group, numbers in new["without"].items()
        },
    }
    searches = [*(stored()["searches"] if KEPT.exists() else []), search]
    ends = [[chapter9.ended(each, e.own_group)[1] for e in about.experiments] for each in searches]
    wanted = [(sample, k) for end in ends for k, sample in enumerate(end)]
    values = chapter9.carried(about, wanted, cores(), lambda _: None)
    for search, end in zip(searches, ends, strict=True):
        cells = [
            {
                "table": each.own_group,
                "column": column,
                "thesis": each.measured[indicator].value,
                "held_out": values[end[k], k][indicator],
            }
            for k, each in enumerate(about.experiments)
            for column, (indicator, _) in COLUMNS.items()
            if indicator in each.measured
        ]
        search["goals"] = {goal.sentence: round(goal.value, 4) for goal in held_out_goals(cells)}
    content = {key: new[key] for key in ("parameters", "correlation")} | {"searches": searches}
    write_json(KEPT, content)
    stored.cache_clear()


@click.command()
@click.option("--keep", "found", type=click.Path(path_type=Path, exists=True))
def main(found: Path | None) -> None:
    """Write the page; with --keep add a fit to those that the program keeps first."""
    if found is not None:
        keep(found)
    cells = chapter9.rows(processes=cores())
    confirmed = chapter9.rows(settings=chapter9.MECHANISM, processes=cores())
    draw(HERE / "figures" / FIGURE, cells)
    write_whole(HERE / "experiments.md", page(cells, confirmed))


if __name__ == "__main__":
    main()
