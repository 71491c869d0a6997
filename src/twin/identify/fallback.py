"""Answers by a first look at an axis where the full model leaves its gain open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.base.errors import plural
from twin.identify.first_look import FirstLook, look_at_rolling, look_plainly_in_several_ways
from twin.identify.logs import AxisLog
from twin.identify.parameters import plain_parameter
from twin.identify.verdicts import (
    GIVEN_VERDICT,
    IDENTIFIED_VERDICT,
    NOT_IDENTIFIABLE,
    PLAIN_VERDICT,
    ParameterVerdict,
)

PLAIN_WHY = "by the plain linear model, whose variants its interval holds"
"""Reason of a verdict of the plain linear model."""
ROLLING_WHY = "by short windows of a ball that rolls in one direction"
"""Reason of a verdict by windows between end stops."""
OPEN_WHY = "the full model leaves the gain open, and the model that shows it has none of this"
"""Reason of a verdict on a parameter that only the full model has."""


def assess_plainly(
    log: AxisLog, axis: str, unit: str, verdicts: Sequence[ParameterVerdict]
) -> tuple[list[ParameterVerdict], list[str]]:
    """Verdicts with those of a first look where the full model leaves the gain open.

    Without end stops the look is the plain linear model. The intervals then hold what windows of
    several lengths give, with damping and without: as far as these differ, the model is in error.
    Between end stops only windows of a ball that rolls in one direction are short enough. They give
    friction and camber instead of damping, by windows of one length.

    Args:
        log: The axis.
        axis: x or y.
        unit: Unit of the tilt.
        verdicts: Of the full model.

    Returns:
        All verdicts, and a note on what was done.
    """
    words = {each.name: each.word for each in verdicts}
    if words[f"gain_{axis}"] == IDENTIFIED_VERDICT:
        return list(verdicts), []
    rolling = look_at_rolling(log) if log.stops is not None else None
    looks = [rolling] if rolling else look_plainly_in_several_ways(log)
    if not looks:
        return list(verdicts), []
    first, found = looks[0], {}
    why = PLAIN_WHY if first.plain else ROLLING_WHY
    attributes = {"gain": "gain", "delay": "delay", "level": "level"}
    if not first.plain:
        attributes |= {"friction": "friction", "camber": "camber"}
    elif first.damping:
        attributes["viscous"] = "damping"
    for name, attribute in attributes.items():
        spans = [
            (value - 2 * std, value + 2 * std)
            for value, std in (
                (getattr(each, attribute), getattr(each, f"{attribute}_std")) for each in looks
            )
        ]
        low, high = min(each[0] for each in spans), max(each[1] for each in spans)
        about, value = plain_parameter(name, unit, held=log.held), getattr(first, attribute)
        narrow = (high - low) / 2 <= max(about.tolerance, about.relative * abs(value))
        found[name] = ParameterVerdict(
            about=about,
            name=f"{name}_{axis}",
            value=value,
            low=low,
            high=high,
            word=IDENTIFIED_VERDICT if narrow else PLAIN_VERDICT,
            why=why,
        )
    kept = [
        replace(
            each,
            value=None,
            low=None,
            high=None,
            word=NOT_IDENTIFIABLE,
            why=f"{OPEN_WHY}; {each.why}",
        )
        for each in verdicts
        if each.name.rpartition("_")[0] not in found and each.word != GIVEN_VERDICT
    ]
    given = [each for each in verdicts if each.word == GIVEN_VERDICT]
    return [*found.values(), *kept, *given], [_describe_look(first, axis)]


def _describe_look(look: FirstLook, axis: str) -> str:
    """A note on the look that answers instead of the full model.

    Args:
        look: The look.
        axis: x or y.
    """
    share = 100 * look.explained
    if look.plain:
        return (
            f"{axis}: the full model leaves the gain of this log open: its terms make up for each "
            "other, or it is in error. A plain linear model by the weak form shows it: gain, dead "
            "time + lag, level and damping are those of this model, which explains "
            f"{share:.0f} % of the motion in {plural(look.windows, 'window')}; dead time from "
            "lag, friction from damping, and play or dead band are not told apart"
        )
    return (
        f"{axis}: the full model leaves the gain of this log open. A ball that rolls in one "
        "direction between end stops shows it by the weak form: gain, dead time + lag, level, "
        f"friction and camber are those of its motion, {share:.0f} % of which they explain in "
        f"{plural(look.windows, 'window')}; "
        "dead time from lag, damping from friction, and play or dead band are not told apart"
    )
