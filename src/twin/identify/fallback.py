"""Answers by a first look at an axis where the full model leaves its gain open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from twin.base.errors import plural
from twin.identify.axis_logs import AxisLog
from twin.identify.axis_selection import DELAYS_S
from twin.identify.first_look import (
    FirstLook,
    find_possible_linkages,
    join_looks,
    look_at_any_motion,
    look_at_rolling_in_several_ways,
)
from twin.identify.parameters import plain_parameter
from twin.identify.verdicts import (
    GIVEN_VERDICT,
    IDENTIFIED_VERDICT,
    NOT_IDENTIFIABLE,
    PLAIN_VERDICT,
    ParameterVerdict,
)
from twin.identify.weak_form import WEAK_FORM, WeakForm

PLAIN_WHY = "by a plain model; the interval holds its variants"
"""Reason of a verdict by windows of any motion."""
ROLLING_WHY = (
    "by short windows of a ball that rolls in one direction; the interval holds several lengths of "
    "them, with camber, damping or neither, levers and plays"
)
"""Reason of a verdict by windows between end stops."""
FULL_MODEL_NAMES = {"damping": "viscous"}
"""Parameters of the full model by terms of a look that have another name."""
INTERCHANGEABLE_PARAMETERS = ("friction", "viscous")
"""Parameters that a look takes for each other: it has one of them, however narrow its interval."""
OPEN_WHY = "the full model leaves the gain open, and the model that shows it has none of this"
"""Reason of a verdict on a parameter that only the full model has."""


def assess_plainly(
    log: AxisLog,
    axis: str,
    unit: str,
    verdicts: Sequence[ParameterVerdict],
    form: WeakForm = WEAK_FORM,
    look: FirstLook | None = None,
) -> tuple[list[ParameterVerdict], list[str]]:
    """Verdicts with those of first looks where the full model leaves the gain open.

    Without end stops the windows hold any motion. The intervals then hold what windows of several
    lengths give, with damping and without, with friction, camber and every lever and play that
    explains them, and what those windows alone give in which the ball hardly rests: as far as these
    differ, a model is in error, or the log does not show the gain. Between end stops shorter
    windows, of a ball that rolls in one direction, give friction and camber instead of damping; the
    intervals hold what several lengths of these give, with camber, damping or neither, levers and
    plays. No interval reaches below zero where the quantity cannot: friction, damping, a command's
    delay.

    Args:
        log: The axis.
        axis: x or y.
        unit: Unit of the tilt.
        verdicts: Of the full model.
        form: Constants of the looks.
        look: A first look at the log, which is not repeated where it is the one that answers.

    Returns:
        All verdicts, and a note on what was done.
    """
    words = {each.name: each.word for each in verdicts}
    if words[f"gain_{axis}"] == IDENTIFIED_VERDICT:
        return list(verdicts), []
    tried = find_possible_linkages(log)
    rolling = log.stops is not None and look_at_rolling_in_several_ways(log, tried, form)
    first, found = look, dict[str, ParameterVerdict]()
    if rolling or log.stops or not (look and look.plain):
        first = join_looks(rolling or look_at_any_motion(log, tried, form))
    if first is None:
        return list(verdicts), []
    why = PLAIN_WHY if first.plain else ROLLING_WHY
    for name in ("gain", "delay", "level", *first.terms):
        low, high = first.interval(name)
        key = FULL_MODEL_NAMES.get(name, name)
        about = plain_parameter(key, unit, held=log.held)
        value = getattr(first, name)
        narrow = key not in INTERCHANGEABLE_PARAMETERS and (
            high - low
        ) / 2 <= about.allowed_half_width(value)
        least = {"friction": 0.0, "viscous": 0.0, "delay": DELAYS_S[log.held][0]}.get(key, low)
        found[key] = ParameterVerdict(
            about=about,
            name=f"{key}_{axis}",
            value=value,
            low=max(low, least),
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
    share, windows = 100 * look.explained, plural(look.windows, "window")
    begin = f"{axis}: the full model leaves the gain of this log open"
    terms = f"level, {' and '.join(look.terms)}" if look.terms else "level"
    if not look.plain:
        return (
            f"{begin}. A ball that rolls in one direction between end stops shows it by the weak "
            f"form: gain, dead time + lag, {terms} are those of its motion, "
            f"{share:.0f} % of which they explain in {windows}; dead time from lag, "
            "damping from friction, and play from dead band are not told apart. The intervals "
            "hold what windows of several lengths give, with camber, damping or neither, and with "
            "each lever and play that explains them"
        )
    return (
        f"{begin}: its terms make up for each other, or it is in error. A plain model by the weak "
        f"form shows it: gain, dead time + lag, {terms} are those of this model, which explains "
        f"{share:.0f} % of the motion in {windows}; dead time from lag, friction from "
        "damping, and play from dead band are not told apart. The intervals hold what the model "
        "gives with damping, with friction and camber, with each lever and play that explains the "
        "log, and by windows in which the ball hardly rests"
    )
