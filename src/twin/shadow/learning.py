"""What an identification left open, learned from the beginning of a log before it is judged.

A log shows friction, dead time, level and drives with some error, and of the screen's patches, play
and cams nothing. The first seconds are held against the twin with so much room; it is put where
they put it, expanded again there, and its screen is taken as uneven as their residuals ask for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from controllers.arrays import Array
from twin.identify.parameters import BALL as BOUNDS
from twin.identify.prepare import PreparedLog
from twin.scenario.load import check, put
from twin.shadow.belief import BALL, OPEN, PARAMETERS, Belief
from twin.shadow.evidence import (
    GAPS,
    NONE,
    Evidence,
    ball_evidence,
    ball_windows,
    log_evidence,
    noise_evidence,
    plate_evidence,
    posterior,
    unknown_motion,
)

LEARNING = 20.0
"""Seconds from which a twin learns."""
ROUNDS = 3
"""How often it is expanded again where they put it."""
LEAST = 0.2
"""Least share of its friction that is left of a twin in a round."""
UNEVEN = (10.0, 20.0, 5.0, 2.0, 0.0)
"""Percent by which the screen's friction may differ from place to place."""


def learned(log: PreparedLog, belief: Belief, gaps: Array) -> Belief:
    """The twin after the beginning of a log.

    Args:
        log: That beginning.
        belief: As it was identified.
        gaps: Of the log.
    """
    tried: list[tuple[float, Belief]] = []
    for percent in UNEVEN:
        belief, likelihood = _fitted(log, _on_screen(belief, percent), gaps)
        tried.append((likelihood, belief))
    return max(tried, key=lambda each: each[0])[1]


def _on_screen(belief: Belief, percent: float) -> Belief:
    """The same twin on a screen that is uneven by so much."""
    tables = belief.scenario.model_dump(mode="json")
    new = [("plant.surface.spread_percent", percent)]
    own = Belief.of(check(put(tables, new), "the twin"), belief)
    keep = ("values", "lag", "play", "turned", "screen", "encoders", "disturbance", "unit")
    return replace(own, **{name: getattr(belief, name) for name in keep})


def _fitted(log: PreparedLog, belief: Belief, gaps: Array) -> tuple[Belief, float]:
    """The twin put where a log puts it, and the logarithm of how likely that makes the log."""
    likelihood, covariance = 0.0, belief.uncertainty
    for _ in range(ROUNDS):
        windows, _ends = ball_windows(log, belief, gaps)
        ball = NONE if windows is None else ball_evidence(windows, belief)
        others = [plate_evidence(log, belief, gaps), noise_evidence(log, belief, gaps)]
        soft, open_to = ball.softened(belief.changing), np.diag((belief.unit * OPEN) ** 2)
        every = Evidence.beside([soft, Evidence.join(others).softened(belief.changing)])
        own, sums = (
            (each.information.sum(axis=0), each.score.sum(axis=0)) for each in (soft, every)
        )
        likelihood = float(soft.height.sum() + log_evidence(*own, open_to))
        if windows is not None:
            pushed = unknown_motion(windows, belief.values["delay"])
            size = float(np.hypot(belief.rough, belief.sloped))
            within = np.eye(pushed.shape[-1]) + size**2 * np.swapaxes(pushed, -1, -2) @ pushed
            likelihood -= float(np.linalg.slogdet(within)[1].sum()) / 2
        mean, covariance = posterior(*sums, open_to)
        belief = moved(belief, mean)
    unsure = np.sqrt(belief.constant**2 + np.diag(covariance))
    return replace(belief, constant=unsure), likelihood


def taught(before: Belief, after: Belief) -> str:
    """What a twin has learned, in a sentence."""
    old, new = before.values, after.values
    level = np.degrees([new[name] - old[name] for name in ("level_phi", "level_theta")])
    return (
        f"The first {LEARNING:g} s taught the twin what its identification left open (rolling "
        f"friction {100 * (new['rolling'] / old['rolling'] - 1):+.0f} %, dead time "
        f"{1000 * (new['delay'] - old['delay']):+.0f} ms, level {level[0]:+.2f} and "
        f"{level[1]:+.2f} deg, tilt gain {100 * (new['gain'] / old['gain'] - 1):+.0f} %, a screen "
        f"uneven by {after.scenario.plant.surface.spread_percent:g} %); the rest is judged."
    )


def moved(belief: Belief, by: Array) -> Belief:
    """The twin with other parameters.

    Args:
        belief: The twin.
        by: What is added to ``PARAMETERS``, shape (P,).
    """
    off = dict(zip(PARAMETERS, by.tolist(), strict=True))
    values = dict(belief.values)
    for name in BALL:
        least = LEAST * values[name] if name == "rolling" else BOUNDS[name].least
        values[name] = float(np.clip(values[name] + off[name], least, BOUNDS[name].most))
    gap = off["narrow_play"] * GAPS[0] + off["wide_play"] * GAPS[1]
    return replace(
        belief,
        values=values,
        lag=max(0.0, belief.lag + off["lag"]),
        play=max(0.0, belief.play + gap),
        turned=belief.turned + off["transmission"],
        screen=belief.screen * np.exp(2 * off["noise"]),
    )
