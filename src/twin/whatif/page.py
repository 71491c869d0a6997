"""The page of several futures: the picture of all, and how well the twin knows where they begin."""

from __future__ import annotations

from collections.abc import Sequence

from twin.page import Block, Picture, Text, Verdict, digits, html
from twin.report.numbers import IndicatorRow, all_rows, indicators
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
    found_rows = all_rows([each.run.metrics for each in found])
    apart = tuple(digits(each.max_difference, "mm") for each in found)
    found_rows.append(IndicatorRow("most from the record", "mm", apart))
    title = f"What if: {moment.name} from {moment.at:g} s on"
    blocks: list[Block] = [
        Verdict(sentences, before is not None and before <= POOR),
        Picture("Record and futures", picture),
        indicators("The futures", found_rows, [each.label for each in found]),
    ]
    if moment.notes:
        blocks.append(Text(moment.notes, "The record"))
    return html(title, blocks)
