"""The plain model of any rig's axis, fitted to simulated windows with free initial states.

    x'' = gain (u - lever u''/g) + level + camber x - viscous x' - friction sign(x')

u is the command behind a first-order lag, or the measured angle, a dead time ago; a ball that
friction can hold rests. The lever is how far above the plate's axis the ball is as good as. Axes
are independent but for friction. Dead time is all between command and measured ball.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.optimize import least_squares

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.base.errors import LogError
from twin.identify.axis_logs import MAX_COMMAND_GAP_S, AxisLog, EndStops
from twin.identify.command_model import (
    DEAD_BAND_SCAN,
    DRIVE_EFFECTS,
    PROFILED_EFFECTS,
    DeadBandScan,
    TiltHistory,
    residual_by_dead_band,
)
from twin.identify.first_look import FirstLook
from twin.identify.least_squares import (
    BOOTSTRAP,
    Estimate,
    Fit,
    FitProblem,
    Linearisation,
    SampleWindows,
    StepControl,
    estimate,
    fit_starts,
    fit_starts_from_scratch,
    minimise,
)
from twin.identify.parameters import PLAIN_PARAMETERS
from twin.identify.verdicts import (
    HOLD_OUT,
    PREDICTOR_NAMES,
    HoldOutPrediction,
    Predicted,
    absolute_quantile,
    predict_windows,
)
from twin.identify.windows import MIN_WINDOW_SHARE, SAMPLE_BIN_S, axis_windows, spans

SIMULATION_STEP_S = 0.016
"""Step of the simulation in s: it moves positions by 0.03 mm RMS, less than 0.1 mm."""
CROSSING_STEP_S = 0.008
"""The same where friction acts along both axes: it turns with the direction of the ball."""
BLOCK_LANES = 3000
"""Largest number of balls that are simulated together: their arrays stay in the cache."""
MAX_KNOWN_TILTS = 1_000_000
"""Integrals of tilts over steps that are kept for further simulations of the same windows."""
MIN_CROSS_SPEED_RATIO = 0.3
"""Speed along the other axis, over the largest change of speed in a step, above which friction acts
on both axes together."""
WHITE_RATIO_STD = 1.7
"""Standard deviation of the ratio by which ``AxisFit.explained`` judges, for N white residuals in
windows of 25 to 250, times the square root of N: by simulation."""
START_PRECISION = np.diag(np.array([0.02, 0.3]) ** -2.0)
"""Weak knowledge of a start: m and m/s."""
START_STEPS = np.array([1e-4, 1e-3, 1e-3])
"""Steps of finite differences of a start: m, m/s, and m/s^2 of a level of its own."""
ADMIXTURE_DIFFERENCE = 0.02
"""Step of finite differences of a further tilt, in swings of the tilt."""
SMOOTH_PARAMETERS = ("gain", "dead_time", "lag", "level")
"""Parameters that are always fitted; the lag of a measured angle is 0."""


AXIS_STEP_CONTROL = StepControl(drops_idle=True)


@dataclass(frozen=True, kw_only=True)
class AxisSearch:
    """Constants of the fit of an axis from no first guess.

    Attributes:
        friction_guesses_m_s2: First guesses of friction.
        delay_guesses_s: First guesses of the dead time.
        lag_guesses_s: Lags that are tried instead of dead time.
        tilt_gain_m_s2: First guess of the gain per rad: between a hollow ball and a solid one.
        first_window_s: Length of the windows of the first fit, which converges from any guess.
        disturbed_residual_ratio: Residual of such a window over the usual one above which a hand,
            the rim or a false sample disturbed it: no longer window contains it.
        outlier_ratio: Residual of a sample over its window's residual above which it is left out.
        lag_steps: Steps after which only the best lags are continued: most lead to the same fit.
        continued_lags: Number of these.
        control: Constants of the minimisations.
    """

    friction_guesses_m_s2: tuple[float, ...] = (0.0, 0.02, 0.08, 0.25)
    delay_guesses_s: tuple[float, ...] = (0.02, 0.1, 0.2, 0.35)
    lag_guesses_s: tuple[float, ...] = (0.02, 0.045, 0.07, 0.1, 0.14)
    tilt_gain_m_s2: float = 6.5
    first_window_s: float = 0.8
    disturbed_residual_ratio: float = 5.0
    outlier_ratio: float = 4.0
    lag_steps: int = 4
    continued_lags: int = 2
    control: StepControl = AXIS_STEP_CONTROL


@dataclass(frozen=True, kw_only=True)
class DriveSearch:
    """Constants of the search for drive effects, and of likelihood profiles.

    Attributes:
        value_factors: Factors on the fitted value for the likelihood profile.
        interpolated_points: Values between those tried at which the costs of windows are
            interpolated.
        height_std_m: Standard deviation of a given height.
        accepted_residual_share: A drive effect is accepted if it reduces the residual to this
            share.
        rival_residual_ratio: A drive effect is a rival of the accepted one if its residual is less
            than this multiple: the two are not distinguished.
        dead_band_residual_share: A dead band is fitted if its regression leaves no more than this
            share of what an ideal drive leaves.
        fitted_dead_bands: Number of dead bands with the smallest residuals that are fitted.
        useful_cost_share: An effect whose first fits do not reduce the cost to this share is not
            fitted further: it would not reduce the residual to ``accepted_residual_share``.
        white_share: The residuals count as white if the scatter of successive ones, over the
            scatter of white ones, is above this, or is what few white ones may have by chance. It
            exceeds ``accepted_residual_share``: no drive effect would then be accepted.
        white_stds: Standard deviations of that ratio below one that count as chance.
        scan_windows: Number of windows by which values of a profile are rejected in advance.
        bracket_rise: Smallest rise of the cost in any draw at which the profile of a fit with white
            residuals ends: twice the largest difference of Gumbel numbers of a lever.
        scan: Constants of that regression.
    """

    value_factors: tuple[float, ...] = (
        *(0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 1.0),
        *(1.005, 1.01, 1.02, 1.05, 1.1, 1.2),
    )
    interpolated_points: int = 200
    height_std_m: float = 0.005
    accepted_residual_share: float = 0.9
    rival_residual_ratio: float = 1.5
    dead_band_residual_share: float = 0.7
    fitted_dead_bands: int = 8
    useful_cost_share: float = 0.97
    white_share: float = 0.95
    white_stds: float = 2.0
    scan_windows: int = 20
    bracket_rise: float = 32.0
    scan: DeadBandScan = DEAD_BAND_SCAN


@dataclass(frozen=True, kw_only=True)
class PredictionFit:
    """Constants of the fit to predictions, and of a level that is followed.

    Attributes:
        level_history_s: Length of the samples from which a followed level is estimated.
        level_std_m_s2: Standard deviation of a followed level about the level of the fit.
        huber_error_m: Error of a prediction above which its cost is linear, not quadratic.
        max_delay_and_lag_s: Largest dead time and lag of this fit.
        initial_values: First guesses of this fit, next to those of a fit to windows.
        max_predictions: Largest number of predictions by which fits are compared.
        continued_guesses: Number of the best first guesses that are continued.
        max_evaluations: Largest number of evaluations from each.
        cost_tolerance: Relative decrease of the cost by a step below which a fit ends.
    """

    level_history_s: float = 2.4
    level_std_m_s2: float = 0.1
    huber_error_m: float = 0.003
    max_delay_and_lag_s: float = 0.5
    initial_values: tuple[tuple[str, float], ...] = (
        ("dead_time", 0.1),
        ("lag", 0.1),
        ("friction", 0.03),
    )
    max_predictions: int = 150
    continued_guesses: int = 2
    max_evaluations: int = 40
    cost_tolerance: float = AXIS_STEP_CONTROL.cost_tolerance


@dataclass(frozen=True, kw_only=True)
class AxisFitting:
    """All constants of the fit of an axis.

    Attributes:
        search: Of the fit from no first guess.
        drives: Of the search for drive effects.
        prediction: Of the fit to predictions.
        hold_out: Of the predictions.
    """

    search: AxisSearch = AxisSearch()
    drives: DriveSearch = DriveSearch()
    prediction: PredictionFit = PredictionFit()
    hold_out: HoldOutPrediction = HOLD_OUT


AXIS_FITTING = AxisFitting()


@dataclass(frozen=True)
class AxisProblem(FitProblem[SampleWindows]):
    """Simulations of one axis.

    Attributes:
        tilt: The commands or angles that tilt the plate.
        longest: Length of the simulation in s.
        delays: Smallest and largest dead time in s.
        drift: Standard deviation in m/s^2 of a level of each window's own, which is then the
            third number of its start; 0 for none.
        stops: The end stops at which a ball bounces; None where no window touches one.
        known_tilts: Integrals of tilts in the windows that were needed so far, by their drives.
    """

    tilt: TiltHistory
    longest: float
    delays: tuple[float, float]
    drift: float = 0.0
    stops: EndStops | None = None
    known_tilts: dict[tuple[float, ...], Array] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    about = PLAIN_PARAMETERS
    start_steps = START_STEPS
    prior = START_PRECISION
    grows = True

    @property
    def step(self) -> float:
        """Step of the simulation in s."""
        return CROSSING_STEP_S if self.tilt.log.across[1].any() else SIMULATION_STEP_S

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values of the parameters, shapes (P,)."""
        least, most = super().bounds
        at = self.names.index("dead_time")
        least[at], most[at] = self.delays
        return least, most

    @property
    def rigid_starts(self) -> int:
        """How many of the first numbers of a start merely shift all positions of a simulation."""
        return int("camber" not in self.names and self.stops is None)

    def take(self, which: Mask) -> Self:
        """The problem of some of the windows."""
        if which.all():
            return self
        found = super().take(which)
        for drive, tilted in self.known_tilts.items():
            found.known_tilts[drive] = tilted[:, which]
        return found

    def first_part(self, seconds: float) -> Self:
        """The problem of the samples in the first seconds of each window, simulated no longer."""
        found, bins = super().first_part(seconds), int(seconds / SAMPLE_BIN_S) + 2
        windows = replace(
            found.windows,
            **{name: getattr(found.windows, name)[:, :bins] for name in ("time", "ball", "weight")},
        )
        longest = min(self.longest, seconds + SAMPLE_BIN_S)
        return replace(found, windows=windows, longest=longest)

    def initial_starts(self) -> Array:
        """A straight line through the first samples of each window, shape (2 or 3, 1, W)."""
        out = np.zeros((3 if self.drift else 2, 1, len(self.windows)))
        time, there = self.windows.time, self.windows.weight[..., 0] > 0
        third = np.max(time, axis=1, where=there & (there.cumsum(axis=1) == 3), initial=0.3)
        first = there & (time < third[:, None] + 1e-6)
        count = np.maximum(first.sum(axis=1), 1)
        middle, place = (
            (each * first).sum(axis=1) / count for each in (time, self.windows.ball[..., 0])
        )
        since = np.where(first, time - middle[:, None], 0.0)
        square = (since**2).sum(axis=1)
        speed = (since * self.windows.ball[..., 0]).sum(axis=1) / np.maximum(square, 1e-12)
        out[0, 0], out[1, 0] = place - speed * middle, speed
        return out

    def simulate(self, theta: Array, starts: Array) -> Array:
        """Positions in m at every step, shape (N, C, W).

        Args:
            theta: Parameters, shape (C, P) or (C, W, P), in which case dead time and lag of a
                candidate are those of its first window.
            starts: Position, velocity and, where the level is followed, its deviation.
        """
        each = theta if theta.ndim > 2 else theta[:, None]
        values = {name: each[..., k] for k, name in enumerate(self.names)}
        zero = np.zeros((len(theta), 1))
        gain, level, camber, viscous, friction = (
            values.get(name, zero) for name in ("gain", "level", "camber", "viscous", "friction")
        )
        h = self.step
        steps = int(np.ceil(self.longest / h)) + 1
        grid = self.windows.begin + h * np.arange(steps)[:, None]
        names = ("dead_time", "lag", *PROFILED_EFFECTS)
        drives = np.stack([values.get(name, zero)[:, 0] for name in names], axis=-1)
        kinds, which = np.unique(drives, axis=0, return_inverse=True)
        tilted = np.stack([self._tilted(grid, *each) for each in kinds.tolist()], axis=1)
        across = None
        if self.tilt.log.across[1].any():
            across = np.interp(grid, *self.tilt.log.across)
        off_level = starts[2] if len(starts) > 2 else np.zeros_like(starts[0])
        out = np.empty((steps, *starts.shape[1:]))
        # blocks of candidates so small that their arrays stay in the processor's cache
        size = max(1, BLOCK_LANES // len(self.windows))
        for first in range(0, len(theta), size):
            part = slice(first, first + size)
            rows = slice(None) if len(gain) == 1 else part
            push = gain[rows] * tilted.take(which[part], axis=1)
            push += h * (level[rows] + off_level[part])
            out[:, part] = _integrate(
                h,
                starts[:2, part],
                push,
                camber[rows],
                viscous[rows],
                friction[rows],
                across,
                self.stops,
            )
        return out

    def _tilted(self, grid: Array, delay: float, *drive: float) -> Array:
        """Integral of the tilt over each step of the simulation, shape (N - 1, W).

        Args:
            grid: Times of the steps in s, shape (N, W).
            delay: Dead time in s.
            drive: Lag, dead band, play, slew and lever, as ``TiltHistory.integrate`` takes them.
        """
        key, known = (delay, *drive), self.known_tilts
        if key not in known:
            if len(known) * grid.size > MAX_KNOWN_TILTS:
                known.clear()
            known[key] = np.diff(self.tilt.integrate(grid - delay, *drive), axis=0)
        return known[key]

    def simulate_samples(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """A simulation at the samples in m, and its rate in m/s, shape (C, W, B, 1)."""
        places = self.simulate(theta, starts)
        at = self.windows.time / self.step
        low = np.minimum(at.astype(int), len(places) - 2)
        rows = np.arange(len(self.windows))[:, None]
        first, second = (np.moveaxis(places[low + k, :, rows], -1, 0) for k in (0, 1))
        found = np.asarray(first + (at - low) * (second - first))
        return found[..., None], ((second - first) / self.step)[..., None]

    def linearise(self, theta: Array, starts: Array, *, slopes: bool = True) -> Linearisation:
        """Residuals and slopes of C candidates, and how far a window's own level is off."""
        found = super().linearise(theta, starts, slopes=slopes)
        if not self.drift:
            return found
        # one value more: the difference of the window's own level from the common level
        r = np.concatenate((found.r, starts[2][..., None] / self.drift), axis=-1)
        room = [*[(0, 0)] * 2, (0, 1), (0, 0)]
        by_start = np.pad(found.by_start, room)
        by_start[..., -1, 2] = 1 / self.drift
        prior = np.diag([*np.diag(START_PRECISION), 1e-6])
        return Linearisation(r, by_start, np.pad(found.by_parameter, room), prior)


def _integrate(
    h: float,
    starts: Array,
    push: Array,
    camber: Array,
    viscous: Array,
    friction: Array,
    across: Array | None,
    stops: EndStops | None = None,
) -> Array:
    """Positions in m at every step by Heun's method, friction apart, shape (N, C, W).

    Args:
        h: Step in s.
        starts: Positions in m and velocities in m/s at the first step, shape (2, C, W).
        push: Change of velocity by tilt and level in each step in m/s, shape (N - 1, C, W); it is
            overwritten.
        camber: 1/s^2, shape (C, 1) or (C, W).
        viscous: 1/s, same shape.
        friction: m/s^2, same shape.
        across: Speed along the other axis in m/s, shape (N, W); None if friction acts on this axis
            alone.
        stops: End stops at which the ball bounces; None without any.
    """
    shape, count = starts.shape[1:], len(push)
    # velocities by half a step, so that a step moves a ball by the sum of both; it is linear in
    # push, p and v, but for friction
    half = h / 2
    push *= half * (1 - half * viscous)
    kept = 1 + h * (half * (camber + viscous**2) - viscous)
    by_place, most, kept = (
        np.broadcast_to(each, shape).ravel()
        for each in (half * h * camber * (1 - half * viscous), half * h * friction, kept)
    )
    bends, damps, rubs = by_place.any(), (kept != 1).any(), most.any()
    places = np.empty((count + 1, *shape))
    places[0] = starts[0]
    p, v = places[0].ravel(), half * starts[1].ravel()
    spare, against = np.empty((2, *p.shape))
    turns = np.empty(p.shape, bool)
    steps, rows = push.reshape(count, -1), places[1:].reshape(count, -1)
    for n in range(count):
        stays = np.multiply(kept, v, out=spare) if damps else v
        free = np.add(steps[n], stays, out=steps[n])
        if bends:
            free += np.multiply(by_place, p, out=spare)
        after = free
        if rubs:
            np.copysign(most, v, out=against)
            after = np.subtract(free, against, out=spare)
            against *= after
            turned = np.less(against, 0.0, out=turns).nonzero()[0]
            if turned.size:
                _turn(turned, v, free, most, after)
            if across is not None:
                lanes = (each.reshape(shape) for each in (v, free, most, after))
                _rub_aslant(half * across[n], *lanes)
            spare = v
        v += after
        p, v = np.add(p, v, out=rows[n]), after
        if stops is not None:
            _bounce(p, v, stops)
    return places


def _bounce(p: Array, v: Array, stops: EndStops) -> None:
    """Put balls that went through an end stop back to it, and turn their velocities, in place."""
    beyond = p > stops.high
    beyond |= p < stops.low
    at = beyond.nonzero()[0]
    if at.size:
        at = at[np.where(p[at] > stops.high, v[at], -v[at]) > 0]
        v[at] *= -stops.restitution
        p[at] = np.clip(p[at], stops.low, stops.high)


def _turn(at: NDArray[np.intp], v: Array, free: Array, most: Array, after: Array) -> None:
    """Correct velocities after a step in which a ball turns or rests: ``after``, at flat indices.

    Friction acts against the old direction, then against the new one.

    Args:
        at: The balls that friction against their old direction would turn.
        v: Velocities before, shape (L,).
        free: After the step without friction, same shape.
        most: Largest change by friction, same shape.
        after: After the step with friction against the old direction.
    """
    pushed, taken = free.take(at), most.take(at)
    pushed -= v.take(at)
    np.abs(pushed, out=pushed)
    share = pushed - taken
    np.maximum(share, 0.0, out=share)
    pushed += taken
    share /= pushed
    share *= after.take(at)
    after.put(at, share)


def _rub_aslant(across: Array, v: Array, free: Array, most: Array, after: Array) -> None:
    """Correct velocities of balls that roll along the other axis as well: ``after``.

    Friction acts against the mean direction of the step.
    """
    before = np.maximum(np.hypot(v, across), 1e-300)
    end = free - most * v / before
    mean = (v + end) / (before + np.hypot(end, across))
    aslant = across >= MIN_CROSS_SPEED_RATIO * (np.abs(free - v) + most)
    np.copyto(after, free - most * mean, where=aslant)


@dataclass(frozen=True)
class Profile:
    """Fits with a parameter held at each of several values.

    Attributes:
        name: The parameter.
        names: Of all of them.
        theta: The fits, by rising values of it, shape (K, P).
        costs: Cost of each window, shape (K, W).
        own: Index of the fit that is reported.
        known: Whether the parameter is a lever that is given, with the error of a ruler.
        how: Constants of the profile.
        draws: Number of bootstrap draws.
    """

    name: str
    names: tuple[str, ...]
    theta: Array
    costs: Array
    own: int
    known: bool = False
    how: DriveSearch = AXIS_FITTING.drives
    draws: int = BOOTSTRAP.draws

    @property
    def closed(self) -> tuple[bool, bool]:
        """Whether no draw of the windows takes the first value, and none the last."""
        rise = self.costs[[0, -1]] - self.costs[self.own]
        least = (self._draw_weights() @ rise.T).min(axis=0)
        below, above = (least > self.how.bracket_rise).tolist()
        return below, above

    def _draw_weights(self) -> Array:
        """Weights of the windows in each draw, shape (draws, W)."""
        return np.random.default_rng(1).exponential(size=(self.draws, self.costs.shape[1]))

    @property
    def contenders(self) -> Mask:
        """Values that some draw of the windows may take, and those next to them, shape (K,)."""
        drawn = self._draw_weights() @ self.costs.T
        rise = (drawn - drawn.min(axis=1, keepdims=True)).min(axis=0)
        near = maximum_filter1d((rise < self.how.bracket_rise).astype(np.uint8), 3, mode="nearest")
        near[self.own] = 1
        return np.asarray(near > 0)

    def join(self, other: Profile) -> Profile:
        """Profile over the values of both."""
        theta = np.concatenate((self.theta, other.theta))
        order = np.argsort(theta[:, self.names.index(self.name)])
        costs = np.concatenate((self.costs, other.costs))[order]
        own = int(np.flatnonzero(order == self.own)[0])
        return replace(self, theta=theta[order], costs=costs, own=own)

    @cached_property
    def deviations(self) -> dict[str, Array]:
        """Deviations of the parameters in the best fits of windows drawn at random, (draws,) each.

        The Bayesian bootstrap: each window has an exponential weight. A lever is drawn by its
        likelihood, as the largest sum of a Gumbel number and its logarithm, and has the error of a
        ruler; one that is given has that error alone, whatever the windows say.
        """
        held = self.theta[:, self.names.index(self.name)]
        places = np.linspace(0, len(held) - 1, self.how.interpolated_points)
        fine = np.interp(places, np.arange(len(held)), held)
        costs, theta = (
            np.stack([np.interp(fine, held, each) for each in part.T], axis=-1)
            for part in (self.costs, self.theta - self.theta[self.own])
        )
        rng = np.random.default_rng(1)
        drawn = rng.exponential(size=(self.draws, costs.shape[1])) @ costs.T
        if self.name == "lever":  # windows of one frequency agree in what they hardly know
            drawn -= 2 * rng.gumbel(size=drawn.shape)
            best = 0.0 if self.known else fine[drawn.argmin(axis=1), None]
            drawn = (fine - best - rng.normal(0.0, self.how.height_std_m, (self.draws, 1))) ** 2
        return dict(zip(self.names, theta[drawn.argmin(axis=1)].T, strict=True))


def profile(
    fit: AxisFit, name: str, values: Sequence[float] | Array, *, thorough: bool = True
) -> Profile:
    """Fits with a parameter at each of K rising values, begun from one fit.

    Args:
        fit: From which they begin.
        name: The parameter.
        values: Its values.
        thorough: Whether fits converge, and a fit of a lever with a lag is also begun from the fits
            at the neighbouring values, of which the best one is kept: a ball that sticks for a
            moment has many local minima. Else the fits only show which value is near the best.
    """
    names = tuple(dict.fromkeys((*fit.problem.names, name)))
    problem, at, K = replace(fit.problem, names=names), names.index(name), len(values)  # noqa: N806
    theta = np.array([[fit.value(each) for each in names]]).repeat(K, axis=0)
    starts, costs = fit.found.starts.repeat(K, axis=1), np.full((K, 1), np.inf)
    own = int(np.abs(np.subtract(values, theta[0, at])).argmin())
    hides = name == "lever" and "lag" in names
    for offset in (0, 1, -1) if hides and thorough else (0,):
        source = np.clip(np.arange(K) + offset, 0, K - 1)
        guess = theta[source]
        guess[:, at] = values
        if hides:  # to second order lag^2 / 2 - lever / g shows, and the sum of lag and dead time
            more = 2 / BallPlate.gravity * (guess[:, at] - theta[source, at])
            lags = np.sqrt(np.maximum(guess[:, names.index("lag")] ** 2 + more, 1e-6))
            guess = _with_lags(guess, names, lags, problem.delays)
        begin = fit_starts(problem, guess, starts[:, source], 4)
        steps = 12 if thorough else 6
        found = minimise(problem, guess, begin, steps, 2, 2, fit.how.search.control)
        each = problem.costs(found.linearisation.r)
        better = each.sum(axis=1, keepdims=True) < costs.sum(axis=1, keepdims=True)
        theta, costs = np.where(better, found.theta, theta), np.where(better, each, costs)
        starts = np.where(better, found.starts, starts)
    known = name == "lever" and fit.log.lever is not None
    return Profile(name, names, theta, costs, own, known, fit.how.drives)


def profile_contenders(fit: AxisFit, name: str, values: Sequence[float]) -> Profile:
    """As ``profile``, without values that no draw takes.

    If the fit explains its log, the cost is taken to rise beyond a value that is rejected. If not,
    a part of the windows rejects values; all of the windows reject them more clearly.
    """
    if fit.explained:
        return _profile_bracket(fit, name, values)
    how, count = fit.how.drives, len(fit.problem.windows)
    if count >= 2 * how.scan_windows:
        some = np.zeros(count, bool)
        some[np.linspace(0, count - 1, how.scan_windows).round().astype(int)] = True
        takes = profile(fit.take(some), name, values).contenders
        values = [value for value, taken in zip(values, takes, strict=True) if taken]
    return profile(fit, name, values)


def _profile_bracket(fit: AxisFit, name: str, values: Sequence[float]) -> Profile:
    """As ``profile``, of the values about the fitted one up to the first that no draw takes."""
    own = int(np.abs(np.subtract(values, fit.value(name))).argmin())
    low, high, more = max(own - 2, 0), own + 3, 2
    found = profile(fit, name, values[low:high])
    while True:
        below, above = found.closed
        fresh = [*([] if below else values[max(low - more, 0) : low])]
        fresh += [] if above else values[high : high + more]
        if not fresh:
            return found
        low, high, more = max(low - more, 0), high + more, 2 * more
        found = found.join(profile(fit, name, fresh))


def add_drive_effects(
    fit: AxisFit, longest: float, tell: Callable[[str], object] = lambda _: None
) -> AxisFit:
    """The fit with what the log shows of its drives: dead band, play, slew.

    Each is fitted alone, and the one that explains the same windows best is taken; others that
    explain them nearly as well are its rivals. Then further ones are added to it.

    Args:
        fit: Without them.
        longest: Length of the windows in s.
        tell: Called with the name of each before it is fitted.
    """
    if fit.explained:
        return fit
    tilt, how = fit.problem.tilt, fit.how.drives
    dead_time, lag = fit.value("dead_time"), fit.value("lag")
    rest = residual_by_dead_band(tilt, fit.problem.windows, dead_time, lag, how.scan)
    few = np.argsort(rest)[: how.fitted_dead_bands]
    few = np.sort(few[rest[few] < how.dead_band_residual_share * rest[0]])
    values = {name: np.array(PLAIN_PARAMETERS[name].tried) for name in tilt.tried}
    if "dead_band" in values:
        values["dead_band"] = np.array(how.scan.dead_bands)[few]

    def accepts(other: AxisFit, name: str, own: AxisFit) -> bool:
        return other.value(name) != 0 and other.sigma < how.accepted_residual_share * own.sigma

    alone = {}
    for name, each in values.items():
        tell(name)
        alone[name] = _fit_effect(fit, name, each, longest)
    alone = {name: each for name, each in alone.items() if accepts(each, name, fit)}
    if not alone:
        return fit
    best = min(alone, key=lambda name: alone[name].sigma)
    found = alone[best]
    rivals = tuple(
        (name, each.value(name))
        for name, each in alone.items()
        if {name, best} <= set(DRIVE_EFFECTS)
        and name != best
        and each.sigma < how.rival_residual_ratio * found.sigma
    )
    for name, each in values.items():
        if name != best and not found.explained:
            tell(name)
            other = _fit_effect(found, name, each, longest)
            found = other if accepts(other, name, found) else found
    return replace(found, rivals=rivals)


def _fit_effect(fit: AxisFit, name: str, values: Array, longest: float) -> AxisFit:
    """The fit with a drive effect, first at the best of some values, then about the fitted one.

    The given fit if no value reduces its cost enough.
    """
    other, how = fit, fit.how.drives
    enough = how.useful_cost_share * fit.problem.costs(fit.found.linearisation.r).sum()
    while values.any():
        last = name in other.problem.names
        found = profile(other, name, values, thorough=last)
        costs = found.costs.sum(axis=1)
        theta = found.theta[[costs.argmin()]]
        fitted = theta[0, found.names.index(name)]
        if not last and (fitted == 0 or costs.min() > enough):
            return fit
        more = replace(fit.problem, names=found.names)
        begun_from = replace(other, problem=more, found=fit.found._replace(theta=theta))
        other = begun_from.refit(fit.log, found.names, longest)
        values = np.zeros(0) if last else np.array(how.value_factors) * fitted
    return other


def profile_drives(fit: AxisFit, tell: Callable[[str], object] = lambda _: None) -> AxisFit:
    """The fit with profiles of drives and lever, by which its intervals know of them.

    Args:
        fit: Without profiles.
        tell: Called with the name of each before its profile.
    """
    how = fit.how.drives
    near = {name: np.array(how.value_factors) * fit.value(name) for name in fit.problem.tilt.tried}
    tried = {
        name: sorted({*PLAIN_PARAMETERS[name].tried, *values}) for name, values in near.items()
    }
    # of a lever that is given
    tried.setdefault("lever", [-2 * how.height_std_m, 0.0, 2 * how.height_std_m])
    profiles = []
    for name, values in tried.items():
        tell(name)
        profiles.append(profile_contenders(fit, name, values))
    return replace(fit, profiles=tuple(profiles))


@dataclass(frozen=True)
class AxisFit(Fit[AxisProblem]):
    """The fit of an axis, weighed by the usual residual.

    Attributes:
        log: The fitted samples, without those that something else disturbed.
        sigma: The usual residual in m.
        noise: The usual residual of the windows of the first fit, m.
        pushed: Seconds left out.
        windowed: The fit to windows of one level, where this one predicts better.
        briefer: The fits to shorter windows, if there are enough.
        profiles: Likelihood profiles of drive effects and lever.
        rivals: Drive effects, with their values in swings, that explain the log nearly as well in
            the place of the fitted one.
        how: All constants of the fit.
    """

    log: AxisLog
    sigma: float
    noise: float = 0.0
    pushed: float = 0.0
    windowed: AxisFit | None = None
    briefer: tuple[AxisFit, ...] = ()
    profiles: tuple[Profile, ...] = ()
    rivals: tuple[tuple[str, float], ...] = ()
    how: AxisFitting = AXIS_FITTING

    def estimate(self, *, white: bool | None = None) -> Estimate:
        """The parameters, as uncertain as what drives and lever may be makes them, too.

        Args:
            white: Whether the residuals are white; None to find that out.
        """
        white = self.explained if white is None else white
        own, names = super().estimate(white=white), self.problem.names
        for each in self.profiles:
            for at, name in enumerate(names):
                own.draws[:, at] += each.deviations[name]
                if name == each.name:
                    own.identifiable[at] = True
                    own.degrees_of_freedom[at] = max(len(self.problem.windows) - len(names), 1)
        return own

    @property
    def explained(self) -> bool:
        """Whether the residuals are as white as noise, so that no other model leaves much less.

        The scatter of differences of successive residuals, over the square root of two, equals the
        scatter of the residuals if they are white, and is smaller if a motion is left in them. Both
        are medians, so that a few disturbed windows do not count; of few residuals they scatter.
        """
        rows = zip(self.found.linearisation.r[0], self.problem.windows.weight[..., 0], strict=True)
        each = [row[: len(weight)][weight > 0] / weight[weight > 0] for row, weight in rows]
        size, change = (
            float(np.median([np.median(np.abs(part)) for part in parts if len(part)]))
            for parts in (each, [np.diff(row) / np.sqrt(2) for row in each])
        )
        how, count = self.how.drives, sum(map(len, each))
        by_chance = 1 - how.white_stds * WHITE_RATIO_STD / np.sqrt(max(count, 1))
        return change > min(how.white_share, by_chance) * size

    @property
    def window_s(self) -> float:
        """Length of its windows in s."""
        return self.problem.longest - SAMPLE_BIN_S

    def with_lead(self, lead_s: float) -> AxisFit:
        """This fit, with predictions that start from so many seconds of samples."""
        hold_out = replace(self.how.hold_out, lead_s=lead_s)
        return replace(self, how=replace(self.how, hold_out=hold_out))

    @property
    def by_unknowns(self) -> Array:
        """Slopes of the residuals by the shares of what was added to the tilt, shape (W, M, C)."""
        each = [self.slope_by_tilt(more) for more in self.log.added]
        return np.stack(each, axis=-1) if each else super().by_unknowns

    def slope_by_tilt(self, more: Array) -> Array:
        """Slope of the residuals by a share of further tilt that acts along, shape (W, M).

        Args:
            more: The further tilt, when each command begins, shape (K,).
        """
        scale, size = self.problem.tilt.scale, float(np.std(more)) or 1.0
        share = ADMIXTURE_DIFFERENCE * scale / size
        ways = []
        for each in (share, -share):
            mixed = replace(self.log, tilt=self.log.tilt + each * more)
            problem = replace(self.problem, tilt=TiltHistory(mixed, scale))
            moved = problem.linearise(self.found.theta, self.found.starts, slopes=False)
            ways.append(moved.r[0])
        return np.asarray((ways[0] - ways[1]) / (2 * share))

    def take(self, which: Mask) -> AxisFit:
        """Fit of a selection of the windows, with the same parameters."""
        problem = replace(self.problem, windows=self.problem.windows.take(which))
        found = self.found._replace(
            starts=self.found.starts[:, :, which],
            linearisation=self.found.linearisation.take(which),
        )
        return replace(self, problem=problem, found=found)

    def refit(self, log: AxisLog, names: tuple[str, ...], longest: float) -> AxisFit:
        """The fit of other parameters, windows or parts of a log, begun from this one."""
        guess = np.array([[self.value(name) for name in names]])
        problem = replace(self.problem, names=names)
        found = fit_from_guesses(log, problem, longest, guess, self.sigma, self.how)
        return replace(found, noise=self.noise, pushed=self.pushed, rivals=self.rivals)


def fit_axis(
    log: AxisLog,
    names: tuple[str, ...],
    longest: float,
    delays: tuple[float, float],
    how: AxisFitting = AXIS_FITTING,
    look: FirstLook | None = None,
) -> AxisFit:
    """Fit an axis from no first guess, or a first look.

    Short windows without friction find gain, dead time and level, and what disturbed the ball; from
    there, and from the gain of a mere tilt, the long ones begin with several frictions.

    Args:
        log: Of the axis.
        names: Of the parameters.
        longest: Length of the windows in s.
        delays: Smallest and largest dead time in s.
        how: All constants of the fit.
        look: A first look at it, which is a guess as well.

    Raises:
        LogError: If there are too few windows.
    """
    nothing = axis_windows(log, np.zeros(0), np.zeros(0))
    smooth = tuple(name for name in names if name in SMOOTH_PARAMETERS)
    problem = AxisProblem(nothing, smooth, TiltHistory(log), longest, delays)
    search = how.search
    guess = problem.first_guesses(dead_time=search.delay_guesses_s)
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    brief = fit_from_guesses(log, problem, search.first_window_s, guess, 2e-3, how)
    rms = np.sqrt(brief.problem.misfit(brief.found.linearisation.r)[0])
    pushed = brief.problem.windows.begin[rms > search.disturbed_residual_ratio * np.median(rms)]
    log = log.without(pushed, search.first_window_s)
    frictions = search.friction_guesses_m_s2
    guess = np.array([[brief.value(name) for name in names]]).repeat(2 * len(frictions), axis=0)
    by_tilt = search.tilt_gain_m_s2 * problem.tilt.scale
    guess[: len(frictions), 0] = np.copysign(by_tilt, guess[0, 0])
    if "friction" in names:
        guess[:, names.index("friction")] = np.tile(frictions, 2)
    problem = replace(problem, names=names)
    if look:
        guess = np.vstack((guess, guess_from(look, problem)))
    sigma = brief.sigma * longest / search.first_window_s
    fit = fit_from_guesses(log, problem, longest, guess, sigma, how)
    return replace(fit, noise=brief.sigma, pushed=search.first_window_s * len(pushed))


def guess_from(look: FirstLook, problem: AxisProblem) -> Array:
    """A guess of the parameters by a first look, shape (1, P).

    Gain, dead time, level, friction, camber and damping are those of the look. Its delay is all
    taken as dead time, so the lag is zero. A parameter that the look does not contain has its usual
    first guess.

    Args:
        look: At the log that is fitted.
        problem: The fit, whose parameters are guessed.
    """
    seen = {"gain": look.gain * problem.tilt.scale, "dead_time": look.delay, "lag": 0.0}
    seen |= {"level": look.level, "friction": look.friction, "camber": look.camber}
    seen |= {"viscous": look.damping}
    return problem.first_guesses(**{k: [v] for k, v in seen.items() if k in problem.names})


def fit_from_guesses(
    log: AxisLog,
    problem: AxisProblem,
    longest: float,
    guess: Array,
    sigma: float,
    how: AxisFitting,
) -> AxisFit:
    """The best fit from C guesses, shape (C, P), for a first guess of the residual in m.

    Args:
        log: What is fitted.
        problem: Of which names, input and bounds are taken.
        longest: Length of the windows in s.
        guess: First guesses.
        sigma: The residual.
        how: All constants of the fit.
    """
    windows = axis_windows(log, *spans(log, longest))
    if len(windows) < 3:
        raise LogError(
            f"{len(windows)} stretches of {MIN_WINDOW_SHARE * longest:.2g} s with the ball seen "
            f"every {MAX_COMMAND_GAP_S:g} s, at least 3 are needed: record for longer, or see the "
            "ball more often"
        )
    base = windows.weight
    windows = replace(windows, weight=base / sigma)
    problem = replace(problem, windows=windows, longest=longest + SAMPLE_BIN_S)
    search = how.search
    control = search.control
    starts = fit_starts_from_scratch(problem, guess, 4)
    found = minimise(problem, guess, starts, 8, 3, control=control).best(3)
    found = minimise(problem, found.theta, found.starts, 20, 3, control=control)
    for last in (False, False, True):
        best = found.best(1)
        theta, starts = best.theta, best.starts
        off = np.abs(problem.simulate_samples(theta, starts)[0][0] - windows.ball) * base
        each = 1.4826 * np.nanmedian(np.where(base > 0, off, np.nan), axis=1)
        sigma = max(float(np.median(each)), 1e-5)
        good = off < search.outlier_ratio * np.maximum(each, sigma)[:, None]
        weight = np.where(good, base, 0.0) / sigma
        problem = replace(problem, windows=replace(windows, weight=weight))
        if last and "lag" in problem.names:
            theta = _add_lag_guesses(theta, problem.names, problem.delays, search.lag_guesses_s)
            starts = fit_starts(problem, theta, np.repeat(starts, len(theta), axis=1), 4)
            tried = minimise(problem, theta, starts, search.lag_steps, 3, 2, control)
            theta, starts = tried.best(search.continued_lags)[:2]
        steps, polish = (30, 2) if last else (6, 0)
        found = minimise(problem, theta, starts, steps, 3, polish, control)
    return AxisFit(problem, found.best(1), log, sigma, how=how)


def _add_lag_guesses(
    theta: Array, names: tuple[str, ...], delays: tuple[float, float], lags: Sequence[float]
) -> Array:
    """Guesses with other lags and the same sum of dead time and lag, next to the given one.

    Only the shape of a response distinguishes the two. Without a lag its slope is zero, so no step
    would ever leave there.
    """
    return np.concatenate((theta, _with_lags(theta.repeat(len(lags), axis=0), names, lags, delays)))


def _with_lags(
    theta: Array, names: tuple[str, ...], lags: Sequence[float] | Array, delays: tuple[float, float]
) -> Array:
    """C candidates, shape (C, P), with other lags and as much dead time less."""
    at, lag = names.index("dead_time"), names.index("lag")
    both, found = theta[:, at] + theta[:, lag], theta.copy()
    found[:, lag] = np.clip(lags, 0.0, np.maximum(both - delays[0], 0.0))
    found[:, at] = np.clip(both - found[:, lag], *delays)
    return found


def predict_axis(log: AxisLog, fit: AxisFit, at: Array, *, follow: bool = True) -> Predicted:
    """Predict from times in s, shape (W,), by the samples before them.

    Args:
        log: The axis, held out.
        fit: The model.
        at: When predictions begin.
        follow: Whether to predict with a followed level and without friction as well.
    """
    how, hold_out = fit.how.prediction, fit.how.hold_out
    log = replace(log, across=log.across * fit.log.across[1].any())
    theta, tilt = fit.found.theta, TiltHistory(log, fit.problem.tilt.scale)
    by = {"model": theta}
    if follow:
        windows = axis_windows(log, at - how.level_history_s, at)
        windows = replace(windows, weight=windows.weight / fit.sigma)
        past = replace(
            fit.problem,
            windows=windows,
            tilt=tilt,
            longest=how.level_history_s + hold_out.horizon_tolerance_s,
            drift=how.level_std_m_s2,
            stops=fit.log.stops,
        )
        own = fit_starts_from_scratch(past, theta, 8)[2]
        for who, name, values in (
            ("without friction", "friction", 0.0),
            ("level followed", "level", fit.value("level") + own),
        ):
            by[who] = np.repeat(theta[:, None], len(at), axis=1)
            if name in fit.problem.names:
                by[who][..., fit.problem.names.index(name)] = values
    found = predict_windows(_prediction_problem(log, fit, at), hold_out.lead_s, by, "x", hold_out)[
        "x"
    ]
    return _choose_level(found) if follow else found


def _prediction_problem(log: AxisLog, fit: AxisFit, at: Array) -> AxisProblem:
    """Windows from before the times ``at`` in s to the last horizon."""
    how = fit.how.hold_out
    lead, tolerance = how.lead_s, how.horizon_tolerance_s
    windows = axis_windows(log, at - lead, at + how.horizons_s[-1] + tolerance)
    windows = replace(windows, weight=windows.weight / fit.noise)
    tilt = TiltHistory(log, fit.problem.tilt.scale)
    longest = lead + how.horizons_s[-1] + 2 * tolerance
    return replace(
        fit.problem,
        windows=windows,
        tilt=tilt,
        longest=longest,
        drift=0.0,
        stops=fit.log.stops,
    )


def refit_for_prediction(fit: AxisFit, longest: float) -> AxisFit:
    """The fit that predicts its own log best where the one to windows does so badly.

    A model in error, such as of servos with a dead band, explains a window best by other values
    than those by which it predicts, for with its start free it may bend its whole way; a level
    that drifts is taken for gain and friction unless each window has its own. A fit that explains
    its log is no model in error: the noise of its starts is what predictions leave.
    """
    how = fit.how.prediction
    if fit.explained:
        return fit
    own = _median_error(fit, fit.log, follow=True)
    if own < how.huber_error_m:
        return fit
    found, least = fit, own
    drifting = replace(fit, problem=replace(fit.problem, drift=how.level_std_m_s2))
    for other in (
        drifting.refit(fit.log, fit.problem.names, longest),
        replace(fit, found=fit.found._replace(theta=fit_to_predictions(fit))),
    ):
        left = _median_error(other, fit.log, follow=True)
        if left < least:
            found, least = replace(other, windowed=fit, profiles=fit.profiles), left
    return found


def fit_to_predictions(
    fit: AxisFit, look: FirstLook | None = None, known: Array | None = None
) -> Array:
    """Parameters fitted to predictions of the log, the best from several first guesses, (1, P).

    Args:
        fit: A fit to windows of the log.
        look: A first look at it, which is a guess as well.
        known: A guess that is near the fit, shape (1, P), so that no other is needed.
    """
    how, hold_out = fit.how.prediction, fit.how.hold_out
    at = _thin_prediction_times(fit.log, fit.how, hold_out.lead_s)
    problem = _prediction_problem(fit.log, fit, at)
    windows, names = problem.windows, problem.names
    before = problem.first_part(hold_out.lead_s)
    first = before.initial_starts()
    target = (windows.weight[..., 0] > 0) & (windows.time >= hold_out.lead_s)
    # what has no slope stays as it is
    step = np.array([PLAIN_PARAMETERS[name].difference or 1e-12 for name in names])
    least, most = problem.bounds
    most[[name in ("dead_time", "lag") for name in names]] = how.max_delay_and_lag_s

    def off(theta: Array) -> Array:
        theta = np.atleast_2d(theta)
        starts = fit_starts(before, theta, np.repeat(first, len(theta), axis=1), 4)
        places = problem.simulate_samples(theta, starts)[0]
        each = np.clip((places - windows.ball)[:, target, 0] / how.huber_error_m, -1e3, 1e3)
        return np.asarray(np.squeeze(each))

    def slopes(theta: Array) -> Array:
        moved = theta + np.diag(np.where(theta + step > most, -step, step))
        each = off(np.concatenate((theta[None], moved)))
        return np.asarray(((each[1:] - each[0]) / np.diagonal(moved - theta)[:, None]).T)

    guesses = known
    if guesses is None:
        usual = {"gain": (*fit.briefer, fit)[0].value("gain")} | dict(how.initial_values)
        usual |= {name: fit.value(name) for name in PROFILED_EFFECTS}
        rows = [[usual.get(name, 0.0) for name in names]]
        rows += [[each.value(name) for name in names] for each in (fit, *fit.briefer)]
        rows += guess_from(look, problem).tolist() if look else []
        guesses = np.array(rows)
    begun_at = np.clip(guesses, least + 1e-6, most - 1e-6)
    # the soft L1 loss of scipy's least squares
    initial = (np.sqrt(1 + off(begun_at) ** 2) - 1).sum(axis=-1)
    tried = [
        least_squares(
            off,
            guess,
            slopes,
            bounds=(least, most),
            x_scale=step,
            loss="soft_l1",
            ftol=how.cost_tolerance,
            max_nfev=how.max_evaluations,
        )
        for guess in begun_at[np.argsort(initial)[: how.continued_guesses]]
    ]
    found = min(tried, key=lambda each: float(each.cost))
    return np.asarray(found.x[None])


def _choose_level(found: Predicted) -> Predicted:
    """The level followed only while that has predicted better, in what had been seen by then."""
    gained = [
        np.log(np.maximum(np.abs(found.errors(name, 1.0)), 1e-4)) for name in PREDICTOR_NAMES[:2]
    ]
    gain = np.where(found.moves, gained[0] - gained[1], np.nan)
    seen = found.begin[:, None] >= found.begin + 1.0 + found.how.horizon_tolerance_s
    so_far = np.nansum(np.where(seen, gain, 0.0), axis=1)
    followed = np.where(so_far[:, None] > 0, found.by["level followed"], found.by["model"])
    return replace(found, by={**found.by, "level followed": followed})


def prediction_times(
    log: AxisLog, fitting: AxisFitting = AXIS_FITTING, history_s: float | None = None
) -> Array:
    """When predictions begin: every half second with enough samples before and after, s.

    Args:
        log: What is predicted.
        fitting: Constants of fits.
        history_s: Length of the samples before, in s; None for those of a followed level.
    """
    how = fitting.hold_out
    history = fitting.prediction.level_history_s if history_s is None else history_s
    time, first_horizon = log.sampled, how.horizons_s[0]
    if len(time) < 10:
        return np.zeros(0)
    tries = np.arange(time[0] + history, time[-1] - first_horizon, how.interval_s)
    step = float(np.median(np.diff(time)))
    before, past, after = (
        np.searchsorted(time, tries + last) - np.searchsorted(time, tries + first)
        for first, last in (
            (-how.lead_s, 0.0),
            (-history, 0.0),
            (0.0, first_horizon + how.horizon_tolerance_s),
        )
    )
    return tries[
        (before >= max(3, 0.5 * how.lead_s / step)) & (past >= 0.5 * history / step) & (after > 0)
    ]


def _thin_prediction_times(
    log: AxisLog, fitting: AxisFitting, history_s: float | None = None
) -> Array:
    """Evenly chosen ones of the prediction times, at most as many as fits are compared by, s."""
    every = prediction_times(log, fitting, history_s)
    return every[:: max(1, -(-len(every) // fitting.prediction.max_predictions))]


def find_term(fit: AxisFit, name: str) -> tuple[Array, float]:
    """A term that a fit has not, by its next step from zero, and what it changes in the fit.

    The changes are those of the omitted-variable bias, -N_pp^-1 N_pt t with the normal matrix N and
    the term t: a fit to predictions, which is at no minimum for its windows, is not moved to one.

    Args:
        fit: Without the term, P parameters.
        name: The term.

    Returns:
        Changes of the parameters and, last, the term, shape (P + 1,); and the term's standard
        deviation, as of white residuals.
    """
    problem = replace(fit.problem, names=(*fit.problem.names, name))
    theta = np.append(fit.found.theta, [[0.0]], axis=1)
    line = problem.linearise(theta, fit.found.starts)
    free, _ = line.eliminate_starts()
    each = np.einsum("wmi,wmj,w->ij", free[0], free[0], problem.weights(line.r)[0])
    normal = each[1:, 1:] + np.diag(problem.known[1] + 1e-9)
    inverse = np.linalg.inv(normal)
    term = -inverse[-1] @ each[1:, 0]
    changes = -term * np.linalg.solve(normal[:-1, :-1], normal[:-1, -1])
    return np.append(changes, term), float(np.sqrt(inverse[-1, -1]))


def find_significance(fit: AxisFit, name: str) -> float:
    """Standard deviations by which the next step of a fit would move a parameter from zero."""
    changes, std = find_term(fit, name)
    return float(abs(changes[-1]) / std)


def find_clock_drift(fit: AxisFit) -> tuple[float, float]:
    """By how much the clock of the positions is faster than that of the commands, and its error.

    The dead time grows by it with the time in each recording; an offset of each recording's clock
    is fitted along. The error is the half-width of its interval.
    """
    fit = fit.windowed or fit
    changes = fit.log.clock_columns(fit.problem.windows.begin)
    by_time = fit.found.linearisation.by_parameter[0, ..., fit.problem.names.index("dead_time")]
    (drift, _), (half, _) = _step_by(fit, by_time[..., None] * changes[:, None])
    return drift, half


def find_admixture(fit: AxisFit, more: Array) -> tuple[float, float, float]:
    """Share of further tilt that acts along with the tilt, its error, and the gain next to it.

    The step finds the acceleration by the further tilt. Its share is of the gain next to it, not of
    the gain of the fit, which is a mean over small tilts and large ones.

    Args:
        fit: Of the axis.
        more: The further tilt, when each command begins, shape (K,).

    Returns:
        The share, the half-width of its interval, and the gain in m/s^2 by the unit of the tilt.
    """
    fit = fit.windowed or fit
    (found, gain), (half, _) = _step_by(fit, fit.slope_by_tilt(more)[..., None])
    fitted = fit.value("gain")
    return found * fitted / gain, half * abs(fitted / gain), gain / fit.problem.tilt.scale


def _step_by(fit: AxisFit, more: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """One step of a fit with C parameters more: the last one and the gain, and their half-widths.

    Args:
        fit: The fit, in which these parameters are zero.
        more: Slopes of the residuals by them, shape (W, M, C).
    """
    line = fit.found.linearisation
    slopes = np.concatenate((line.by_parameter, more[None]), axis=-1)
    free, _ = line._replace(by_parameter=slopes).eliminate_starts()
    weight = fit.problem.weights(line.r)[0]
    r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
    information = np.einsum("wmi,wmj,w->wij", J, J, weight)
    score = np.einsum("wmi,wm,w->wi", J, r, weight)
    step = -np.linalg.pinv(information.sum(axis=0), hermitian=True) @ score.sum(axis=0)
    half = estimate(step, information, score + information @ step).half_width
    gain = fit.problem.names.index("gain")
    return (float(step[-1]), fit.value("gain") + float(step[gain])), (
        float(half[-1]),
        float(half[gain]),
    )


def cross_validate(fit: AxisFit, names: tuple[str, ...], longest: float) -> float:
    """Error in m of fits of each half of a log by these parameters, in the other half.

    See ``_median_error``.
    """
    time = fit.log.sampled
    middle = float(np.median(time))
    halves = fit.log.between(-np.inf, middle), fit.log.between(middle, np.inf)
    try:
        each = [
            _median_error(fit.refit(fitted, names, longest), tried, follow=fit.problem.drift > 0)
            for fitted, tried in (halves, halves[::-1])
        ]
    except LogError:  # a half has too few windows
        return np.inf
    return float(np.sqrt(np.prod(each)))


def _median_error(fit: AxisFit, log: AxisLog, *, follow: bool = False) -> float:
    """Geometric mean over the horizons of the median error in m where the ball moves.

    Infinite if one is unknown; of the better of model and level that is followed.
    """
    at = _thin_prediction_times(log, fit.how)
    if len(at) < 3:
        return np.inf
    found = predict_axis(log, fit, at, follow=follow)
    medians = [
        [
            absolute_quantile(found.errors(who, ahead)[found.moves], 0.5)
            for ahead in found.how.horizons_s
        ]
        for who in PREDICTOR_NAMES[: 1 + follow]
    ]
    each = np.exp(np.mean(np.log(medians), axis=1))
    return float(np.min(each)) if np.isfinite(each).all() else np.inf
