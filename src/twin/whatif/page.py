"""The page of several futures: the picture of all, and how well the twin knows where they begin."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence

from twin.html import render
from twin.whatif.future import Future
from twin.whatif.moment import LOOK_BACK, Moment

POOR = 5.0
"""Millimetres that twin and record may be apart before a branch that is to be trusted."""


def agreement(moment: Moment) -> str:
    """How well the twin knows where the futures begin, in words."""
    state = "the run's own state" if moment.exact else "the state estimated from the log"
    begins = f"{moment.name} from {moment.at:g} s on, {state}"
    if moment.before_mm is None:
        return begins
    return (
        f"{begins}; in the second before, twin and record are {moment.before_mm:.2g} mm apart at "
        "most"
    )


def page(moment: Moment, found: Sequence[Future], picture: bytes) -> str:
    """One HTML file that needs nothing else.

    Args:
        moment: Where the futures begin.
        found: The futures.
        picture: Record and futures over each other, as PNG.
    """
    measured = [each.run.metrics for each in found]
    names = [name for name, value in measured[0].items() if isinstance(value, float)]
    before, sentences = moment.before_mm, [f"{agreement(moment)}."]
    if before is None:
        sentences.append(
            f"There is no whole {LOOK_BACK:g} s before it to compare twin and record over: nothing "
            "says whether the twin is right."
        )
    elif before > POOR:
        sentences.append(
            f"That is more than {POOR:g} mm: the twin does not fit, and a future is no better."
        )
    rows = [
        {
            "label": each.label,
            "apart": "-" if each.max_difference is None else f"{1000 * each.max_difference:.3g}",
            "metrics": [_short(values.get(name)) for name in names],
        }
        for each, values in zip(found, measured, strict=True)
    ]
    return render(
        "whatif/report.html.j2",
        title=f"What if: {moment.name} from {moment.at:g} s on",
        trusted=before is not None and before <= POOR,
        sentences=sentences,
        picture=b64encode(picture).decode(),
        metrics=names,
        rows=rows,
        notes=moment.notes,
    )


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "-"
