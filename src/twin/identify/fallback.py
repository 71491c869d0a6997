"""Answers by a plain linear model where the full one does not show the gain of an axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.identify.first_look import look_at_rolling, look_plainly_in_several_ways
from twin.identify.logs import AxisLog
from twin.identify.parameters import plain_parameter
from twin.identify.verdicts import (
    GIVEN_VERDICT,
    IDENTIFIED_VERDICT,
    NOT_IDENTIFIABLE,
    PLAIN_VERDICT,
    ParameterVerdict,
)

PLAIN_WHY = "by the plain linear model, as the full one does not show the gain"
"""Reason of a verdict of the plain model."""


def assess_plainly(
    log: AxisLog, axis: str, unit: str, verdicts: Sequence[ParameterVerdict]
) -> tuple[list[ParameterVerdict], list[str]]:
    """Verdicts with those of the plain linear model where the full one does not show the gain.

    Their intervals hold what windows of several lengths give, with damping and without: as far as
    these differ, the plain model is in error.

    Args:
        log: The axis.
        axis: x or y.
        unit: Unit of the tilt.
        verdicts: Of the full model.

    Returns:
        All verdicts, and a note on what was done.
    """
    words = {each.name: each.word for each in verdicts}
    looks = look_plainly_in_several_ways(log)
    if log.stops is not None and (rolling := look_at_rolling(log)):
        looks = [rolling]  # between walls its windows are short enough
    if words[f"gain_{axis}"] == IDENTIFIED_VERDICT or not looks:
        return list(verdicts), []
    first, found = looks[0], {}
    attributes = {"gain": "gain", "delay": "delay", "level": "level"}
    if first.damping:
        attributes["viscous"] = "damping"
    for name, attribute in attributes.items():
        spans = [
            (value - 2 * std, value + 2 * std)
            for value, std in (
                (getattr(each, attribute), getattr(each, f"{attribute}_std")) for each in looks
            )
        ]
        low, high = min(each[0] for each in spans), max(each[1] for each in spans)
        about, value = plain_parameter(name, unit), getattr(first, attribute)
        narrow = (high - low) / 2 <= max(about.tolerance, about.relative * abs(value))
        found[name] = ParameterVerdict(
            about=about,
            name=f"{name}_{axis}",
            value=value,
            low=low,
            high=high,
            word=IDENTIFIED_VERDICT if narrow else PLAIN_VERDICT,
            why=PLAIN_WHY,
        )
    kept = [
        replace(each, value=None, word=NOT_IDENTIFIABLE, why=f"{PLAIN_WHY}; {each.why}")
        for each in verdicts
        if each.name.rpartition("_")[0] not in found and each.word != GIVEN_VERDICT
    ]
    given = [each for each in verdicts if each.word == GIVEN_VERDICT]
    share = 100 * first.explained
    note = (
        f"{axis}: the full model does not show the gain of this log; gain, dead time + lag, level "
        f"and damping are those of a plain linear model by the weak form, which explains "
        f"{share:.0f} % of the motion in {first.windows} windows; dead time from lag, friction "
        "from damping, and play or dead band are not told apart"
    )
    return [*found.values(), *kept, *given], [note]
