"""The twin itself fitted to a log, without a first guess: rolling, then breakaway, then all.

From a log with plate angles to parameters, verdicts, and what they are worth on the rest of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, cast

import numpy as np
from scipy import stats

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate, corner_frequency, time_constant
from twin.base.errors import LogError, plural
from twin.identify.least_squares import (
    START_DIFFERENCES,
    START_PRIOR,
    Estimate,
    Fit,
    FitProblem,
    Linearisation,
    Minimum,
    fit_starts_from_scratch,
    minimise,
)
from twin.identify.logs import Log, rig_of
from twin.identify.parameters import (
    AT_REST,
    BALL_PARAMETERS,
    FITTED_SHARE,
    HIDDEN_PARAMETERS,
    LEVELS,
    SERVO_PARAMETER,
    fitted_parameters,
)
from twin.identify.plate_motion import Drives, check_motion, fit_drives
from twin.identify.prepare import PreparedLog, Segment, check_ranges, prepare
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    HOLD_OUT,
    IDENTIFIED_VERDICT,
    MAX_CORRELATION,
    NOT_IDENTIFIABLE,
    REJECTED_VERDICT,
    HoldOutPrediction,
    Identification,
    ParameterVerdict,
    Predicted,
    predict_windows,
    score,
)
from twin.identify.windows import (
    LOOKBACK_S,
    Patches,
    Spans,
    Windows,
    cut,
    moving_spans,
    replay,
    unknown_motion,
)
from twin.sim.plant.friction import Friction, SurfaceMap


@dataclass(frozen=True, kw_only=True)
class NoiseSearch:
    """Constants of the search for the size of motion that no replay explains.

    Attributes:
        unevenness_shares: Tried shares of the friction that differ from patch to patch of a screen:
            standard deviations.
        forces_m_s2: Tried sizes of unknown forces, see ``unknown_motion``.
        initial_sizes: The share and the force with which the search begins.
        iterations: Fits with the sizes that the fit before made most likely.
        patch_step_share: Share by which the friction of a patch is raised to find its effect.
    """

    unevenness_shares: tuple[float, ...] = (0.0, 0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3)
    forces_m_s2: tuple[float, ...] = (0.0, 3e-4, 6e-4, 1e-3, 2e-3, 4e-3, 8e-3)
    initial_sizes: tuple[float, float] = (0.1, 1e-3)
    iterations: int = 3
    patch_step_share: float = 0.03


@dataclass(frozen=True, kw_only=True)
class TwinSelection:
    """Constants of the choice of windows, guesses and model of a fit of the twin.

    Attributes:
        max_window_s: Longest window: long enough for friction to add up, short enough to forget an
            error of the start.
        breakaway_ratios: Tried breakaway ratios.
        fitted_guesses: Number of the best guesses that are fitted with all windows.
        unexplained_misfit_ratio: Mean square misfit over the usual one above which a window is left
            out at the end: where the ball nearly stops, noise decides whether it does, and no
            replay can know.
        free_start_gain_limit: Noise variances by which a free speed at the start may reduce the
            misfit of a window in which the ball rests at first.
        min_viscous_stds: Standard deviations above zero from which viscous friction is fitted.
        even_screen_share: Share of the windows that an even screen must explain.
        noise: Constants of the search for unknown motion.
    """

    max_window_s: float = 2.5
    breakaway_ratios: tuple[float, ...] = tuple((1 + np.linspace(0, 2.2, 32) ** 1.3).tolist())
    fitted_guesses: int = 3
    unexplained_misfit_ratio: float = 2.0
    free_start_gain_limit: float = float(stats.chi2.ppf(0.99, 2))
    min_viscous_stds: float = 4.0
    even_screen_share: float = 0.8
    noise: NoiseSearch = NoiseSearch()


@dataclass(frozen=True, kw_only=True)
class WhitenessTest:
    """Constants of the test that residuals are white (Box and Pierce).

    Attributes:
        lags: Number of lags of the autocorrelation that are tested.
        level: Level of the test.
        slight_correlation: Correlation that a long log shows but that rejects no model: what moves
            together is then a twentieth of the noise variance, less than 0.1 mm. A replay of the
            twin itself leaves up to 0.03; the scatter of the intervals between windows is of this
            size.
        max_unexplained_share: Share of the noise variance up to which unexplained motion widens the
            intervals; a model that leaves more is rejected.
    """

    lags: int = 20
    level: float = 0.99
    slight_correlation: float = 0.05
    max_unexplained_share: float = 0.3


TWIN_SELECTION = TwinSelection()
WHITENESS_TEST = WhitenessTest()


@dataclass(frozen=True)
class TwinProblem(FitProblem[Windows]):
    """Replays of the ball on the measured plate.

    Attributes:
        model: Ball parameters.
        grip: Time in s within which friction stops a ball, see ``replay``.
        sizes: Of the unknown motion: share of the friction from patch to patch, and m/s^2.
        noise: Constants of the search for these sizes.
    """

    model: BallPlate
    grip: float = 0.0
    sizes: tuple[float, float] = (0.0, 0.0)
    noise: NoiseSearch = TWIN_SELECTION.noise
    about = BALL_PARAMETERS
    start_steps = START_DIFFERENCES
    prior = START_PRIOR

    def values(self, theta: Array) -> dict[str, Array]:
        """All ball parameters by name, those not fitted at values without effect, shape (C, 1).

        Args:
            theta: Parameters, shape (C, P), or (C, W, P) for (C, W) of each.
        """
        defaults = {
            name: BALL_PARAMETERS[name].least if name != "stribeck" else 0.005
            for name in BALL_PARAMETERS
        }
        defaults |= {"level_phi": 0.0, "level_theta": 0.0, "gain": 1.0}
        values = {name: np.full((len(theta), 1), value) for name, value in defaults.items()}
        each = theta if theta.ndim > 2 else theta[:, None]
        values |= {name: each[..., k] for k, name in enumerate(self.names)}
        return values

    def initial_starts(self) -> Array:
        """A straight line through the first samples of each window, shape (4, 1, W)."""
        windows = self.windows
        out = np.zeros((4, 1, len(windows)))
        for w, resting in enumerate(windows.resting):
            first = (windows.time[w] < LOOKBACK_S + 0.25) & (windows.weight[w, :, 0] > 0)
            t = windows.time[w, first] - 0.04
            line = np.stack((np.ones_like(t), t), axis=-1)[:, : 1 if resting else 2]
            found = np.linalg.lstsq(line, windows.ball[w, first], rcond=None)[0]
            out[: 2 * len(found), 0, w] = found.ravel()
        return out

    def replay(
        self, theta: Array, starts: Array, surfaces: SurfaceMap | Patches | None = None
    ) -> tuple[Array, Array]:
        """Positions and velocities of the ball in m and m/s, both shape (N, 2, C, W).

        Args:
            theta: Parameters, shape (C, P), or (C, W, P) if they differ from window to window.
            starts: x, y, x', y' at the beginning of each window, shape (4, C, W).
            surfaces: The screens, one per candidate; None for even ones.
        """
        values = self.values(theta)
        level = np.stack(np.broadcast_arrays(*(values[name] for name in LEVELS)))
        friction = Friction(
            rolling=values["rolling"],
            breakaway_ratio=values["breakaway"],
            stribeck_speed=values["stribeck"],
            dwell_time=values["dwell"],
            viscous=values["viscous"],
            map=cast("SurfaceMap | None", surfaces),  # patches are called alike
        )
        return replay(
            self.windows.field,
            self.model,
            friction,
            level,
            starts,
            self.grip,
            values["gain"],
            self.windows.paces,
        )

    def simulate_samples(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """Predicted reports of the screen in m, and their rates in m/s, (C, W, B, 2)."""
        places, speeds = self.replay(theta, starts)
        return self.windows.at_samples(places, speeds, self.values(theta)["delay"])

    def linearise(self, theta: Array, starts: Array, *, slopes: bool = True) -> Linearisation:
        """Residuals and slopes of C candidates; a resting ball has no speed to be fitted."""
        found = super().linearise(theta, starts, slopes=slopes)
        found.by_start[:, self.windows.resting, :, 2:] = 0.0
        white = self.windows.white
        if white is None:
            return found
        r = (white @ found.r[..., None])[..., 0]
        return found._replace(
            r=r, by_start=white @ found.by_start, by_parameter=white @ found.by_parameter
        )

    def _unknown(self, best: Minimum) -> tuple[Array, int]:
        """Shifts of the samples by patches of the screen and other forces; number of patches."""
        windows, delay = self.windows, self.values(best.theta)["delay"]
        plain = self.replay(best.theta, best.starts)
        step = self.noise.patch_step_share
        spots = Patches.near(np.moveaxis(plain[0], 1, -1), step)
        many = len(spots.points)
        each = (best.theta.repeat(many, axis=0), best.starts.repeat(many, axis=1))
        moved = windows.at_samples(*self.replay(*each, spots), delay.repeat(many, axis=0))[0]
        moved = (moved - windows.at_samples(*plain, delay)[0]) * windows.weight / step
        uneven = np.moveaxis(moved.reshape(many, len(windows), -1), 0, -1)
        return np.concatenate((uneven, unknown_motion(windows, float(delay[0, 0]))), axis=-1), many

    def whiten(self, best: Minimum, sizes: tuple[float, float]) -> TwinProblem:
        """The problem with the unknown motion of a screen of that unevenness, and other forces."""
        moved, count = self._unknown(best)
        moved = moved * np.where(np.arange(moved.shape[-1]) < count, *sizes)
        within = np.eye(moved.shape[1]) + moved @ np.swapaxes(moved, -1, -2)
        white = np.linalg.inv(np.linalg.cholesky(within))
        windows = replace(self.windows, white=white, shared=white @ moved[..., :count])
        return replace(self, windows=windows, sizes=sizes)

    def estimate_sizes(self, best: Minimum) -> tuple[float, float]:
        """Sizes of the unknown motion that make a fit's residuals most likely."""
        weight = self.weights(self.linearise(best.theta, best.starts, slopes=False).r)[0]
        plain = replace(self, windows=replace(self.windows, white=None, shared=None))
        line = plain.linearise(best.theta, best.starts)
        moved, count = self._unknown(best)
        found = {}
        for sizes in product(self.noise.unevenness_shares, self.noise.forces_m_s2):
            each = np.where(np.arange(moved.shape[-1]) < count, *sizes)
            left, spread = line.without_starts(moved * each)
            total = np.einsum("w,wij->ij", weight, left)
            normal = total[1:, 1:] + np.diag(self.known[1]) + 1e-9 * np.eye(len(self.names))
            squares = total[0, 0] - total[0, 1:] @ np.linalg.solve(normal, total[1:, 0])
            found[sizes] = squares + weight @ spread + np.linalg.slogdet(normal)[1]
        return min(found, key=lambda sizes: found[sizes])


def fit_twin(
    model: BallPlate,
    windows: Windows,
    names: tuple[str, ...],
    grip: float,
    *,
    uneven: bool = False,
    guesses: Array | None = None,
    selection: TwinSelection = TWIN_SELECTION,
) -> Fit[TwinProblem]:
    """Fit the parameters, from many starts unless guesses are given; ``grip`` as in ``replay``.

    A ball that never starts moving in a replay tells the fit nothing, so its steps must begin near
    the truth: windows in which the ball rolls throughout give rolling friction, delay and level
    from any start; with those, the windows that begin at rest are tried with one breakaway ratio
    after another; from the best of these all windows and all parameters are fitted. Windows that
    are then not explained at all are left out, and the rest is fitted again; so is all if in some
    windows the ball did not rest at first, but crept. Of an uneven screen the patches, and other
    forces that nobody knows, are part of the noise, in the sizes that make the log most likely.
    """
    problem = TwinProblem(windows, names, model, grip, noise=selection.noise)
    if guesses is None:
        tried = _scan_breakaway(problem, _fit_rolling(problem), selection)
    else:
        tried = np.clip(guesses, *problem.bounds)
    found = minimise(problem, tried, fit_starts_from_scratch(problem, tried, 3), 12, 4)
    sizes = selection.noise.initial_sizes
    for _ in range(selection.noise.iterations if uneven else 0):
        problem = problem.whiten(found.best(1), sizes)
        found = minimise(problem, found.theta, found.starts, 15, 4).best(1)
        sizes = problem.estimate_sizes(found)
    if uneven:
        problem = problem.whiten(found, sizes)
        found = minimise(problem, found.theta, found.starts, 15, 4)
    while True:
        best = found.best(1)
        misfit = problem.misfit(best.linearisation.r)[0]
        usual = max(1.0, float(np.median(misfit)))
        kept = misfit < selection.unexplained_misfit_ratio * usual
        if kept.all() or kept.sum() < max(3, len(windows) / 2):
            break
        problem = replace(problem, windows=problem.windows.take(kept))
        found = minimise(problem, found.theta, found.starts[:, :, kept], 15, 4)
    creeping = _find_creeping(problem, best.theta, best.starts, selection)
    if creeping.any():
        crept = np.isin(windows.begin, problem.windows.begin[creeping])
        resting = windows.resting & ~crept
        windows = replace(windows, resting=resting)
        return fit_twin(
            model, windows, names, grip, uneven=uneven, guesses=guesses, selection=selection
        )
    if not uneven:
        return Fit(problem, best)
    # the effect of the patches depends on the ball's path at the best fit
    problem = problem.whiten(best, sizes)
    line = problem.linearise(best.theta, best.starts)
    return Fit(problem, best._replace(linearisation=line))


def _find_creeping(
    problem: TwinProblem, theta: Array, starts: Array, selection: TwinSelection = TWIN_SELECTION
) -> Mask:
    """Windows begun at rest that a ball which creeps at first explains better, shape (W,)."""
    windows = problem.windows
    free = replace(problem, windows=replace(windows, resting=np.zeros_like(windows.resting)))
    going = fit_starts_from_scratch(free, theta, 8)
    rest, roll = (
        problem.misfit(problem.linearise(theta, each, slopes=False).r)[0] * windows.size
        for each in (starts, going)
    )
    return np.asarray(windows.resting & (rest - roll > selection.free_start_gain_limit))


def _has_viscous_friction(fit: Fit[TwinProblem], selection: TwinSelection) -> bool:
    """Whether friction grows with speed, by the first step of a fit with viscous friction."""
    problem = replace(fit.problem, names=(*fit.problem.names, "viscous"))
    theta = np.append(fit.found.theta, [[0.0]], axis=1)
    line = problem.linearise(theta, fit.found.starts)
    free, _ = line.eliminate_starts()
    each = np.einsum("wmi,wmj,w->ij", free[0], free[0], problem.weights(line.r)[0])
    inverse = np.linalg.inv(each[1:, 1:] + np.diag(problem.known[1]))
    return bool(
        -(inverse @ each[1:, 0])[-1] > selection.min_viscous_stds * np.sqrt(inverse[-1, -1])
    )


def _fit_rolling(whole: TwinProblem) -> Array:
    """Candidates for all parameters from the windows that begin in full roll, shape (C, P)."""
    windows, names = whole.windows, whole.names
    if (~windows.resting).sum() < 3:
        return whole.first_guesses(rolling=(5e-5, 1e-4, 2e-4, 4e-4))
    smooth = tuple(name for name in names if name not in ("breakaway", "stribeck", "dwell"))
    problem = replace(whole, windows=windows.take(~windows.resting), names=smooth)
    theta = problem.first_guesses(rolling=(1e-4, 1e-4, 4e-4, 4e-4), delay=(0.02, 0.07, 0.02, 0.07))
    best = minimise(problem, theta, fit_starts_from_scratch(problem, theta, 2), 8).best(1)
    return whole.first_guesses(**dict(zip(smooth, best.theta.T, strict=True)))


def _scan_breakaway(problem: TwinProblem, guesses: Array, selection: TwinSelection) -> Array:
    """The guesses with the breakaway ratios that suit the windows begun at rest, shape (C, P)."""
    windows, names = problem.windows, problem.names
    if not windows.resting.any():
        return guesses
    at_rest = replace(problem, windows=windows.take(windows.resting))
    ratios = selection.breakaway_ratios
    tried = np.repeat(guesses, len(ratios), axis=0)
    tried[:, names.index("breakaway")] = np.tile(ratios, len(guesses))
    fitted = at_rest.linearise(tried, fit_starts_from_scratch(at_rest, tried, 1), slopes=False)
    return np.asarray(tried[np.argsort(at_rest.cost(fitted.r))[: selection.fitted_guesses]])


MAX_CORNER_FREQUENCY_HZ = 1000.0
"""Largest corner frequency in Hz that a scenario takes; drives beyond are as good as ideal."""


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of the averaged residuals within windows.

    Attributes:
        correlation: At lags of 1 sample and more, shape (L,).
        band: What 95 % of white residuals stay within.
        misfit: Mean square residual in noise variances; 1 for a perfect twin.
        test: Constants of the test.
    """

    correlation: Array
    band: float
    misfit: float
    test: WhitenessTest = WHITENESS_TEST

    @property
    def outside(self) -> int:
        """How many of the lags are outside the band; of white residuals one in twenty."""
        return int((np.abs(self.correlation) > self.band).sum())

    @property
    def white(self) -> bool:
        """Whether the model explains the log: if not, no interval holds.

        It does unless the mean square correlation is beyond chance by more than a slight one: a
        log that is long enough distinguishes any replay from the motion.
        """
        test = self.test
        chance = stats.chi2.ppf(test.level, test.lags) / test.lags * (self.band / 1.96) ** 2
        beyond = float((self.correlation**2).mean()) > chance + test.slight_correlation**2
        return not beyond and self.misfit < 1 + test.max_unexplained_share

    @property
    def unexplained(self) -> float:
        """Variance of the motion that the twin does not explain, in noise variances; 0 if white.

        It is no more than moves together at any lag, or exceeds the noise.
        """
        if self.white:
            return 0.0
        return max(float(np.abs(self.correlation).max()), self.misfit - 1)

    @property
    def rejected(self) -> bool:
        """Whether so much is unexplained that no interval is given."""
        return self.unexplained > self.test.max_unexplained_share

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.white:
            return "the residuals look like the sensor's noise"
        what = (
            f"the residuals are not white: {self.outside} of {plural(self.test.lags, 'lag')} "
            "outside "
            f"the band, {self.misfit:.2f} times the sensor's noise; the log holds motion that the "
            f"twin does not explain, {np.sqrt(self.unexplained):.2f} times the noise's standard "
            "deviation"
        )
        if self.rejected:
            return f"{what}: too much for an interval"
        return f"{what}: the intervals include the largest error that it may have caused"

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {"misfit": self.misfit, "lags_outside": self.outside, "words": self.words}


def assess_parameters(
    names: tuple[str, ...], fit: Fit[TwinProblem], drives: Drives | None, left: Whiteness
) -> tuple[ParameterVerdict, ...]:
    """One verdict per parameter asked for, in that order; the level has one for each axis.

    Args:
        names: What was asked for.
        fit: The fit of the ball's motion.
        drives: How they follow; None if no command was recorded.
        left: What the fit leaves over.
    """
    found, ball = [], fit.estimate(white=left.white)
    moved = fit.bound_bias(left.unexplained)
    for name in names:
        if name in HIDDEN_PARAMETERS:
            why = "neither ball nor plate positions show it"
            found.append(ParameterVerdict.unknown(HIDDEN_PARAMETERS[name], name, why))
        elif name == "servo":
            found.append(_assess_servo(drives))
        else:
            each_axis = LEVELS[: fit.problem.windows.axes] if name == "level" else (name,)
            found += [
                _assess_ball(each, fit, ball, moved, rejected=left.rejected) for each in each_axis
            ]
    return tuple(found)


def whiteness(fit: Fit[TwinProblem], test: WhitenessTest = WHITENESS_TEST) -> Whiteness:
    """How white the residuals of a fit are, corrected for the starts that are fitted as well."""
    windows, every = fit.problem.windows, fit.found.linearisation
    axes = windows.axes
    products, counts = np.zeros((2, test.lags + 1))
    for r, Z, weight in zip(every.r[0], every.by_start[0], windows.weight, strict=True):  # noqa: N806
        there = np.outer((weight > 0).all(axis=-1), np.arange(2) < axes).ravel()
        r, Z = r[there], Z[there]  # noqa: N806, PLW2901
        taken = Z @ np.linalg.solve(Z.T @ Z + START_PRIOR, Z.T)
        for lag in range(min(test.lags + 1, len(r) // axes)):
            alike = r[axes * lag :] @ r[: len(r) - axes * lag]
            products[lag] += alike + (np.trace(taken, axes * lag) if lag else 0.0)
            counts[lag] += len(r) - axes * lag
    variance = products[0] / max(counts[0], 1)
    correlation = products[1:] / np.maximum(counts[1:], 1) / max(variance, 1e-300)
    return Whiteness(
        correlation,
        1.96 / float(np.sqrt(max(counts[0], 1))),
        float(fit.problem.misfit(every.r).mean()),
        test,
    )


def _assess_ball(
    name: str, fit: Fit[TwinProblem], ball: Estimate, moved: Array, *, rejected: bool
) -> ParameterVerdict:
    """The verdict of a parameter of the ball.

    Args:
        name: Which.
        fit: The fit of the ball's motion.
        ball: Its estimate.
        moved: By how much unexplained motion may have moved each parameter, SI units, shape (P,).
        rejected: Whether the log rejects the model.
    """
    about, k = BALL_PARAMETERS[name], fit.problem.names.index(name)
    half = max(float(np.hypot(ball.half_width[k], moved[k])), about.floor)
    value = float(ball.value[k])
    never = name in {"breakaway", "stribeck", "dwell"} and not fit.problem.windows.resting.any()
    if never or not math.isfinite(half):
        why = "the ball never rests" if never else "the log does not show it"
        return ParameterVerdict.unknown(about, name, why)
    found = ParameterVerdict(about=about, name=name, value=about.factor * value)
    if rejected:
        why = "best fit only: the log holds motion that the twin does not explain"
        return replace(found, word=REJECTED_VERDICT, why=why)
    low, high = max(value - half, about.least), min(value + half, about.most)
    if name == "delay" and value > about.most - half:
        why = f"at its bound of {about.most:g} s: give the log with --columns, which takes 1 s"
        low = about.factor * (value - half)
        return replace(found, low=low, word=BOUNDED_VERDICT, why=why)
    found = replace(found, low=about.factor * low, high=about.factor * high)
    if half <= about.allowed_half_width(value):
        return replace(found, word=IDENTIFIED_VERDICT)
    alike = np.abs(ball.correlation[k]) > MAX_CORRELATION
    others = [other for other, same in zip(fit.problem.names, alike, strict=True) if same]
    others.remove(name)
    why = f"not distinguishable from {', '.join(others)}" if others else "its interval is too wide"
    at_edge = value <= about.least + half or value >= about.most - half
    word = (
        BOUNDED_VERDICT if at_edge and high - low < about.most - about.least else NOT_IDENTIFIABLE
    )
    return replace(found, word=word, why=f"{why}; {about.experiment}")


def _assess_servo(drives: Drives | None) -> ParameterVerdict:
    found = ParameterVerdict(about=SERVO_PARAMETER, name="servo")
    if drives is None:
        return replace(found, why=f"no commanded rates in the log; {SERVO_PARAMETER.experiment}")
    lag, half = drives.lag, math.hypot(drives.half_width, SERVO_PARAMETER.floor)
    if not math.isfinite(half):
        return replace(found, why=f"the plate hardly moves; {SERVO_PARAMETER.experiment}")
    low = corner_frequency(lag + half)
    if lag <= half or corner_frequency(lag) > MAX_CORNER_FREQUENCY_HZ:
        why = f"faster than the log shows: above {low:.3g} Hz; {SERVO_PARAMETER.experiment}"
        return replace(found, low=low, word=BOUNDED_VERDICT, why=why)
    value, high = corner_frequency(lag), corner_frequency(lag - half)
    good = half <= SERVO_PARAMETER.allowed_half_width(lag)
    why = "" if good else f"its interval is too wide; {SERVO_PARAMETER.experiment}"
    word = IDENTIFIED_VERDICT if good else NOT_IDENTIFIABLE
    return replace(found, value=value, low=low, high=high, word=word, why=why)


def replay_log(
    log: PreparedLog, fit: Fit[TwinProblem], lag: float, how: HoldOutPrediction = HOLD_OUT
) -> dict[str, Predicted]:
    """Replay a part of a log by a fitted twin from many starts: both axes, or none if too short.

    Args:
        log: The part held out.
        fit: The parameters.
        lag: Time constant of the drives in s.
        how: Constants of the predictions.
    """

    def overlapping_spans(_: Segment, begin: float, end: float, longest: float) -> Spans:
        begins = np.arange(begin, end - longest, how.interval_s)
        return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))

    longest = how.lead_s + how.horizons_s[-1] + how.horizon_tolerance_s
    windows = cut(log, lag, longest, overlapping_spans)
    if windows is None:
        return {}
    lead = LOOKBACK_S + how.lead_s
    there = windows.weight[..., 0] > 0
    before = (there & (windows.time < lead)).sum(axis=1)
    windows = windows.take((before >= 3) & (there.sum(axis=1) > before))
    if not len(windows):
        return {}
    problem, theta = replace(fit.problem, windows=windows), fit.found.theta
    frictionless = theta.copy()
    for name, value in (("rolling", 0.0), ("breakaway", 1.0), ("viscous", 0.0)):
        if name in problem.names:
            frictionless[:, problem.names.index(name)] = value
    predictors = {"model": theta, "without friction": frictionless}
    return predict_windows(problem, lead, predictors, "xy"[: windows.axes], how)


@dataclass(frozen=True, kw_only=True)
class TwinIdentification(Identification):
    """Identification of a rig like the twin's from a log.

    Attributes:
        log: The part of it that was used.
        fit: The best fit.
        whiteness: What the fit leaves over.
    """

    log: PreparedLog
    fit: Fit[TwinProblem]
    whiteness: Whiteness

    def settings(self, words: Collection[str]) -> dict[str, str]:
        """Scenario keys to values in TOML with remarks, of those with one of some verdicts.

        Over a rig's file, dead time and lag are also what law and observer assume, as in the file.
        """
        known = {
            each.name: each
            for each in self.verdicts
            if each.word in words and each.value is not None
        }
        pair = [known.pop(name, None) for name in LEVELS]
        values = {
            each.about.key: f"{each.value:z.6g}  # {each.interval}, 95 %" for each in known.values()
        }
        if any(pair):
            level = ", ".join("0.0" if each is None else f"{each.value:z.6g}" for each in pair)
            known_ends = pair[: self.log.axes]
            ends = "; ".join("unknown" if each is None else each.interval for each in known_ends)
            values["plant.level_deg"] = f"[{level}]  # {ends}, 95 %"
        delay, corner = known.get("delay"), known.get("servo")
        if self.on and delay and delay.value is not None:
            values["predictor.delay"] = f"{delay.value:.6g}  # as found"
        if self.on and corner and corner.value:
            values["rig.plate_lag"] = f"{time_constant(corner.value):.6g}  # of these drives"
        return values | self.over

    def as_dict(self) -> dict[str, Any]:
        """The numbers, for ``--json``."""
        found = super().as_dict()
        older = {"twin": "model", "frictionless": "without friction", "still": "stays"}
        errors = [each["median"] for each in found["held_out"]]
        replay = [{old: each[now] for old, now in older.items()} for each in errors]
        return {
            **found,
            "replay_error": {"ahead": found["ahead"], **replay[0]} if replay else None,
            "usable_seconds": self.log.length,
            "residuals": self.whiteness.as_dict(),
            "fit": asdict(self.fit.found.termination),
        }


def fit_windows(
    log: PreparedLog,
    windows: Windows,
    names: tuple[str, ...],
    selection: TwinSelection = TWIN_SELECTION,
    progress: Callable[[float], None] = lambda _: None,
    guess: Mapping[str, float] | None = None,
) -> tuple[tuple[str, ...], Fit[TwinProblem], Whiteness, list[str]]:
    """Fit the parameters, on an even screen or, if that does not explain the log, an uneven one.

    Args:
        log: The log, with the kinds of friction at rest to try.
        windows: Its windows.
        names: The requested parameters.
        selection: Constants of the fit.
        progress: Called with the share of the work done.
        guess: Every ball parameter by name, in SI units, where a fit begins; None to search.

    Returns:
        The fitted parameters (viscous friction may be added), the fit, the whiteness of its
        residuals, and notes for the report.
    """

    def best(asked: tuple[str, ...], *, uneven: bool = False) -> Fit[TwinProblem]:
        fitted = fitted_parameters(asked, windows.axes)
        guesses = None if guess is None else np.array([[guess[name] for name in fitted]])
        fits = [
            fit_twin(
                log.model,
                windows,
                fitted,
                grip,
                uneven=uneven,
                guesses=guesses,
                selection=selection,
            )
            for grip in log.grips
        ]
        return min(fits, key=lambda each: each.found.cost[0])

    fit, notes = best(names), list[str]()
    white = whiteness(fit)
    progress(0.4)
    if white.white and len(fit.problem.windows) >= selection.even_screen_share * len(windows):
        return names, fit, white, notes
    more: tuple[str, ...] = AT_REST
    rough = best((*names, *more), uneven=True)
    if "viscous" not in names and _has_viscous_friction(rough, selection):
        more = (*more, "viscous")
        rough = best((*names, *more), uneven=True)
    left = whiteness(rough)
    if not white.white or (left.white and any(rough.problem.sizes)):
        fit, white = rough, left
        notes.append(
            "friction that differs from place to place, and other unknown forces, are taken as "
            "a part of the noise: without it the log is not explained; a longer log tells more"
        )
        if "viscous" in more:
            names = (*names, "viscous")
            notes.append("friction grows with speed: viscous friction fitted along")
    return names, fit, white, notes


def _describe_fit(
    log: Log, usable: PreparedLog, fit: Fit[TwinProblem], windows: int
) -> Iterator[str]:
    """Notes on the log and its fit; ``windows`` is the number of windows before the fit."""
    if len(usable.grips) > 1:
        kind = "softened as in the mechanism" if fit.problem.grip else "sharp as in Coulomb's law"
        yield f"friction at rest taken to be {kind}, which fits better"
    if left_out := windows - len(fit.problem.windows):
        of_all = plural(windows, "window")
        yield f"{left_out} of {of_all} left out: no replay explains the ball there"
    if not log.scenario and not log.age.any():
        yield "column age missing or zero: a wait for a frame is counted in the dead time"
    if usable.segments[0].command is None:
        yield "no commanded rates in the log: the plate is taken from its encoders alone"


def identify_twin(
    log: Log,
    names: tuple[str, ...],
    share: float = FITTED_SHARE,
    progress: Callable[[float], None] = lambda _: None,
    selection: TwinSelection = TWIN_SELECTION,
    how: HoldOutPrediction = HOLD_OUT,
) -> TwinIdentification:
    """Fit the parameters of these names to the first share of a log and try them on the rest.

    Args:
        log: The log.
        names: The requested parameters, of ``PARAMETER_CHOICES``.
        share: Share of the usable time that is fitted; 1 holds nothing out.
        progress: Called with the share of the work done.
        selection: Constants of the fit.
        how: Constants of the predictions of the held-out part.

    Raises:
        LogError: If the log is broken, or nothing can be learned from it.
    """
    check_ranges(log)
    usable = prepare(log)
    check_motion(usable)
    known, unknown = usable.split(share) if share < 1 else (usable, None)
    drives = fit_drives(known)
    lag = 0.0 if drives is None else drives.lag
    progress(0.1)
    windows = cut(known, lag, selection.max_window_s, moving_spans)
    if windows is None or len(windows) < 3:
        raise LogError(
            f"{usable.source}: too short: {known.length:.0f} s give "
            f"{plural(0 if windows is None else len(windows), 'window')} to fit, at least 3 are "
            "needed"
        )

    names, fit, white, notes = fit_windows(usable, windows, names, selection, progress)
    notes = [*usable.notes, *notes, *_describe_fit(log, usable, fit, len(windows))]
    tried = replay_log(unknown, fit, lag, how) if unknown is not None and unknown.segments else {}
    if not tried and share < 1:
        notes.append("too little left to hold out")
    progress(1.0)
    words, known_of = white.words, assess_parameters(names, fit, drives, white)
    if all(each.word != IDENTIFIED_VERDICT for each in known_of):
        notes.append(
            "nothing was identified: two minutes of the scenario excite would show more; a "
            "twin that follows a log needs no file: ballplate shadow LOG --learn"
        )
    return TwinIdentification(
        source=usable.source,
        extent=f"{usable.source}: {usable.length:.1f} usable seconds, of which {known.length:.1f} "
        f"were fitted, in {plural(len(fit.problem.windows), 'window')}; {fit.found.termination}.",
        remarks=(f"{words[0].upper()}{words[1:]}.",),
        log=usable,
        seconds=known.length,
        fit=fit,
        verdicts=known_of,
        scores=(score(tried),) if tried else (),
        predictions=tried,
        whiteness=white,
        notes=tuple(notes),
        on=rig_of(log.scenario),
        how=how,
    )
