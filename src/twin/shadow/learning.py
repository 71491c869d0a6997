"""What a twin learns from the beginning of a log, and whether that differs from its reference.

An identification leaves some parameters open: they are learned from the beginning of a log, before
it is evaluated. A log shows friction, dead time, level and drives with some error, and
nothing of the screen's patches, play and cams. The first seconds are compared with the twin with
so much room; it is put where they put it, expanded again there, and its screen is taken as uneven
as their residuals require.

Learning hides what has changed before a log begins. So a twin that was learned from a reference log
is compared with the same fit to the beginning of another log: what differs by more than both fits
may be wrong by, and healthy logs of one rig differ by, has changed. What a twin does not know of a
screen and its friction makes the same error in two logs of the same motion, and shows as a change
where the motions differ: of the dead time above all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.base.data_file import read_toml
from twin.identify.logs import Log
from twin.identify.parameters import BALL_PARAMETERS as BOUNDS
from twin.identify.parameters import LEVEL_PARAMETERS
from twin.identify.prepare import MIN_SEGMENT_S, PreparedLog, interpolate, prepare
from twin.identify.windows import unknown_motion
from twin.scenario.load import check
from twin.scenario.merging import put
from twin.shadow.belief import BALL_BELIEFS, BELIEF_TABLES, OPEN_STD, WATCHED_PARAMETERS, Belief
from twin.shadow.evidence import (
    NO_EVIDENCE,
    Evidence,
    ball_evidence,
    ball_windows,
    log_evidence,
    noise_evidence,
    posterior,
)
from twin.shadow.plate import PLAY_WIDTHS_RAD, plate_evidence

DEG_PER_RAD = float(np.degrees(1.0))
"""Degrees in a radian."""
LEARNING_S = 20.0
"""Seconds from which a twin learns."""
EXPANSION_ROUNDS = 3
"""How often it is expanded again where they put it."""
MIN_FRICTION_SHARE = 0.2
"""Least share of its friction that is left of a twin in a round."""
UNEVENNESS_PERCENT = (10.0, 20.0, 5.0, 2.0, 0.0)
"""Percent by which the screen's friction may differ from place to place."""
COMPARED_PARAMETERS = (*BALL_BELIEFS, "lag", "transmission", "noise")
"""Parameters that are compared with those of a reference; lost motion is too uncertain for that."""
REFERENCE_TABLES = read_toml(Path(__file__).with_suffix(".toml"))
"""Constants of that comparison; the file explains its entries."""
HEALTHY_CHANGE_STDS: dict[str, dict[str, float]] = REFERENCE_TABLES["parameters"]
"""Scale on the errors of the fits, and standard deviation by which fits to healthy logs of one rig
differ beyond these (rolling relative, the noise as a logarithm, else SI), of each parameter;
``same_motion_scale``, where given, is the scale of logs with the motion of the reference."""
TRACK_STEP_S = 0.04
"""Seconds between two places of a ball's track, by which motions are compared."""
MAX_REFERENCE_SCORE = 2.5
"""Median score of replays of a reference log above which its twin is of a different rig: six rigs
of the family ``uncertain`` have 1.2 to 1.7, three other rigs under the thesis's twin 3.5 to 29."""
SAME_MOTION_SHARE = 0.3
"""Distance of two tracks, in sizes of the motion, below which the motion is the same."""
MAX_CHANCE_STDS = float(REFERENCE_TABLES["max_chance_stds"])
"""Standard deviations up to which a difference from the reference is explained by chance."""
PARAMETER_LABELS = {
    "rolling": "rolling friction",
    "breakaway": "breakaway",
    "delay": "dead time",
    "level_phi": "level",
    "level_theta": "level",
    "gain": "tilt gain",
    "lag": "drive lag",
    "transmission": "plate angle over command",
    "noise": "screen noise",
}
"""Parameters that are compared, in words."""
SHOWN_LIMITS = ("rolling", "delay", "level_phi", "gain")
"""Parameters of which the smallest change that would be seen is reported."""
SHOWN_VALUES = {
    "rolling": (1e3, "mm"),
    "level_phi": (DEG_PER_RAD, "deg"),
    "level_theta": (DEG_PER_RAD, "deg"),
}
"""Parameters of which the values are shown, not only the change: factor to their unit, unit."""


def prepare_for(log: Log, belief: Belief) -> PreparedLog:
    """The usable part of a log as a twin sees it, with its ball and walls.

    Raises:
        LogError: If the log is broken or too short, or the ball is off the screen.
    """
    walls = belief.scenario.plant.reach.narrowed(log.walls.ends)
    return prepare(replace(log, model=belief.model, walls=walls))


def beginning(log: PreparedLog) -> PreparedLog:
    """The first ``LEARNING_S`` of a log; ``segments`` may be empty."""
    until = float(log.segments[0].time[0]) + LEARNING_S
    parts = (each.between(-np.inf, until) for each in log.segments)
    return replace(log, segments=tuple(p for p in parts if p.length > MIN_SEGMENT_S))


def learn(log: PreparedLog, belief: Belief, gaps: Array) -> Belief:
    """The twin after the beginning of a log.

    Args:
        log: That beginning.
        belief: As it was identified.
        gaps: Of the log.
    """
    tried: list[tuple[float, Belief]] = []
    for percent in UNEVENNESS_PERCENT:
        belief, likelihood = fit_belief(log, _on_screen(belief, percent), gaps)
        tried.append((likelihood, belief))
    return max(tried, key=lambda each: each[0])[1]


def _on_screen(belief: Belief, percent: float) -> Belief:
    """The same twin on a screen that is uneven by so much."""
    tables = belief.scenario.model_dump(mode="json")
    new = [("plant.surface.spread_percent", percent)]
    own = Belief.of(check(put(tables, new), "the twin"), belief)
    keep = ("values", "lag", "play", "turned", "screen", "encoders", "disturbance", "unit")
    return replace(own, **{name: getattr(belief, name) for name in keep})


def fit_belief(log: PreparedLog, belief: Belief, gaps: Array) -> tuple[Belief, float]:
    """The twin put where a log puts it, and the logarithm of how likely that makes the log.

    ``constant`` of the new twin is the old one's, with the fit's standard deviation added.
    """
    likelihood, covariance = 0.0, belief.uncertainty
    for _ in range(EXPANSION_ROUNDS):
        windows, _ends = ball_windows(log, belief, gaps)
        ball = NO_EVIDENCE if windows is None else ball_evidence(windows, belief)
        others = [plate_evidence(log, belief, gaps), noise_evidence(log, belief, gaps)]
        soft, open_to = ball.softened(belief.changing), np.diag((belief.unit * OPEN_STD) ** 2)
        every = Evidence.concatenate([soft, Evidence.join(others).softened(belief.changing)])
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
        belief = shift_parameters(belief, mean)
    unsure = np.sqrt(belief.constant**2 + np.diag(covariance))
    return replace(belief, constant=unsure), likelihood


def taught(before: Belief, after: Belief) -> str:
    """Describe what a twin has learned, in a sentence."""
    old, new = before.values, after.values
    levels = np.degrees(
        [new[name] - old[name] for name in LEVEL_PARAMETERS[: after.scenario.plant.axes]]
    )
    level = " and ".join(f"{each:+.2f}" for each in levels)
    return (
        f"The first {LEARNING_S:g} s moved the twin to this log (rolling "
        f"friction {100 * (new['rolling'] / old['rolling'] - 1):+.0f} %, dead time "
        f"{1000 * (new['delay'] - old['delay']):+.0f} ms, level {level} deg, tilt gain "
        f"{100 * (new['gain'] / old['gain'] - 1):+.0f} %, a screen "
        f"uneven by {after.scenario.plant.surface.spread_percent:g} %): its identification left "
        "that open, or the rig has changed since; only what comes later is evaluated."
    )


def shift_parameters(belief: Belief, by: Array) -> Belief:
    """The twin with other parameters.

    Args:
        belief: The twin.
        by: What is added to ``PARAMETERS``, shape (P,).
    """
    off = dict(zip(WATCHED_PARAMETERS, by.tolist(), strict=True))
    values = dict(belief.values)
    for name in BALL_BELIEFS:
        least = MIN_FRICTION_SHARE * values[name] if name == "rolling" else BOUNDS[name].least
        values[name] = float(np.clip(values[name] + off[name], least, BOUNDS[name].most))
    gap = off["narrow_play"] * PLAY_WIDTHS_RAD[0] + off["wide_play"] * PLAY_WIDTHS_RAD[1]
    return replace(
        belief,
        values=values,
        lag=max(0.0, belief.lag + off["lag"]),
        play=max(0.0, belief.play + gap),
        turned=belief.turned + off["transmission"],
        screen=belief.screen * np.exp(2 * off["noise"]),
    )


@dataclass(frozen=True)
class HealthyTwin:
    """The twin of a rig after a reference log, and the motion in that log.

    Attributes:
        belief: The twin.
        track: As ``ball_track`` gives it.
        score: Median score of its replays of the reference log itself: 1 is as good as predicted.
    """

    belief: Belief
    track: Array
    score: float = 1.0


def ball_track(log: PreparedLog) -> Array:
    """The ball every ``TRACK_STEP_S`` of a log, m, shape (K, 2); NaN outside of its segments."""
    first, last = log.segments[0], log.segments[-1]
    time = np.arange(first.sampled[0], last.sampled[-1], TRACK_STEP_S)
    track = np.full((len(time), 2), np.nan)
    for each in log.segments:
        inside = (time >= each.sampled[0]) & (time <= each.sampled[-1])
        track[inside] = interpolate(time[inside], each.sampled, each.ball)
    return track


def motion_distance(track: Array, other: Array) -> float:
    """RMS distance of two tracks over the RMS size of the motion, at the best shift in time.

    Tracks overlap for at least half of ``LEARNING_S`` at a shift that counts.

    Args:
        track: As ``ball_track`` gives it, shape (K, 2).
        other: The same, shape (M, 2).

    Returns:
        0 for the same motion, infinite if the tracks are too short to be compared.
    """
    least, best = round(LEARNING_S / 2 / TRACK_STEP_S), np.inf
    for shift in range(least - len(track), len(other) - least + 1):
        own, there = track[max(0, -shift) :], other[max(0, shift) :]
        both = min(len(own), len(there))
        pair = np.concatenate((own[:both], there[:both]), axis=1)
        pair = pair[np.isfinite(pair).all(axis=1)]
        if len(pair) >= least:
            apart, size = pair[:, :2] - pair[:, 2:], pair[:, :2] - pair[:, :2].mean(axis=0)
            best = min(best, float(np.sqrt((apart**2).sum() / max((size**2).sum(), 1e-12))))
    return best


@dataclass(frozen=True)
class Difference:
    """How a parameter of a log's beginning compares with the reference's.

    Attributes:
        name: In ``COMPARED_PARAMETERS``.
        reference: Its value there in SI units; the noise as a logarithm.
        change: By how much the log's value is larger, in the same unit.
        fit_std: Standard deviation of the change by the errors that both fits state of themselves.
        unit: Value that counts as 1 in a relative change.
        same_motion: Whether the ball moved as in the reference log.
    """

    name: str
    reference: float
    change: float
    fit_std: float
    unit: float
    same_motion: bool = False

    @property
    def std(self) -> float:
        """Standard deviation of the change if the rig is the same."""
        healthy = HEALTHY_CHANGE_STDS[self.name]
        scale = healthy["scale"]
        if self.same_motion:
            scale = healthy.get("same_motion_scale", scale)
        return float(np.hypot(scale * self.fit_std, healthy["between"] * self.unit))

    @property
    def deviation(self) -> float:
        """The change in standard deviations."""
        return self.change / self.std

    @property
    def significant(self) -> bool:
        """Whether chance does not explain the change."""
        return abs(self.deviation) > MAX_CHANCE_STDS

    @property
    def least(self) -> str:
        """The smallest change that chance does not explain, in words."""
        size = self._describe(MAX_CHANCE_STDS * self.std, "size")
        return f"{PARAMETER_LABELS[self.name]} below {size}"

    def _describe(self, change: float, form: str) -> str:
        """A change of this parameter in words: with its sign, or its size alone.

        Args:
            change: In the unit of the reference; of the noise its logarithm.
            form: Of the words in the table of beliefs: words, or size.
        """
        about = BELIEF_TABLES["parameters"][self.name]
        number = about["factor"] * change / self.unit
        return str(about[form].format(np.exp(number) if self.name == "noise" else number))

    @property
    def words(self) -> str:
        """The change in words, as ``rolling friction 0.180 -> 0.360 mm (+100 %)``.

        A value that is shown as zero has no share.
        """
        change = self._describe(self.change, "words")
        label = PARAMETER_LABELS[self.name]
        if self.name not in SHOWN_VALUES:
            return f"{label} {change}"
        factor, unit = SHOWN_VALUES[self.name]
        values = [factor * each for each in (self.reference, self.reference + self.change)]
        axis = self.name.partition("_")[2]
        shown = f"{label} {axis + ' ' if axis else ''}{values[0]:.3f} -> {values[1]:.3f} {unit}"
        return shown if axis or not round(values[0], 3) else f"{shown} ({change})"

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``: SI units, the noise as a logarithm of its standard deviation."""
        return {
            "name": self.name,
            "reference": self.reference,
            "log": self.reference + self.change,
            "deviation_stds": self.deviation,
            "significant": self.significant,
            "words": self.words,
        }


def compare_with_reference(
    log: PreparedLog, reference: HealthyTwin, gaps: Array
) -> tuple[Difference, ...]:
    """Compare the beginning of a log with the twin that was learned from the reference log.

    That twin is fitted to the beginning, on the screen of the reference, so that an error of the
    model is the same in both where their motion is. The standard deviation of a difference is that
    of both fits and of what healthy logs of a rig differ by beyond it.

    Args:
        log: The beginning.
        reference: The twin learned from the reference log, and the motion in that log.
        gaps: Of the log.

    Returns:
        The parameters, the largest deviation first.
    """
    belief = reference.belief
    same = motion_distance(ball_track(log), reference.track) < SAME_MOTION_SHARE
    found, _ = fit_belief(log, belief, gaps)
    old, new = _compared_values(belief), _compared_values(found)
    differences = []
    for name in COMPARED_PARAMETERS:
        if name in LEVEL_PARAMETERS[belief.scenario.plant.axes :]:
            continue
        at = WATCHED_PARAMETERS.index(name)
        unit = old[name] if name == "rolling" else 1.0
        change = new[name] - old[name]
        std = float(found.constant[at])
        differences.append(Difference(name, old[name], change, std, unit, same))
    return tuple(sorted(differences, key=lambda each: -abs(each.deviation)))


def _compared_values(belief: Belief) -> dict[str, float]:
    """The values of ``COMPARED_PARAMETERS``."""
    screen = np.maximum(belief.screen[: belief.scenario.plant.axes], 1e-12)
    return {
        **{name: belief.values[name] for name in BALL_BELIEFS},
        "lag": belief.lag,
        "transmission": float(belief.turned.mean()),
        "noise": float(np.log(screen).mean()) / 2,
    }
