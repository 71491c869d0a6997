"""The explanation of chapter 9 as the second part of the page on the experiments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers.observers.kalman import NOISE
from twin.errors import RecordError
from twin.markdown import table
from twin.sim.encoders import COUNTS
from twin.thesis.experiments import instruments
from twin.thesis.experiments.deciding import Outcome
from twin.thesis.experiments.deciding_page import deciding
from twin.thesis.experiments.explained import errors, goals, ratios, stored
from twin.thesis.experiments.explanation import PARAMETERS
from twin.thesis.experiments.hypotheses import HYPOTHESES
from twin.thesis.experiments.ingredients import LEFT_OUT, OTHERS, VariantResult
from twin.thesis.experiments.joint_friction import Loop
from twin.thesis.experiments.predict import Goal
from twin.thesis.experiments.tables import EARLY, LATE, SLIDING
from twin.writing import write_whole

HEADING = "# The thesis's experiments, explained"
INTRODUCTION = f"""\
{HEADING}

Written by `ballplate reproduce 9 --explained --doc docs/experiments.md`. What stands above is a
prediction: it knows three of the numbers it is compared with. This is an explanation: four numbers
fitted to all of Tables 9.1 to 9.9, on the exact equations, by
`ballplate reproduce 9 --explained --fit --keep`. It is judged by *held out* alone: each cell
computed with numbers that were fitted without its table. The ingredients were chosen with all
tables in sight, from some hundred hypotheses and a thousand combinations that another simulator had
gone through; leaving a table out guards the numbers, not the choice of the ingredients.

- **Friction**: the rolling friction, as before.
- **Without predictor**: the factor by which friction is larger in Tables 9.2, 9.4, 9.6 and 9.8.
- **Start**: the length of the polynomial start of the circles, the same at all frequencies. The
  thesis prints none; the prediction has three quarters of a turn.
- **Play** between motor and plate, its whole width, as plate angle.
- The sliding mode has case 2 of Table 8.10, which the text calls its choice, in place of the
  printed settings, which cannot all be the rig's: with alpha = 1.5 no u1 of 1.549 is possible.
"""


def write(
    path: Path,
    cells: Sequence[dict[str, Any]],
    confirmed: Sequence[dict[str, Any]],
    variants: Sequence[VariantResult],
    outcomes: Sequence[Outcome],
    starts: Sequence[tuple[str, str, float, float, float]],
    found: Sequence[Loop],
) -> None:
    """Put the explanation after the prediction on its page, in place of the former one.

    Args:
        path: Of the page.
        cells: On the exact equations.
        confirmed: On the mechanism.
        variants: With ingredients left out and hypotheses put in.
        outcomes: What records would show.
        starts: What each run would ask for alone.
        found: What a slow triangle shows on mechanisms with dry friction.

    Raises:
        RecordError: If a file cannot be read or written.
    """
    try:
        text = path.read_text(encoding="utf-8") if path.exists() else ""
    except (OSError, UnicodeDecodeError) as error:
        raise RecordError(f"cannot read {path}: {error}") from error
    parts = [
        INTRODUCTION,
        *_instruments(),
        *_parameters(),
        *_goals(goals(cells), goals(confirmed)),
        *_tracking(cells, confirmed),
        *_variants(variants),
        *_unexplained(cells, starts),
        *deciding(outcomes, variants, found),
        *_maxima(cells, confirmed),
    ]
    page = prediction(text) + "\n".join(parts).rstrip() + "\n"
    write_whole(path, lambda target: target.write_text(page, encoding="utf-8"))


def prediction(text: str) -> str:
    """The first part of a page, with an empty line after it."""
    first = text.partition(f"\n{HEADING}")[0].rstrip()
    return f"{first}\n\n" if first else ""


def explanation(text: str) -> str:
    """The second part of a page; empty if it has none."""
    _, found, rest = text.partition(f"\n{HEADING}")
    return f"\n{HEADING}{rest}" if found else ""


def _instruments() -> list[str]:
    printed, own = instruments.printed_ratio(), instruments.own_ratio()
    soon, late = instruments.turned(1.0), instruments.turned(10.0)
    known = math.degrees(math.sqrt(NOISE[1]))
    return [
        "## Encoders and 'disturbance': two defaults of the twin\n",
        f"- **Plate encoders of {COUNTS} counts a turn.** The 48 printed plate angles are "
        f"{instruments.off_counts(COUNTS):.3f} counts from whole ones, as much as printing four "
        f"digits rounds; with 16384 (4096 pulses, fourfold) they are "
        f"{instruments.off_counts(16384):.2f} off, with any smaller number 0.03 or more. 245760 is "
        "15 times 16384: gears or interpolation between disc and counter.",
        "- **No disturbance.** What Table B.1 calls one is the variance of *control efforts* in a "
        "static state (caption of Fig. B.3). Their deviations are "
        f"{printed[0]:.1f} and {printed[1]:.1f} times those of the touch screen on x and y; LQR "
        f"(100, 0.1) behind observer (8.1) at 2 ms answers the screen's white noise with "
        f"{own[0]:.1f} and {own[1]:.1f} times. So it is the controller's output, and a twin that "
        "adds it to its own controller's counts it twice. A real one could not hide either: on "
        f"drives that follow rates it would turn a plate at rest by {soon[0]:.3f} deg in 1 s and "
        f"{late[0]:.2f} deg in 10 s, and Table B.1 found {known:.4f} deg. The other reading is "
        "`disturbance.variance = [1.0816e-4, 2.8090e-5]`; the thesis's own simulations of chapter "
        "8 had it, and `ballplate reproduce` has it there.\n",
    ]


def _parameters() -> list[str]:
    known = stored()
    lines = []
    for name, about in PARAMETERS.items():
        folds = [fold[name] for fold in known["without"].values()]
        each = known["estimates"][name]
        lines.append(
            (
                name.replace("_", " "),
                f"{known['all'][name]:.4g}",
                f"{each['low']:.3g} to {each['high']:.3g}",
                f"{min(folds):.3g} to {max(folds):.3g}",
                about.unit or "1",
                each["verdict"],
            )
        )
    head = ("number", "value", "95 %, bootstrap", "without one table", "unit", "verdict")
    names = list(PARAMETERS)
    pairs = [
        (abs(value), f"{names[i]} and {names[j]} {value:+.2f}".replace("_", " "))
        for i, line in enumerate(known["correlation"])
        for j, value in enumerate(line[:i])
    ]
    ends = [each["chi2"] for each in known["searches"].values()]
    return [
        "## The four numbers\n",
        table(head, lines),
        f"Largest correlations: {', '.join(text for _, text in sorted(pairs)[::-1][:3])}. "
        f"{len(ends)} searches with different random numbers ended at chi-squared "
        f"{', '.join(f'{end:.1f}' for end in ends)} of 124 numbers; scales: 2 points, 0.35 in the "
        "logarithm of a maximum, and for Table 9.1 6 mm, 2 %, 0.2 and 0.1. They were chosen near "
        "what remains, so chi-squared compares models and tests none.\n",
    ]


def _goals(exact: Sequence[Goal], mechanism: Sequence[Goal]) -> list[str]:
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


def _tracking(cells: Sequence[dict[str, Any]], confirmed: Sequence[dict[str, Any]]) -> list[str]:
    lines = [
        (
            f"{cell['table']}, {cell['row']}",
            f"{cell['thesis']:.1f}",
            *(
                _shown(value)
                for value in (
                    cell["predicted"],
                    cell["explained"],
                    cell["held_out"],
                    other["held_out"],
                )
            ),
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


def _variants(variants: Sequence[VariantResult]) -> list[str]:
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


def _factor(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> str:
    return f"{math.exp(float(np.median(ratios(rows, columns, 'explained')))):.2f}"


def _unexplained(
    cells: Sequence[dict[str, Any]], starts: Sequence[tuple[str, str, float, float, float]]
) -> list[str]:
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
        f"{_shown(step['explained'])}.\n",
    ]


def _maxima(cells: Sequence[dict[str, Any]], confirmed: Sequence[dict[str, Any]]) -> list[str]:
    lines = [
        (
            f"{cell['table']}, {cell['row']}",
            cell["column"],
            f"{cell['thesis']:.4g}",
            *(
                _shown(value)
                for value in (
                    cell["predicted"],
                    cell["explained"],
                    cell["held_out"],
                    other["held_out"],
                )
            ),
        )
        for cell, other in zip(cells, confirmed, strict=True)
        if cell["column"] != "e_tt"
    ]
    head = (
        *("experiment", "quantity", "measured", "predicted", "explained", "held out"),
        "mechanism, held out",
    )
    return ["## Stabilisation, angles and efforts explained\n", table(head, lines)]


def _shown(value: float | None) -> str:
    return "lost" if value is None else f"{value:.3g}"
