"""Every cell of Tables 9.1 to 9.9: predicted, explained, and explained without its table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.fit.fit import FitResult
from twin.fit.runs import Runs, Sample
from twin.study.store import Store
from twin.thesis import tables as numbered
from twin.thesis.experiments.explanation import INDICATORS, PARAMETERS, table
from twin.thesis.experiments.predict import Goal, Prediction
from twin.thesis.experiments.tables import EARLY, LATE, SLIDING, chosen
from twin.writing import write_whole

MECHANISM = ("plant.kind=mujoco", "plant.step=0.001")
"""What the explanation is confirmed on."""


def stored() -> dict[str, Any]:
    """The fit as ``write`` left it: ``all``, ``without`` a table each, ``estimates`` and more."""
    return numbered.data(__package__, "explained")


def sample(values: dict[str, float]) -> Sample:
    """Parameters by name in the order of the table."""
    return tuple(float(values[name]) for name in PARAMETERS)


def rows(
    predicted: Sequence[Prediction],
    tables: Iterable[str] = (),
    *,
    mechanism: bool = False,
    fitted: dict[str, Any] | None = None,
    advance: Callable[[float], None] = lambda _: None,
) -> list[dict[str, Any]]:
    """One dictionary per cell, in the thesis's order.

    Its keys: table, row, column, thesis, predicted, explained, held_out, note.
    ``predicted`` knows one number from Table 9.3, ``explained`` those fitted to all tables,
    ``held_out`` those fitted to all but the cell's own. A value is None where the ball was lost.

    Args:
        predicted: The cells as predicted; others have None there.
        tables: Their numbers; none for all.
        mechanism: Whether on the MuJoCo mechanism; the numbers are fitted on the exact equations.
        fitted: The fit, as ``stored``, which is the default.
        advance: Called with the share done, 0 to 1.

    Raises:
        ScenarioError: If there is no such table.
    """
    experiments = chosen(tables)
    known = stored() if fitted is None else fitted
    about = table(overrides=MECHANISM if mechanism else ())
    places = {each.label: place for place, each in enumerate(about.experiments)}
    whole = sample(known["all"])
    wanted = []
    for each in experiments:
        place = places[f"{each.table}, {each.name}"]
        wanted += [(whole, place), (sample(known["without"][each.table]), place)]
    with TemporaryDirectory() as folder:
        found = Runs(about, Store(Path(folder))).indicators(wanted)
    advance(1.0)
    before = {(row["table"], row["row"], row["column"]): row for row in predicted}
    cells = []
    for index, each in enumerate(experiments):
        explained, held_out = (found[item] for item in wanted[2 * index : 2 * index + 2])
        for column, indicator in INDICATORS.items():
            if column not in each.cells:
                continue
            old = before.get((each.table, each.name, column))
            cells.append(
                {
                    "table": each.table,
                    "row": each.name,
                    "column": column,
                    "thesis": each.cells[column],
                    "predicted": None if old is None else old["predicted"],
                    "explained": _number(explained[indicator]),
                    "held_out": _number(held_out[indicator]),
                    "note": each.notes.get(column, "") if old is None else old["note"],
                }
            )
    return cells


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def ratios(rows: Sequence[dict[str, Any]], columns: Sequence[str], key: str) -> Array:
    """Logarithms of computed over measured of columns of 9.2 to 9.9."""
    return np.array(
        [
            math.log(row[key] / row["thesis"]) if row[key] else math.nan
            for row in rows
            if row["column"] in columns and row["table"] != "9.1"
        ]
    )


def errors(rows: Sequence[dict[str, Any]], tables: Sequence[str], key: str) -> Array:
    """Tracking errors of tables in %, in the order of the rows; ``thesis`` for the measured."""
    return np.array(
        [
            math.nan if row[key] is None else row[key]
            for row in rows
            if row["column"] == "e_tt" and row["table"] in tables
        ]
    )


def goals(rows: Sequence[dict[str, Any]], key: str = "held_out") -> list[Goal]:
    """The goals of the explanation, judged on all cells of one kind."""
    off = np.abs(errors(rows, LATE + EARLY, key) - errors(rows, LATE + EARLY, "thesis"))
    six = np.abs(errors(rows, SLIDING, key) - errors(rows, SLIDING, "thesis"))
    found = [
        _most("24 tracking errors: mean absolute deviation, points", float(off.mean()), 1.6),
        _most("none of the 24 beyond, points", float(off.max()), 4.0),
        _most("sliding mode: mean absolute deviation, points", float(six.mean()), 2.1),
    ]
    for name, columns, most in (
        ("plate angles", ("phi_max", "theta_max"), 1.4),
        ("efforts", ("u1_max", "u2_max"), 1.5),
    ):
        log = ratios(rows, columns, key)
        found.append(_most(f"{name}: scatter of a cell, factor", math.exp(log.std()), most))
        middle = math.exp(float(np.median(log)))
        found.append(
            Goal(f"{name}: median within 10 %", f"{middle:.2f}", abs(math.log(middle)) <= 0.0954)
        )
    for name, late, early in (
        ("all laws", LATE, EARLY),
        ("sliding mode aside", LATE[:-1], EARLY[:-1]),
    ):
        gap, measured = (_gap(rows, which, late, early) for which in (key, "thesis"))
        sentence = (
            f"errors without predictor less with, {name}: +1.5 to +2.5 points "
            f"(measured {measured:+.2f})"
        )
        found.append(Goal(sentence, f"{gap:+.2f}", 1.5 <= gap <= 2.5))
    return found


def _gap(
    rows: Sequence[dict[str, Any]], key: str, late: Sequence[str], early: Sequence[str]
) -> float:
    """By how much tracking errors of some tables exceed those of others on average, points."""
    return float(errors(rows, late, key).mean() - errors(rows, early, key).mean())


def _most(what: str, value: float, most: float) -> Goal:
    return Goal(f"{what}: at most {most:g}", f"{value:.3f}", value <= most)


def write(found: FitResult, path: Path) -> None:
    """Write a fit as TOML, for ``stored``.

    Raises:
        RecordError: If the file cannot be written.
    """
    names = list(found.table.parameters)

    def values(x: Sample) -> list[str]:
        return [f"{name} = {value:g}" for name, value in zip(names, x, strict=True)]

    lines = [
        "# Fitted to all of Tables 9.1 to 9.9, and to all but one each, on the exact equations by",
        "# `ballplate reproduce 9 --explained --fit --out FILE`; units as in explanation.py.",
        f"chi2 = {found.chi2:.2f}",
        f"runs = {found.runs}",
        "correlation = ["
        + ", ".join(
            "[" + ", ".join(f"{v:.3f}" for v in line) + "]" for line in found.correlation.tolist()
        )
        + "]",
        "\n[all]",
        *values(found.best),
    ]
    for group, fold in found.folds.items():
        lines += [f'\n[without."{group}"]', *values(fold)]
    for each in found.estimates:
        lines += [f"\n[estimates.{each.name}]"]
        lines += [f"{end} = {getattr(each, end):.4g}" for end in ("low", "high")]
        lines += [f'verdict = "{each.verdict}"']
    for number, (chi2, end) in enumerate(found.ends, 1):
        lines += [f"\n[searches.{number}]", f"chi2 = {chi2:.2f}", *values(end)]
    text = "\n".join(lines) + "\n"
    write_whole(path, lambda target: target.write_text(text, encoding="utf-8"))
