"""What each ingredient explains and what stays unexplained, as sections of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from twin.markdown import table
from twin.thesis.experiments.cells_page import shown
from twin.thesis.experiments.explained import errors, ratios, stored
from twin.thesis.experiments.hypotheses import HYPOTHESES
from twin.thesis.experiments.ingredients import LEFT_OUT, OTHERS, VariantResult
from twin.thesis.experiments.tables import EARLY, LATE, SLIDING


def variants(variants: Sequence[VariantResult]) -> list[str]:
    """The explanation with one thing left out, or another put in."""
    whole = variants[0].chi2
    lines = []
    for each in variants:
        off = errors(each.rows, LATE + EARLY, "explained") - errors(
            each.rows, LATE + EARLY, "thesis"
        )
        six = errors(each.rows, SLIDING, "explained") - errors(each.rows, SLIDING, "thesis")
        gap = (
            errors(each.rows, LATE, "explained").mean()
            - errors(each.rows, EARLY, "explained").mean()
        )
        rest = next(row for row in each.rows if row["column"] == "e_ss")["explained"]
        lines.append(
            (
                each.variant.name,
                f"{each.chi2:.0f}",
                f"{each.chi2 - whole:+.0f}",
                f"{np.abs(off).mean():.2f}",
                f"{np.abs(six).mean():.2f}",
                f"{gap:+.1f}",
                _factor(each.rows, ("phi_max", "theta_max")),
                _factor(each.rows, ("u1_max", "u2_max")),
                f"{1000 * rest:.0f}",
                ", ".join(f"{name.replace('_', ' ')} {v:.3g}" for name, v in each.values.items()),
            )
        )
    head = (
        *("variant", "chi2", "more", "e_tt off", "sliding off", "gap", "angles x", "efforts x"),
        *("9.1 e_ss [mm]", "fitted again"),
    )
    return [
        "## What each ingredient explains, and what the data reject\n",
        f"The explanation with one thing left out ({len(LEFT_OUT)} variants), then with another "
        f"hypothesis put in ({len(OTHERS)} variants; {len(HYPOTHESES)} more stand above, each "
        "beside friction alone), all that remains fitted again to all tables. *Gap*: errors "
        "without predictor less those with, all laws, measured +2.4. *Angles*, *efforts*: median "
        "of computed over measured maxima; measured e_ss 15 mm. The first row is the "
        f"explanation itself fitted on from the stored numbers ({stored()['chi2']:.1f}): what is "
        "below that is how far the stored search was from the end of a flat valley.\n",
        table(head, lines),
    ]


def unexplained(
    cells: Sequence[dict[str, Any]], starts: Sequence[tuple[str, str, float, float, float]]
) -> list[str]:
    """Where it is farthest off, and what each run would ask for."""
    circles = [cell for cell in cells if cell["column"] == "e_tt" and cell["held_out"] is not None]
    off = [float(cell["held_out"] - cell["thesis"]) for cell in circles]
    worst = sorted(zip(off, circles, strict=True), key=lambda item: -abs(item[0]))[:5]
    named = ", ".join(f"{cell['table']} at {cell['row']} ({by:+.1f})" for by, cell in worst)
    angles = ratios(cells, ("phi_max", "theta_max"), "explained")
    measured = np.log(
        [
            c["thesis"]
            for c in cells
            if c["column"] in ("phi_max", "theta_max") and c["table"] != "9.1"
        ]
    )
    step = next(c for c in cells if c["table"] == "9.1" and c["column"] == "phi_max")
    lengths = [each[2] for each in starts]
    own = math.sqrt(sum(each[3] for each in starts) / (2 * len(starts)))
    common = math.sqrt(sum(each[4] for each in starts) / (2 * len(starts)))
    return [
        "## What stays unexplained\n",
        f"- Tracking errors farthest off, in points: {named}.",
        f"- The pattern of the angle maxima from cell to cell: they scatter by a factor "
        f"{math.exp(angles.std()):.2f} about the explanation and by "
        f"{math.exp(measured.std()):.2f} about one constant, so it explains their level "
        "and not which run has more.",
        f"- A start of its own for each run, of {min(lengths):g} to {max(lengths):g} s, would "
        f"bring the root mean square of their logarithms from {common:.2f} to {own:.2f}, at "
        f"the price of {len(starts)} more numbers for {2 * len(starts)} cells: no explanation.",
        f"- Table 9.1: phi_max measured {step['thesis']:.2f} deg, explained "
        f"{shown(step['explained'])}.\n",
    ]


def _factor(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> str:
    return f"{math.exp(float(np.median(ratios(rows, columns, 'explained')))):.2f}"
