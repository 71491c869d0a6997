"""The explanation of chapter 9 as a page beside that on the prediction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.thesis.experiments import cells_page, ingredients_page, numbers_page
from twin.thesis.experiments.deciding import Outcome
from twin.thesis.experiments.deciding_page import deciding
from twin.thesis.experiments.explained import goals
from twin.thesis.experiments.ingredients import VariantResult
from twin.thesis.experiments.joint_friction import Loop
from twin.writing import write_whole

INTRODUCTION = """\
# The thesis's experiments, explained

Written by `ballplate reproduce 9 --explained --doc docs/explained.md`.
[What the twin predicts](experiments.md) is a prediction: it knows three of the numbers it is
compared with. This is an explanation: four numbers
fitted to all of Tables 9.1 to 9.9, on the exact equations, by
`ballplate reproduce 9 --explained --fit --out FILE`. It is judged by *held out* alone: each cell
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
    """Write the page.

    Args:
        path: Of the page.
        cells: On the exact equations.
        confirmed: On the mechanism.
        variants: With ingredients left out and hypotheses put in.
        outcomes: What records would show.
        starts: What each run would ask for alone.
        found: What a slow triangle shows on mechanisms with dry friction.

    Raises:
        RecordError: If it cannot be written.
    """
    parts = [
        INTRODUCTION,
        *numbers_page.defaults(),
        *numbers_page.parameters(),
        *cells_page.verdict(goals(cells), goals(confirmed)),
        *cells_page.tracking(cells, confirmed),
        *ingredients_page.variants(variants),
        *ingredients_page.unexplained(cells, starts),
        *deciding(outcomes, variants, found),
        *cells_page.maxima(cells, confirmed),
    ]
    page = "\n".join(parts).rstrip() + "\n"
    write_whole(path, lambda target: target.write_text(page, encoding="utf-8"))
