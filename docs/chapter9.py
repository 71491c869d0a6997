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
from pages import filled

from twin.fit.runs import cells as numbers_of
from twin.fit.schema import read
from twin.jobs import cores
from twin.markdown import table
from twin.thesis import chapter9
from twin.thesis.chapter9 import COLUMNS, Row, errors, goals, held_out_goals, stored
from twin.writing import write_json, write_text, write_whole

HERE = Path(__file__).parent
KEPT = HERE.parent / "src" / "twin" / "thesis" / "data" / "chapter_9.json"
FIGURE = "experiments.png"
KEYS = ("frictionless", "predicted", "explained", "held_out")
LAWS = {
    "AFL": ("9.2", "9.3"),
    "AFL with integral": ("9.4", "9.5"),
    "backstepping": ("9.6", "9.7"),
    "sliding mode": ("9.8", "9.9"),
}
MEASURED, PREDICTED, CLEAN, HELD = "#222222", "#1f6fb4", "#e08214", "#4d9221"


def page(cells: list[Row], confirmed: list[Row]) -> str:
    """The page: goals, numbers, and all cells; ``confirmed`` is explained on the mechanism."""
    searches = stored()["searches"]
    verdicts = [
        (goal.sentence, goal.found, "reached" if goal.reached else "**not reached**")
        for goal in goals(cells)
    ]
    return filled(
        "experiments",
        figure=FIGURE,
        goals=table(("goal", "found", ""), verdicts),
        numbers=_numbers(),
        searches=len(searches),
        ends=", ".join(f"{search['chi2']:.1f} ({search['by']})" for search in searches),
        cells=len(numbers_of(read("chapter_9"))),
        held_out=_held_out(cells, confirmed),
        tracking=_tracking(cells, confirmed),
        others=_others(cells),
        notes=[
            f"- {row['table']}, {row['row']}, {row['column']}: {row['note']}"
            for row in cells
            if row["note"]
        ],
    )


def _numbers() -> str:
    known, about = stored(), read("chapter_9")
    lines = []
    for each in known["parameters"]:
        place = list(about.parameters).index(each["name"])
        value, *folds = (chapter9.best(group)[place] for group in ("", *about.groups))
        lines.append(
            (
                each["name"].replace("_", " "),
                f"{value:.4g}",
                f"{each['low']:.3g} to {each['high']:.3g}",
                f"{min(folds):.3g} to {max(folds):.3g}",
                about.parameters[each["name"]].unit or "1",
                each["verdict"],
            )
        )
    head = ("number", "value", "95 %, bootstrap", "without one table", "unit", "verdict")
    return table(head, lines)


def _held_out(cells: list[Row], confirmed: list[Row]) -> str:
    scatter, searches = chapter9.scatter(), stored()["searches"]
    lines = []
    for one, other in zip(held_out_goals(cells), held_out_goals(confirmed), strict=True):
        by = scatter[one.sentence]
        aim = f"{one.low:.3g} to {one.high:.3g}" if one.low > 0 else f"at most {one.high:g}"
        lines.append(
            (
                one.sentence,
                aim,
                f"{one.value:.3f}",
                *(f"{search['goals'][one.sentence]:.3f}" for search in searches),
                f"{by:.3f}",
                one.verdict(by),
                f"{other.value:.3f}",
                other.verdict(by),
            )
        )
    names = [f"search {number}" for number in range(1, len(searches) + 1)]
    head = ("goal", "", "held out", *names, "scatter", "", "mechanism", "")
    return table(head, lines, words=(0, 1, -3, -1))


def _tracking(cells: list[Row], confirmed: list[Row]) -> str:
    lines = []
    for row, other in zip(cells, confirmed, strict=True):
        if row["column"] == "e_tt":
            values = [shown(row[key]) for key in ("frictionless", "predicted")]
            more = [shown(row[key]) for key in ("explained", "held_out")]
            off = "-" if row["held_out"] is None else f"{row['held_out'] - row['thesis']:+.1f}"
            span = f"{shown(row['low'])} to {shown(row['high'])}"
            name = f"{row['table']}, {row['row']}" + (" (fitted)" if row["calibration"] else "")
            lines.append(
                (name, f"{row['thesis']:.1f}", *values, span, *more, off, shown(other["held_out"]))
            )
    head = ("experiment", "measured", "frictionless", "predicted", "range", "explained", "held out")
    return table((*head, "off", "mechanism, held out"), lines)


def _others(cells: list[Row]) -> str:
    lines = [
        (
            f"{row['table']}, {row['row']}",
            f"{row['column']} [{COLUMNS[row['column']][1]}]",
            f"{row['thesis']:.4g}",
            *(shown(row[key]) for key in KEYS),
        )
        for row in cells
        if row["column"] != "e_tt"
    ]
    heads = (*KEYS[:-1], "held out")
    return table(("experiment", "quantity", "measured", *heads), lines, words=(0, 1))


def shown(value: float | None) -> str:
    """A value to three digits; a dash where there is none."""
    return "-" if value is None else f"{value:.3g}"


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
    write_text(HERE / "experiments.md", page(cells, confirmed))


if __name__ == "__main__":
    main()
