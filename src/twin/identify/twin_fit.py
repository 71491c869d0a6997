"""The twin's replay of the ball on the measured plate, and its fit without a first guess.

Rolling friction first, then breakaway, then all parameters from the best of these guesses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import cast

import numpy as np
from scipy import stats

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.least_squares import (
    START_DIFFERENCES,
    START_PRIOR,
    Fit,
    FitProblem,
    Linearisation,
    Minimum,
    fit_starts_from_scratch,
    minimise,
)
from twin.identify.parameters import BALL_PARAMETERS, LEVEL_PARAMETERS
from twin.identify.windows import LOOKBACK_S, Patches, Windows, replay, unknown_motion
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
        last_steps: Of the best fit: largest number of further steps, of steps without a gain, and
            of steps of the starts in each.
        even_screen_share: Share of the windows that an even screen must explain.
        noise: Constants of the search for unknown motion.
    """

    max_window_s: float = 2.5
    breakaway_ratios: tuple[float, ...] = tuple((1 + np.linspace(0, 2.2, 32) ** 1.3).tolist())
    fitted_guesses: int = 3
    unexplained_misfit_ratio: float = 2.0
    free_start_gain_limit: float = float(stats.chi2.ppf(0.99, 2))
    min_viscous_stds: float = 4.0
    last_steps: tuple[int, int, int] = (40, 8, 2)
    even_screen_share: float = 0.8
    noise: NoiseSearch = NoiseSearch()


TWIN_SELECTION = TwinSelection()


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
        level = np.stack(np.broadcast_arrays(*(values[name] for name in LEVEL_PARAMETERS)))
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
    """Fit the parameters of a twin to windows of a log, from many starts unless guesses are given.

    A ball that never starts moving in a replay tells the fit nothing, so its steps must begin near
    the truth: windows in which the ball rolls throughout give rolling friction, delay and level
    from any start; with those, the windows that begin at rest are tried with one breakaway ratio
    after another; from the best of these all windows and all parameters are fitted. Windows that
    are then not explained at all are left out, and the rest is fitted again; so is all if in some
    windows the ball did not rest at first, but crept. Of an uneven screen the patches, and other
    forces that nobody knows, are part of the noise, in the sizes that make the log most likely.

    Args:
        model: Ball parameters.
        windows: Of the log, at least 3.
        names: The P fitted parameters, of ``BALL_PARAMETERS``.
        grip: Time in s within which friction stops a ball, see ``replay``.
        uneven: Whether patches of the screen and other forces are part of the noise.
        guesses: Parameters where fits begin, shape (C, P), SI units; None to search.
        selection: Constants of the fit.
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
        found = found.best(1)
        # in the valley of rolling and viscous friction no step is better with starts merely shifted
        best = minimise(problem, found.theta, found.starts, *selection.last_steps).best(1)
        misfit = problem.misfit(best.linearisation.r)[0]
        usual = max(1.0, float(np.median(misfit)))
        kept = misfit < selection.unexplained_misfit_ratio * usual
        if kept.all() or kept.sum() < max(3, len(windows) / 2):
            break
        problem = replace(problem, windows=problem.windows.take(kept))
        found = minimise(problem, best.theta, best.starts[:, :, kept], 15, 4)
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


def has_viscous_friction(fit: Fit[TwinProblem], selection: TwinSelection) -> bool:
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
