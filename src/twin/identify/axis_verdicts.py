"""Verdicts on the plain model of an axis: value, interval and reason of each parameter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from twin.base.page import digits
from twin.identify.axis_selection import AXIS_SELECTION, AxisSelection
from twin.identify.command_model import DRIVE_EFFECTS
from twin.identify.further_terms import append_delay, find_hidden_changes, find_term
from twin.identify.intervals import Estimate
from twin.identify.parameters import PLAIN_PARAMETERS, IdentifiedParameter, plain_parameter
from twin.identify.plain_model import AxisFit
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    GIVEN_VERDICT,
    IDENTIFIED_VERDICT,
    MAX_CORRELATION,
    NOT_IDENTIFIABLE,
    ParameterVerdict,
)

LEVER_HELD_MESSAGE = "held: the given height and 2/3 of a hollow, 2/5 of a solid ball's radius"
"""Message for a lever that is computed from the given height."""
DOUBTED_WHERE_NOT_WHITE = {
    "gain": "steps of a servo, or a ball that sticks, resemble another gain",
    "friction": "a friction that builds up over a way, or sticks, is another",
}
"""Parameters that an error of the model moves in all windows alike, and what may do so."""
AKAIKE_PENALTY = 2.0
"""What a term has to reduce twice the negative log-likelihood by, in Akaike's criterion."""


def assess_axis(
    fit: AxisFit, axis: str, unit: str, selection: AxisSelection = AXIS_SELECTION
) -> list[ParameterVerdict]:
    """Value, interval and verdict of each parameter of an axis."""
    names = fit.problem.names
    rows = (*names, *(("delay",) if "lag" in names else ()))
    own = _append_total_delay(fit)
    low, high = own.value - own.half_width, own.value + own.half_width
    reasons: list[list[str]] = [[] for _ in rows]
    checks = [(each, f"windows of {each.problem.longest:.1f} s") for each in fit.briefer]
    if fit.windowed:
        checks.insert(0, (fit.windowed, "windows of one level"))
    for check, label in checks:
        other = _append_total_delay(check)
        apart = np.abs(own.value - other.value)
        unlike = apart > np.hypot(own.half_width, other.half_width)
        low = np.where(unlike, np.minimum(low, other.value - other.half_width), low)
        high = np.where(unlike, np.maximum(high, other.value + other.half_width), high)
        word = f"{label} give a different value, which the interval includes: a model error"
        for k in np.flatnonzero(unlike).tolist():
            reasons[k].append(word)
    for what, changes in _find_left_out_terms(fit, selection):
        moved = changes[:, : len(rows)]
        low, high = low + moved.min(axis=0, initial=0.0), high + moved.max(axis=0, initial=0.0)
        for k in np.flatnonzero(np.abs(moved).max(axis=0) > own.half_width).tolist():
            reasons[k].append(f"the interval includes what {what} would change")
    for k, name in enumerate(names):
        if name in DOUBTED_WHERE_NOT_WHITE and not (fit.windowed or fit).explained:
            low[k], high[k] = low[k] - own.half_width[k], high[k] + own.half_width[k]
            reasons[k].append(
                "the residuals are not white, so its interval is twice as wide: "
                f"{DOUBTED_WHERE_NOT_WHITE[name]}"
            )
    rivals = {PLAIN_PARAMETERS[name].key: value for name, value in fit.rivals}
    for k, name in enumerate(rows):
        if rivals and name in DRIVE_EFFECTS:
            low[k] = 0.0
            reasons[k].append(f"{' or '.join(rivals)} instead explains the log nearly as well")
    alike = np.abs(own.correlation) > MAX_CORRELATION
    drawn = own.draws - own.value
    unfitted = [each for each in fit.profiles if each.name not in names]
    hidden = {each.name: each.deviations[each.name] for each in unfitted}
    shares = {  # of the scatter of each that is of what is not fitted
        name: (moved @ drawn) ** 2 / np.maximum((moved @ moved) * (drawn**2).sum(axis=0), 1e-300)
        for name, moved in hidden.items()
    }
    ends = [*np.transpose(fit.problem.bounds), (-np.inf, np.inf)]
    swing = fit.problem.tilt.scale
    scales = {"gain": 1 / swing, "dead_band": swing, "play": 2 * swing}
    found: list[ParameterVerdict] = []
    for k, name in enumerate(rows):
        others = [
            PLAIN_PARAMETERS[each].key for j, each in enumerate(names) if alike[k, j] and j != k
        ]
        others += [
            PLAIN_PARAMETERS[each].key
            for each, share in shares.items()
            if share[k] > selection.conditional_scatter_share
        ]
        values = (own.value[k], low[k], high[k])
        indistinct = [] if name == "delay" else others
        verdict = _assess_parameter(
            plain_parameter(name, unit, held=fit.log.held),
            f"{name}_{axis}",
            values,
            ends[k],
            reasons[k],
            indistinct,
            scales.get(name, 1.0),
        )
        verdict = _to_slew_rate(verdict, swing) if name == "slew" else verdict
        found.insert(3 if name == "delay" else k, verdict)
    found += [
        _bound_hidden(fit, name, axis, unit, moved, selection) for name, moved in hidden.items()
    ]
    if (lever := fit.log.lever) is not None:
        word, half = GIVEN_VERDICT, 2 * selection.fitting.drives.height_std_m
        given = replace(found.pop(), value=lever, word=word, why=LEVER_HELD_MESSAGE)
        found.append(replace(given, low=lever - half, high=lever + half))
    return found


def _find_left_out_terms(fit: AxisFit, selection: AxisSelection) -> list[tuple[str, Array]]:
    """What a fit has not, and by how much it may change the parameters.

    A term too small to be significant still moves the others: a damping, the delay. What resembles
    friction moves friction, damping and gain. Windows with a level of their own show neither.

    Args:
        fit: Of an axis, P parameters.
        selection: Constants.

    Returns:
        Each in words, and N changes that it may make, of the parameters and, last, of the whole
        delay, shape (N, P + 1); none for a term of an impossible sign, or one that the log does not
        show: Akaike's criterion is no better with it.
    """
    names, found = fit.problem.names, list[tuple[str, Array]]()
    if fit.problem.drift:
        return found
    for name in selection.optional_parameters:
        if name not in names:
            changes, std = find_term(fit, name)
            better = (changes[-1] / std) ** 2 > AKAIKE_PENALTY
            if better and changes[-1] > PLAIN_PARAMETERS[name].least:
                key = PLAIN_PARAMETERS[name].key
                changed = append_delay(changes[None, :-1], names)
                found.append((f"a {key} term too small to be fitted", changed))
    by_windows = fit.windowed or fit
    if "friction" in names and by_windows.problem.names == names:
        found += find_hidden_changes(by_windows)
    return found


def _bound_hidden(
    fit: AxisFit, name: str, axis: str, unit: str, moved: Array, selection: AxisSelection
) -> ParameterVerdict:
    """The verdict of a parameter that is not fitted: how much of it there may be.

    Args:
        fit: Of the axis.
        name: The parameter.
        axis: x or y.
        unit: Unit of the tilt.
        moved: Draws of it.
        selection: Constants.
    """
    probability, swing = selection.bound_probability, fit.problem.tilt.scale
    least, most = np.quantile(moved, (1 - probability, probability)).tolist()
    by = {"dead_band": swing, "play": 2 * swing}.get(name, 1.0)
    about = plain_parameter(name, unit, held=fit.log.held)
    none = ParameterVerdict.unknown(about, f"{name}_{axis}", "not distinguishable from zero")
    if (value := dict(fit.rivals).get(name)) is not None:
        most = max(most, (1 + about.relative) * value)
        why = f"it explains the log nearly as well as the fitted effect; {about.experiment}"
        none = replace(none, why=why)
    none = replace(none, low=by * min(least, 0.0), high=by * (most or abs(about.tried[1])))
    return _to_slew_rate(none, swing) if name == "slew" else none


def _to_slew_rate(found: ParameterVerdict, swing: float) -> ParameterVerdict:
    """A verdict of seconds by swing, as it is fitted, as one of a rate."""
    low, value, high = (
        swing / end if end else None for end in (found.high, found.value, found.low)
    )
    return replace(found, low=low, value=value, high=high)


def describe_lags(verdicts: Sequence[ParameterVerdict]) -> list[str]:
    """Notes on delays that a scenario has not: of a filter, and different ones of the axes.

    Args:
        verdicts: Of all axes with commands, by names as ``lag_x``.
    """
    known = {each.name: each for each in verdicts if each.word == IDENTIFIED_VERDICT}
    notes = []
    if {"lag_x", "lag_y", "delay_x", "delay_y"} & known.keys():
        notes.append(
            "a lag is that of the drives or of a filter of the positions: a log of commands cannot "
            "tell which, and parameters.toml gives it to the drives"
        )
    x, y = (known.get(f"delay_{axis}") for axis in "xy")
    if x and y and (max(x.low or 0, y.low or 0) > min(x.high or 0, y.high or 0)):
        notes.append(
            f"dead time + lag differ along x ({digits(x.value)} s) and y ({digits(y.value)} s): a "
            "scenario has one of each, and parameters.toml has their means"
        )
    return notes


def _append_total_delay(fit: AxisFit) -> Estimate:
    """The parameters and, last, the sum of dead time and lag: often known where neither is."""
    own = fit.estimate()
    if "lag" not in fit.problem.names:
        return own
    names = fit.problem.names
    pair = [names.index(name) for name in ("dead_time", "lag")]
    return Estimate(
        append_delay(own.value[None], names)[0],
        append_delay(own.draws, names),
        np.append(own.identifiable, own.identifiable[pair].all()),
        np.append(own.degrees_of_freedom, own.degrees_of_freedom[pair].min()),
        np.append(own.noise, 0.0),
    )


def _assess_parameter(
    about: IdentifiedParameter,
    name: str,
    values: tuple[Array, Array, Array],
    ends: Array | tuple[float, float],
    reasons: Sequence[str],
    alike: Sequence[str],
    scale: float = 1.0,
) -> ParameterVerdict:
    """The verdict of one parameter.

    Args:
        about: Which.
        name: With its axis.
        values: The fit and both ends of its interval.
        ends: Least and largest value of a fit.
        reasons: Errors found so far, in words.
        alike: Keys of the parameters from which it cannot be distinguished.
        scale: Factor from these values to the reported ones.
    """
    (value, low, high), (least, most) = map(float, values), map(float, ends)
    if not math.isfinite(high - low):
        return ParameterVerdict.unknown(about, name, "the log does not show it")
    low = max(min(low, value - about.floor), least)
    high = min(max(high, value + about.floor), most)
    slack = 1e-3 * (most - least)
    at_bound = value < least + slack or value > most - slack
    narrow = (high - low) / 2 <= about.allowed_half_width(value) and not at_bound
    nothing = name.startswith("gain") and low <= 0 <= high
    why = list(reasons)
    if value < least + slack and least == 0:
        why.append(f"not distinguishable from zero; {about.experiment}")
    elif at_bound:
        why.append(f"at its bound of {value:.3g}; {about.experiment}")
    if nothing:
        why.append(
            f"not distinguishable from zero: a wrong column, exchanged axes, or {about.experiment}"
        )
    elif alike and not narrow:
        why.append(f"known only together with {' and '.join(alike)}")
    elif not at_bound and not narrow:
        why.append(f"its interval is wide; {about.experiment}")
    bounded = at_bound or low <= least or high >= most
    word = IDENTIFIED_VERDICT if narrow else BOUNDED_VERDICT if bounded else NOT_IDENTIFIABLE
    return ParameterVerdict(
        about=about,
        name=name,
        value=scale * value,
        low=scale * low,
        high=scale * high,
        word=NOT_IDENTIFIABLE if nothing else word,
        why="; ".join(why),
    )
