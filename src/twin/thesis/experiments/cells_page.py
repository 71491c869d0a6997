"""The explanation of chapter 9 cell by cell, as sections of its page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from twin.markdown import table
from twin.thesis.experiments.predict import Goal


def verdict(exact: Sequence[Goal], mechanism: Sequence[Goal]) -> list[str]:
    """Which goals are reached on the exact equations and on the mechanism."""
    lines = [
        (
            one.sentence,
            one.found,
            "reached" if one.reached else "**not reached**",
            other.found,
            "reached" if other.reached else "**not reached**",
        )
        for one, other in zip(exact, mechanism, strict=True)
    ]
    head = ("goal, of the held-out cells", "exact equations", "", "mechanism", "")
    return [
        "## Verdict\n",
        table(head, lines),
        "The mechanism runs with the numbers fitted on the exact equations.\n",
    ]


def _levels(cell: dict[str, Any], other: dict[str, Any]) -> Iterator[str]:
    """A cell predicted, explained and held out, and held out on the mechanism."""
    exact = (cell[level] for level in ("predicted", "explained", "held_out"))
    return map(shown, (*exact, other["held_out"]))


def tracking(cells: Sequence[dict[str, Any]], confirmed: Sequence[dict[str, Any]]) -> list[str]:
    """Tracking errors on the exact equations and, held out, on the mechanism."""
    lines = [
        (
            f"{cell['table']}, {cell['row']}",
            f"{cell['thesis']:.1f}",
            *_levels(cell, other),
            "-" if cell["held_out"] is None else f"{cell['held_out'] - cell['thesis']:+.1f}",
        )
        for cell, other in zip(cells, confirmed, strict=True)
        if cell["column"] == "e_tt"
    ]
    head = (
        *("experiment", "measured", "predicted", "explained", "held out"),
        *("mechanism, held out", "off"),
    )
    return ["## Tracking errors explained, in %\n", table(head, lines)]


def maxima(cells: Sequence[dict[str, Any]], confirmed: Sequence[dict[str, Any]]) -> list[str]:
    """The same of all other quantities."""
    lines = [
        (
            f"{cell['table']}, {cell['row']}",
            cell["column"],
            f"{cell['thesis']:.4g}",
            *_levels(cell, other),
        )
        for cell, other in zip(cells, confirmed, strict=True)
        if cell["column"] != "e_tt"
    ]
    head = (
        *("experiment", "quantity", "measured", "predicted", "explained", "held out"),
        "mechanism, held out",
    )
    return ["## Stabilisation, angles and efforts explained\n", table(head, lines)]


def shown(value: float | None) -> str:
    """A value to three digits, or that the ball was lost."""
    return "lost" if value is None else f"{value:.3g}"
