"""Explains from a record why a run went as it did: as numbers, and in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from controllers.arrays import Array
from twin.base.data_file import read_packaged
from twin.base.page import percent
from twin.devices.realtime import describe_lateness
from twin.run.controller_building import build_law
from twin.run.finished import Run, columns
from twin.run.metrics import Motion

MIN_TURNING_RAD = 0.99 * 2 * math.pi
"""Turning of a reference in rad above which delay and scale of a path can be separated."""
MIN_PATH_SPEED_M_S = 1e-3
"""Speed of a reference in m/s below which it rests."""
MAX_LAG_S = 1.5
"""Seconds up to which a lag behind the reference is looked for."""
COARSE_LAG_STEP_S, FINE_LAG_STEP_S = 0.025, 0.005
"""Steps in s in which it is looked for, first everywhere and then about the best."""
MIN_REDUCTION_RAD_S2 = 0.01
"""Difference of requested and applied acceleration in rad/s^2 that counts as cut by a limit."""
REST_TIME_S = 1.0
"""Seconds without motion at the end of a run after which a ball rests."""
STILL_MOTION_M = 0.1e-3
"""Motion in m within that time that is none."""
WALL_DISTANCE_M = 1e-4
"""Distance in m from a wall up to which a ball touches it."""
STUCK_DISTANCE_M = 1e-3
"""Distance in m from its reference at which a resting ball is stuck."""


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Facts of one run from ``metrics.start`` on, of one that was stopped up to then.

    Lengths are in m, times in s, shares 0..1.

    Attributes:
        rms: Root mean square distance of ball and reference.
        lag: Delay of the reference at which, scaled, it fits the ball best; None if it rests, or
            no delay fits.
        gain: The scale about the plate's centre: below 1 the path is smaller; None without a lag.
        rest: Root mean square distance from the reference so delayed and scaled; None likewise.
        turned: By how much the reference's direction turned in that time, rad; a reversal is pi.
        estimation: Root mean square error of the estimated position; None if the truth is unknown.
        cut: Share of time in which a limit reduced the control effort; None if not recorded.
        angle: Largest plate angle over its limit.
        lifted: Share of time in which a wheel had no contact; None if not recorded.
        untouched: Share of time in which the screen detected nothing.
        stuck: Distance at which a resting ball ended from a resting reference; None if either
            moved, or the ball is where it should be.
        tilt: Tilt of the plate then, rad.
        held: Share of the whole run in which friction held the ball at rest; None if unknown.
        walled: Share of the whole run in which the ball was at a wall.
        unmoved: Whether the law asked for motion and the limits left nothing of all of it.
    """

    rms: float
    lag: float | None
    gain: float | None
    rest: float | None
    turned: float
    estimation: float | None
    cut: float | None
    angle: float
    lifted: float | None
    untouched: float
    stuck: float | None
    tilt: float
    held: float | None
    walled: float
    unmoved: bool

    @classmethod
    def of(cls, run: Run) -> Diagnosis:
        """Look through a run's record."""
        end = max(run.judged_until, float(run.motion.time[0]))
        motion = run.motion.until(end)
        rows = {name: values[: len(motion.time)] for name, values in run.rows.items()}
        start = run.scenario.metrics.start
        late = motion.time >= (start if start < motion.time[-1] else 0.0) - 1e-9
        time, ball = motion.time[late], motion.ball[late]
        lag, gain, rest = _timing(run, time, ball)
        estimation = None
        if "true_x" in rows:
            seen = columns(rows, "estimated")[late, 0::4]
            estimation = _rms(seen - ball)
        requested, applied = _accelerations(rows, "requested"), _accelerations(rows, "applied")
        wheels = [rows[name] for name in ("wheel_phi_N", "wheel_theta_N") if name in rows]
        touched = rows.get("touched", np.ones_like(motion.time))
        return cls(
            rms=_rms(motion.error[late]),
            lag=lag,
            gain=gain,
            rest=rest,
            turned=_total_turning(motion.reference[late]),
            estimation=estimation,
            cut=None
            if np.isnan(requested).all()
            else float((np.abs(requested - applied) > MIN_REDUCTION_RAD_S2).any(axis=1).mean()),
            angle=float(np.abs(motion.plate).max() / run.limits.angle),
            lifted=float((np.min(wheels, axis=0) <= 0).mean()) if wheels else None,
            untouched=float((touched < 0.5).mean()),
            stuck=_stuck(motion),
            tilt=float(np.hypot(*motion.plate[-1])),
            held=None if motion.held is None else float(motion.held.mean()),
            walled=float(run.scenario.plant.reach.is_met(motion.ball, WALL_DISTANCE_M).mean()),
            unmoved=bool(np.nan_to_num(requested).any() and not applied.any()),
        )


def _stuck(motion: Motion) -> float | None:
    """How far from its resting reference the ball lay still at the end of a run."""
    last = motion.time >= motion.time[-1] - REST_TIME_S
    moved = max(np.ptp(where[last], axis=0).max() for where in (motion.ball, motion.reference))
    away = float(np.hypot(*motion.error[-1]))
    return (
        away
        if moved < STILL_MOTION_M and away > STUCK_DISTANCE_M and motion.time[-1] >= REST_TIME_S
        else None
    )


def _timing(run: Run, time: Array, ball: Array) -> tuple[float | None, float | None, float | None]:
    """Delay and scale of the reference that fit the ball best, and the error that is left.

    Nothing if the best delay is the first or last of those tried, up to half the evaluated time, or
    if the reference neither turns once round in that time nor goes from rest to rest: a part of its
    way can be delayed, scaled or not yet reached, which nobody can distinguish.
    """
    reference = run.followed
    if len(time) < 10 or np.ptp(reference(time)[0], axis=0).max() < 1e-3:
        return None, None, None
    speed = np.hypot(*reference(time[[0, -1]])[1].T)
    if _total_turning(reference(time)[0]) < MIN_TURNING_RAD and speed.max() > MIN_PATH_SPEED_M_S:
        return None, None, None
    some = slice(None, None, max(1, len(time) // 2000))
    time, ball = time[some], ball[some]

    def fit(delay: float, every: int = 1) -> tuple[float, float]:
        desired = reference(np.maximum(time[::every] - delay, 0.0))[0]
        # never below 0: along a line half a period late is the other way round
        gain = max(0.0, float((desired * ball[::every]).sum() / max((desired**2).sum(), 1e-12)))
        return gain, _rms(gain * desired - ball[::every])

    coarse = np.arange(-0.2, min(MAX_LAG_S, float(np.ptp(time)) / 2), COARSE_LAG_STEP_S)
    every = max(1, len(time) // 400)
    best = coarse[int(np.argmin([fit(delay, every)[1] for delay in coarse]))]
    if best in (coarse[0], coarse[-1]):
        return None, None, None
    fine = best + np.arange(-COARSE_LAG_STEP_S, 1.5 * COARSE_LAG_STEP_S, FINE_LAG_STEP_S)
    squares = np.array([fit(delay)[1] ** 2 for delay in fine])
    i = int(np.clip(np.argmin(squares), 1, len(fine) - 2))
    before, least, after = squares[i - 1 : i + 2]
    bend = before - 2 * least + after  # of the parabola through the three: its vertex is the lag
    lag = float(fine[i] + FINE_LAG_STEP_S * (0.5 * (before - after) / bend if bend > 0 else 0.0))
    return lag, *fit(lag)


def _total_turning(path: Array) -> float:
    """Total turning of the direction of a path (K, 2), rad; a reversal is pi."""
    steps = np.diff(path, axis=0)
    steps = steps[np.hypot(*steps.T) > 1e-9]
    turns = np.diff(np.arctan2(steps[:, 1], steps[:, 0]))
    return float(np.abs((turns + np.pi) % (2 * np.pi) - np.pi).sum())


def spectrum(run: Run) -> tuple[Array, Array]:
    """Amplitude of the tracking error over frequency: Hz (F,), m (F, 2) for x and y.

    A Hann window from ``metrics.start`` on, scaled so that a sine of amplitude a reads a.
    """
    motion = run.motion.until(max(run.judged_until, float(run.motion.time[0])))
    late = motion.time >= run.scenario.metrics.start - 1e-9
    error = motion.error[late] if late.sum() >= 8 else motion.error
    window = np.hanning(len(error))
    weight = 2 / max(window.sum(), 1e-12)
    level = error - error.mean(axis=0)
    amplitude: Array = weight * np.abs(np.fft.rfft(window[:, None] * level, axis=0))
    period = float(np.median(np.diff(motion.time))) if len(motion.time) > 1 else 1.0
    return np.fft.rfftfreq(len(error), period), amplitude


def _accelerations(rows: Mapping[str, Array], kind: str) -> Array:
    return np.stack([rows[f"{kind}_{axis}_acc"] for axis in ("phi", "theta")], axis=1)


def _rms(error: Array) -> float:
    return float(np.sqrt((error**2).sum(axis=-1).mean()))


ENDING_TEXTS = read_packaged("twin.view", "endings.toml")


MIN_REPORTED_DISTANCE_M = 1e-6
"""Distance in m below which its number means nothing."""
SMALL_ERROR_M = 1e-4
"""Error in m, less than the screen resolves, that needs no sentence."""
MIN_CUT_SHARE = 0.001
"""Share of time in which a limit cut the effort above which it is reported."""
NO_LIMIT_TEXT, NO_PLATE_LIMIT_TEXT = "no limit was in the way", "no limit of the plate was reached"
"""The latter where something other than a limit held the ball."""
MIN_HELD_SHARE, MAIN_HELD_SHARE = 0.01, 0.1
"""Shares of time in which friction or a wall held the ball above which it is reported where nothing
else limited a run, and everywhere."""
LIMIT_SHARE = 0.95
"""Share of the angle limit above which the plate counts as having reached it."""


def summary(run: Run, found: Diagnosis) -> list[str]:
    """How it ended, how large the error was, and what limited it: one sentence each."""
    sentences = [
        _ending(run),
        *(f"Not whole: {line}." for line in run.incomplete),
        f"{_size(run, found)}.",
    ]
    if found.held:
        share = f"{percent(found.held)} of the whole run's time"
        sentences.append(f"Friction held the ball at rest {share} (shaded).")
    if found.walled >= MIN_HELD_SHARE:
        wall = "an end stop" if run.scenario.plant.axes == 1 else "a wall"
        sentences.append(f"The ball was at {wall} {percent(found.walled)} of the whole run's time.")
    sentences += [f"{fact[0].upper()}{fact[1:]}." for fact in _limits(run, found)]
    if (off := found.estimation) is not None and off >= MIN_REPORTED_DISTANCE_M:
        size = "large" if off > 0.5 * found.rms else "small"
        sentences.append(
            f"The observer's position of the ball was off by {1000 * off:.2g} mm (RMS), a {size} "
            "part of it."
        )
    remarks = () if "controller" in run.absent else build_law(run.scenario).remarks
    return [*sentences, *remarks]


def describe_run(run: Run, clean: float | None = None) -> str:
    """The verdict on a run; arguments as for ``verdict``."""
    if not len(run.rows["time"]):
        return _sentence(f"{ENDING_TEXTS[run.metrics['outcome']]}: {run.metrics['reason']}")
    return verdict(run, Diagnosis.of(run), clean)


def verdict(run: Run, found: Diagnosis, clean: float | None = None) -> str:
    """A run in one sentence: its tracking error, and what limited it most.

    Args:
        run: The run.
        found: What its record shows.
        clean: Tracking error e_tt of the same controller on the clean model in %, if it ran.
    """
    if run.metrics.get("outcome") != "finished":
        return _ending(run)
    limits = _limits(run, found)
    nothing = (NO_LIMIT_TEXT, NO_PLATE_LIMIT_TEXT)
    limits = [words for words in limits if not words.startswith(nothing)]
    limits += _describe_held(run, found, MAIN_HELD_SHARE if limits else MIN_HELD_SHARE)
    size = _size(run, found, clean)
    return f"{size}: {'; '.join(limits)}." if limits else f"{size}."


def _size(run: Run, found: Diagnosis, clean: float | None = None) -> str:
    """How large the error was; arguments as for ``verdict``."""
    percent = run.metrics.get("tracking_error_percent")
    clean_text = f" ({clean:.3g} % on the clean model)" if clean is not None else ""
    reported = percent is not None and not _is_goal_still(run)
    share = f"Tracking error e_tt {percent:.3g} %{clean_text}, " if reported else ""
    start = run.scenario.metrics.start
    partial = 0 < start < (run.metrics.get("outcome_time") or run.scenario.duration)
    since = f" from {start:.4g} s on" if partial else ""
    over = "x" if run.scenario.plant.axes == 1 else "x and y"
    return f"{share}{_mm(found.rms)} RMS over {over}{since}"


def _is_goal_still(run: Run) -> bool:
    """Whether a goal stayed so near the middle that an error is no share of it."""
    percent, distance = (
        run.metrics.get(each) for each in ("tracking_error_percent", "rms_distance")
    )
    return bool(percent and distance is not None and 100 * distance / percent < SMALL_ERROR_M)


def _limits(run: Run, found: Diagnosis) -> list[str]:
    """Limits of a run, the most important first, in half a sentence each."""
    facts = _describe_shaped_reference(run)
    if (away := found.stuck) is not None:
        simulated = "true_x" in run.rows
        rubs = run.scenario.plant.friction.rolling_mm > 0 or not simulated
        facts.append(
            f"at the end the ball lay stuck{' by friction' if rubs else ''} {1000 * away:.3g} mm "
            f"away from its reference, on a plate tilted by {math.degrees(found.tilt):.2g} deg: "
            "integral action, a higher gain, or a reference that keeps moving would free it"
        )
    elif found.lag is not None and found.gain is not None and found.rest is not None:
        way = "behind" if found.lag >= 0 else "ahead of"
        size = "smaller" if found.gain <= 1 else "larger"
        if found.rms > SMALL_ERROR_M:
            facts.append(
                f"the ball ran {1000 * abs(found.lag):.0f} ms {way} its reference on a path "
                f"{100 * abs(1 - found.gain):.1f} % {size}; apart from these two the error is "
                f"{_mm(found.rest)}"
            )
    elif (
        found.lag is None
        and MIN_PATH_SPEED_M_S < found.turned < MIN_TURNING_RAD
        and found.rms > SMALL_ERROR_M
    ):
        facts.append(
            f"too short for a lag: its reference turned by {math.degrees(found.turned):.0f} deg "
            "in that time, less than once round"
        )
    elif _is_goal_still(run):
        facts.append(
            f"no verdict: its goal was within {1000 * SMALL_ERROR_M:g} mm of the middle (RMS)"
        )
    if found.unmoved:
        facts.insert(0, "the plate was never moved: limits left nothing of any command")
    if found.cut is not None and found.cut > MIN_CUT_SHARE:
        facts.append(
            "a limit of rate, acceleration or angle cut the effort "
            f"{percent(found.cut)} of the time"
        )
    limit = run.scenario.rig.limits.angle_deg
    if found.angle > LIMIT_SHARE:
        facts.append(f"the plate reached its angle limit of {limit:g} deg")
    if found.cut is not None and found.cut <= MIN_CUT_SHARE and found.angle <= LIMIT_SHARE:
        held = _describe_held(run, found, MIN_HELD_SHARE)
        none = f"{NO_PLATE_LIMIT_TEXT}: of its" if held else f"{NO_LIMIT_TEXT}, of the plate's"
        facts.append(f"{none} {limit:g} deg {percent(found.angle, 0)} were used")
    if found.lifted:
        facts.append(f"a wheel left its cam {percent(found.lifted)} of the time")
    if found.untouched:
        facts.append(f"no ball was detected {percent(found.untouched)} of the time")
    return facts or [NO_LIMIT_TEXT]


def _describe_held(run: Run, found: Diagnosis, share: float) -> list[str]:
    """What held the ball for more than a share of the time, in half a sentence each."""
    facts = []
    if (held := found.held or 0.0) >= share:
        facts.append(f"friction held the ball at rest {percent(held)} of the time")
    if found.walled >= share:
        wall = "an end stop" if run.scenario.plant.axes == 1 else "a wall"
        facts.append(f"the ball was at {wall} {percent(found.walled)} of the time")
    return facts


def _describe_shaped_reference(run: Run) -> list[str]:
    """A reference that the plate cannot give, if the law planned its own path for that reason."""
    if "laid_x" not in run.rows:
        return []
    laid, time = np.stack((run.rows["laid_x"], run.rows["laid_y"]), axis=1), run.rows["time"]
    away = np.nanmax(np.hypot(*(laid - run.followed(time)[0]).T))
    seconds = np.isfinite(laid[:, 0]).mean() * (time[-1] - time[0])
    return [
        f"the plate cannot give this reference: the planned path was up to {_mm(away)} away "
        f"from it, for {seconds:.3g} s in all"
    ]


def _ending(run: Run) -> str:
    outcome = str(run.metrics.get("outcome", ""))
    end = float(run.metrics.get("outcome_time", run.rows["time"][-1]))
    reason = run.metrics.get("reason")
    ending = ENDING_TEXTS.get(outcome, "The run ended")
    ending_text = _sentence(f"{ending} after {end:.4g} s{f': {reason}' if reason else ''}")
    late = describe_lateness(run.ledger) if outcome == "fault" and run.ledger else ""
    return f"{late[0].upper()}{late[1:]}. {ending_text}" if late else ending_text


def _mm(distance: float) -> str:
    """A distance in m, in words; nothing that no rig could tell from none."""
    return (
        f"{1000 * distance:.3g} mm"
        if distance >= MIN_REPORTED_DISTANCE_M
        else f"below {1000 * MIN_REPORTED_DISTANCE_M:g} mm"
    )


def _sentence(text: str) -> str:
    """A text with a full stop, unless it ends in a sign of its own, as a question does."""
    return text if text.endswith(("?", "!", ".")) else f"{text}."
