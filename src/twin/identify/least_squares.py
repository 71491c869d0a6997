"""Least squares over many windows: common parameters, and starts of each window's own.

Levenberg-Marquardt for many candidates at once: scipy's least_squares takes one start at a time and
knows nothing of the structure, a handful of common parameters and a few numbers of each window's
own, which are eliminated here. Replaying all candidates and all finite differences in one batch
makes a fit some twenty times as fast.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from twin.base.errors import plural
from twin.identify.intervals import Estimate, estimate
from twin.identify.parameters import IdentifiedParameter

START_DIFFERENCES = np.array([1e-4, 1e-4, 1e-3, 1e-3])
"""Steps of finite differences of the ball's start: m and m/s."""
# A weak prior of the ball's start (m, m/s), for windows with too few samples to determine it.
START_PRIOR = np.diag(np.array([0.02, 0.02, 0.3, 0.3]) ** -2.0)


class Linearisation(NamedTuple):
    """Residuals of C candidates in W windows, in standard deviations, and their slopes.

    Attributes:
        r: Replay minus samples, shape (C, W, M).
        by_start: Slope by the start x, y, x', y' of each window, shape (C, W, M, 4).
        by_parameter: Slope by the parameters, shape (C, W, M, P); P is 0 where not requested.
        prior: Weak knowledge of a start, its inverse covariance.
    """

    r: Array
    by_start: Array
    by_parameter: Array
    prior: Array = START_PRIOR

    def where(self, better: Mask, old: Linearisation) -> Linearisation:
        """This where it is better, shape (C,) or (C, W), elsewhere the old one."""
        parts = []
        for new, before in zip(self[:3], old[:3], strict=True):
            mask = better.reshape(better.shape + (1,) * (new.ndim - better.ndim))
            parts.append(np.where(mask, new, before))
        return Linearisation(parts[0], parts[1], parts[2], self.prior)

    def take(self, which: Mask) -> Linearisation:
        """Linearisation of a selection of the windows."""
        r, by_start, by_parameter = (part[:, which] for part in self[:3])
        return Linearisation(r, by_start, by_parameter, self.prior)

    def select(self, candidates: NDArray[np.intp]) -> Linearisation:
        """Linearisation of a selection of the candidates."""
        r, by_start, by_parameter = (part[candidates] for part in self[:3])
        return Linearisation(r, by_start, by_parameter, self.prior)

    def replace_at(self, candidates: NDArray[np.intp], new: Linearisation, better: Mask) -> None:
        """Overwrite those of some candidates by those of the better ones of others."""
        for part, other in zip(self[:3], new[:3], strict=True):
            part[candidates] = other[better]

    def start_step(self, damping: Array) -> Array:
        """The damped Gauss-Newton step of the starts alone, shape (4, C, W).

        Args:
            damping: Multiples of the prior, shape (C, W).
        """
        Zt = np.swapaxes(self.by_start, -1, -2)  # noqa: N806
        normal = Zt @ self.by_start + damping[..., None, None] * self.prior
        return np.moveaxis(np.linalg.solve(normal, Zt @ self.r[..., None])[..., 0], -1, 0)

    def eliminate_starts(self, damping: Array | None = None) -> tuple[Array, Array]:
        """Residuals and parameter slopes with the starts fitted along, (C, W, M, 1 + P).

        Variable projection: for a linearised problem the best starts are a linear function of the
        parameters. Also returns its slopes, shape (C, W, S, 1 + P).

        Args:
            damping: Marquardt's for the starts, shape (C,): shares of the diagonal; None for none.
        """
        Z = self.by_start  # noqa: N806
        both = np.concatenate((self.r[..., None], self.by_parameter), axis=-1)
        Zt = np.swapaxes(Z, -1, -2)  # noqa: N806
        normal = Zt @ Z
        if damping is not None:
            diagonal = np.eye(Z.shape[-1]) * np.diagonal(normal, axis1=-2, axis2=-1)[..., None]
            normal = normal + damping[:, None, None, None] * diagonal
        follow = np.linalg.solve(normal + self.prior, Zt @ both)
        return both - Z @ follow, follow

    def without_starts(self, unknown: Array) -> tuple[Array, Array]:
        """Inner products of the first candidate's residuals and parameter slopes, starts fitted.

        Under the samples' noise and unknown motion N of unit variance: U' (I + N N')^-1 U by
        Woodbury's identity. Also returns how far that spreads, as the logarithm of determinants.

        Args:
            unknown: N, in standard deviations of the samples, shape (W, M, S).

        Returns:
            Shapes (W, 1 + P, 1 + P) and (W,).
        """
        parts = (self.r[0, ..., None], self.by_parameter[0], self.by_start[0])
        U, Nt = np.concatenate(parts, axis=-1), np.swapaxes(unknown, -1, -2)  # noqa: N806
        inner, shared = np.eye(len(Nt[0])) + Nt @ unknown, Nt @ U
        Q = np.swapaxes(U, -1, -2) @ U  # noqa: N806
        Q -= np.swapaxes(shared, -1, -2) @ np.linalg.solve(inner, shared)  # noqa: N806
        k = 1 + self.by_parameter.shape[-1]
        own = Q[:, k:, k:] + self.prior
        left = Q[:, :k, :k] - Q[:, :k, k:] @ np.linalg.solve(own, Q[:, k:, :k])
        return left, np.linalg.slogdet(inner)[1] + np.linalg.slogdet(own)[1]


@dataclass(frozen=True)
class SampleWindows:
    """W windows with up to B averaged samples each of the ball along A axes.

    Attributes:
        begin: When each begins, s, shape (W,).
        time: When the samples were taken, s from ``begin``, shape (W, B).
        ball: Positions in m, shape (W, B, A).
        weight: One over the standard deviation of each, 0 where there is none, shape (W, B, A).
        shared: What K unknowns that windows have in common, as patches of a screen, make of their
            residuals, in standard deviations of each unknown, shape (W, M, K); None without any.
    """

    begin: Array
    time: Array
    ball: Array
    weight: Array
    shared: Array | None = field(default=None, kw_only=True)
    by_window: ClassVar[tuple[str, ...]] = ("begin", "time", "ball", "weight")

    def __len__(self) -> int:
        """Number of windows."""
        return len(self.begin)

    @property
    def size(self) -> Array:
        """Number of values in each window, at least 1, shape (W,)."""
        return np.asarray(np.maximum((self.weight > 0).sum(axis=(1, 2)), 1))

    def take(self, which: Mask) -> Self:
        """Some of the windows."""
        given = {name: getattr(self, name) for name in (*self.by_window, "shared")}
        return replace(self, **{k: v[which] for k, v in given.items() if v is not None})


Windows_co = TypeVar("Windows_co", bound=SampleWindows, covariant=True)


@dataclass(frozen=True)
class FitProblem(Generic[Windows_co]):
    """Least-squares problem of a fit of windows.

    Attributes:
        windows: The samples.
        names: Names of the parameters that are fitted, P of them.
        about: Bounds, guess and difference step of each parameter.
        start_steps: Steps of finite differences of a start.
        prior: Weak knowledge of a start, its inverse covariance.
        grows: Whether the cost of a window grows without bound, by the logarithm of its misfit.
        tolerated_misfit: Mean square misfit, in noise variances, above which a window loses weight
            (Geman and McClure): a window that no replay explains costs no more than a few that are
            explained badly, however large its error. With a loss that grows, such windows pull the
            fit to where it explains none well.
    """

    windows: Windows_co
    names: tuple[str, ...]
    about: ClassVar[Mapping[str, IdentifiedParameter]]
    start_steps: ClassVar[Array]
    prior: ClassVar[Array]
    grows: ClassVar[bool] = False
    tolerated_misfit: ClassVar[float] = 3.0

    def first_guesses(self, **tried: Sequence[float]) -> Array:
        """Parameters to begin with, shape (C, P): C values of some, of the others the usual one."""
        usual = {name: self.about[name].start for name in self.names}
        columns = [np.atleast_1d(value) for value in (usual | tried).values()]
        return np.stack(np.broadcast_arrays(*columns), axis=-1).astype(float)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values of the parameters, shapes (P,)."""
        about = [self.about[name] for name in self.names]
        return np.array([each.least for each in about]), np.array([each.most for each in about])

    @property
    def known(self) -> tuple[Array, Array]:
        """Prior of the parameters: mean and precision, shapes (P,)."""
        about = [self.about[name] for name in self.names]
        return np.array([e.start for e in about]), np.array([e.spread**-2.0 for e in about])

    def initial_starts(self) -> Array:
        """First guesses of the starts, S numbers of each window, shape (S, 1, W)."""
        raise NotImplementedError

    @property
    def rigid_starts(self) -> int:
        """How many of the first numbers of a start merely shift all of its predicted samples."""
        return 0

    def take(self, which: Mask) -> Self:
        """The problem of some of the windows."""
        return replace(self, windows=self.windows.take(which))

    def first_part(self, seconds: float) -> Self:
        """The problem of the samples in the first seconds of each window."""
        weight = self.windows.weight * (self.windows.time < seconds)[..., None]
        return replace(self, windows=replace(self.windows, weight=weight))

    def simulate_samples(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """Predicted samples in m, and their rates, (C, W, ...) like the samples.

        The rate is used only where dead time has no finite difference.
        """
        raise NotImplementedError

    def linearise(self, theta: Array, starts: Array, *, slopes: bool = True) -> Linearisation:
        """Residuals and slopes of C candidates, by finite differences.

        The candidates and all their finite differences are replayed in one batch.

        Args:
            theta: Parameters, shape (C, P), or (C, W, P) if they differ from window to window.
            starts: The beginning of each window, shape (S, C, W).
            slopes: Whether the slopes by the parameters are computed.
        """
        count, free, weight = len(theta), len(starts), self.windows.weight
        rigid = self.rigid_starts
        batch = [(theta, starts)]
        for k in range(rigid, free):
            moved = starts.copy()
            moved[k] += self.start_steps[k]
            batch.append((theta, moved))
        least, most = self.bounds
        widths = {}
        for k, name in enumerate(self.names if slopes else ()):
            step = self.about[name].difference
            if step == 0:
                continue
            up, down = theta.copy(), theta.copy()
            up[..., k] = np.minimum(up[..., k] + step, most[k])
            down[..., k] = np.maximum(down[..., k] - step, least[k])
            widths[k] = (up - down)[..., k].reshape(count, -1, 1)
            batch += [(up, starts), (down, starts)]
        places, rates = self.simulate_samples(
            np.concatenate([each[0] for each in batch]),
            np.concatenate([each[1] for each in batch], axis=1),
        )
        shape = (len(batch), count, len(weight), weight[0].size)
        scaled = (places * weight).reshape(shape)
        by_start = np.empty((*shape[1:], free))
        by_start[..., :rigid] = weight.reshape(len(weight), -1, 1)
        for k in range(rigid, free):
            np.subtract(scaled[1 + k - rigid], scaled[0], out=by_start[..., k])
        by_start[..., rigid:] /= self.start_steps[rigid:free]
        by_parameter = np.zeros((*shape[1:], len(self.names) if slopes else 0))
        for j, (k, width) in enumerate(widths.items()):
            up, down = scaled[len(scaled) - 2 * len(widths) + 2 * j :][:2]
            by_parameter[..., k] = (up - down) / width
        if slopes and "delay" in self.names:
            by_delay = (-rates[:count] * weight).reshape(shape[1:])
            by_parameter[..., self.names.index("delay")] = by_delay
        target = (self.windows.ball * weight).reshape(shape[2:])
        return Linearisation(scaled[0] - target, by_start, by_parameter, self.prior)

    def misfit(self, r: Array) -> Array:
        """Mean square residual of each window in noise variances, shape (C, W)."""
        return np.asarray((r**2).sum(axis=-1) / self.windows.size)

    def costs(self, r: Array) -> Array:
        """Cost of each window: robust against those that cannot be explained, shape (C, W)."""
        misfit = self.misfit(r) / self.tolerated_misfit
        each = np.log1p(misfit) if self.grows else misfit / (1 + misfit)
        return np.asarray(self.windows.size * self.tolerated_misfit * each)

    def cost(self, r: Array) -> Array:
        """Cost that a fit minimises, shape (C,)."""
        return np.asarray(self.costs(r).sum(axis=-1))

    def weights(self, r: Array) -> Array:
        """How much each window counts, 1 for a perfect one, shape (C, W)."""
        return np.asarray(
            1 / (1 + self.misfit(r) / self.tolerated_misfit) ** (1 if self.grows else 2)
        )


@dataclass(frozen=True, kw_only=True)
class StepControl:
    """Constants of the minimisation by Levenberg and Marquardt.

    Attributes:
        cost_tolerance: Relative decrease of the cost below which a step counts as none.
        start_tolerance: Change of a window's misfit, in noise variances, below which its start
            is found.
        initial_damping: Damping of the first step, as a share of the diagonal.
        min_damping: Smallest damping.
        damping_decrease: Factor by which damping is divided after a step that reduces the cost.
        damping_increase: Factor by which it is multiplied after any other.
        drops_idle: Whether a candidate that has converged is left as it is while others move.
    """

    cost_tolerance: float = 1e-5
    start_tolerance: float = 1e-4
    initial_damping: float = 1e-2
    min_damping: float = 1e-6
    damping_decrease: float = 5.0
    damping_increase: float = 8.0
    drops_idle: bool = False


STEP_CONTROL = StepControl()
CONVERGED, STEP_LIMIT_REACHED = "converged", "step limit reached"
"""How a minimisation may end."""


@dataclass(frozen=True)
class Termination:
    """How a minimisation ended for its best candidate.

    Attributes:
        reason: ``converged``: in the last two steps its cost fell by no more than the tolerance;
            or ``step limit reached``.
        steps: Steps taken, rejected ones included.
        step_limit: Most steps it might have taken.
    """

    reason: str
    steps: int
    step_limit: int

    def __str__(self) -> str:
        """In words."""
        if self.reason == CONVERGED:
            return f"the fit converged after {plural(self.steps, 'step')}"
        return f"the fit stopped at its limit of {plural(self.step_limit, 'step')}"


class Minimum(NamedTuple):
    """Result of a minimisation of C candidates.

    Attributes:
        theta: Parameters, shape (C, P).
        starts: x, y, x', y' of the ball at the beginning of each window, shape (4, C, W).
        cost: Costs, shape (C,).
        linearisation: Residuals and slopes there.
        termination: How it ended.
    """

    theta: Array
    starts: Array
    cost: Array
    linearisation: Linearisation
    termination: Termination

    def best(self, count: int) -> Minimum:
        """The best of its candidates."""
        best = np.argsort(self.cost)[:count]
        return self._replace(
            theta=self.theta[best],
            starts=self.starts[:, best],
            cost=self.cost[best],
            linearisation=self.linearisation.select(best),
        )


def fit_starts(
    problem: FitProblem[SampleWindows],
    theta: Array,
    starts: Array,
    step_limit: int,
    control: StepControl = STEP_CONTROL,
) -> Array:
    """The best starts for fixed parameters, by damped Gauss-Newton steps, shape (4, C, W).

    Windows share nothing, so a window with converged starts is not replayed again.

    Args:
        problem: What is fitted.
        theta: Parameters, shape (C, P), or (C, W, P) if they differ from window to window.
        starts: First guess, shape (4, C, W).
        step_limit: Largest number of steps.
        control: States when a start is found.
    """
    theta = np.broadcast_to(
        theta if theta.ndim > 2 else theta[:, None], (*starts.shape[1:], theta.shape[-1])
    )
    found = starts.copy()
    left = np.arange(len(problem.windows))
    current = problem.linearise(theta, starts, slopes=False)
    misfit = problem.misfit(current.r)
    damping = np.ones_like(misfit)
    for _ in range(step_limit):
        moved = starts - current.start_step(damping)
        trial = problem.linearise(theta, moved, slopes=False)
        reached = problem.misfit(trial.r)
        better = reached < misfit
        starts = np.where(better, moved, starts)
        found[..., left] = starts
        going = np.asarray((np.abs(misfit - reached) >= control.start_tolerance).any(axis=0))
        if not going.any():
            break
        current = trial.where(better, current).take(going)
        misfit = np.where(better, reached, misfit)[:, going]
        damping = np.where(better, damping / 3, damping * 30)[:, going]
        starts, theta, left = starts[..., going], theta[:, going], left[going]
        problem = problem.take(going)
    return found


def fit_starts_from_scratch(
    problem: FitProblem[SampleWindows], theta: Array, step_limit: int
) -> Array:
    """The best starts for fixed parameters from no first guess, as ``fit_starts`` finds them."""
    first = problem.initial_starts()
    return fit_starts(problem, theta, np.repeat(first, len(theta), axis=1), step_limit)


def _step_within(normal: Array, slope: Array, least: Array, most: Array) -> Array:
    """Steps that minimise a quadratic between bounds, shape (C, P), by an active set in two passes.

    What would go beyond a bound goes to it, and the others know it.

    Args:
        normal: Second derivatives, shape (C, P, P).
        slope: First derivatives, shape (C, P).
        least: Least steps, shape (C, P).
        most: Largest steps, shape (C, P).
    """
    free: Array = -np.linalg.solve(normal, slope[..., None])[..., 0]
    held = (free < least) | (free > most)
    taken = np.where(held, np.clip(free, least, most), 0.0)
    left = slope + np.einsum("cij,cj->ci", normal, taken)
    among = np.where(held[..., None] | held[..., None, :], np.eye(len(slope[0])), normal)
    rest = -np.linalg.solve(among, np.where(held, 0.0, left)[..., None])[..., 0]
    return np.asarray(np.clip(np.where(held, taken, rest), least, most))


def minimise(
    problem: FitProblem[SampleWindows],
    theta: Array,
    starts: Array,
    step_limit: int,
    patience: int = 2,
    polish: int = 0,
    control: StepControl = STEP_CONTROL,
) -> Minimum:
    """Fit the parameters together with the starts, from each of C first guesses.

    Args:
        problem: What is fitted.
        theta: First guesses, shape (C, P).
        starts: Starts that suit them, shape (4, C, W).
        step_limit: Largest number of steps.
        patience: Number of consecutive steps without a gain that ends it.
        polish: Steps by which starts are fitted to the parameters of a step before its cost is
            compared.
        control: Constants of the steps.
    """
    least, most = problem.bounds
    mean, precision = problem.known
    theta, starts = theta.copy(), starts.copy()
    current = problem.linearise(theta, starts)
    cost = problem.cost(current.r) + (theta - mean) ** 2 @ precision
    damping = np.full(len(theta), control.initial_damping)
    eye = np.eye(len(problem.names))
    idle = np.zeros(len(theta), dtype=int)
    every, steps = np.arange(len(theta)), 0
    while steps < step_limit and (idle < patience).any():
        steps += 1
        at = np.flatnonzero(idle < patience) if control.drops_idle else every
        here = current if len(at) == len(theta) else current.select(at)
        now, damped_by = theta[at], damping[at]
        # starts that a step would throw too far are held back with the parameters
        free, follow = here.eliminate_starts(np.maximum(damped_by - 1.0, 0.0))
        r, J = free[..., 0], free[..., 1:]  # noqa: N806
        weighted = np.swapaxes(J * problem.weights(here.r)[..., None, None], -1, -2)
        normal = (weighted @ J).sum(axis=1) + np.diag(precision)
        slope = (weighted @ r[..., None])[..., 0].sum(axis=1) + precision * (now - mean)
        # Marquardt's scaling by the diagonal, so that no unit matters
        scale = np.diagonal(normal, axis1=-2, axis2=-1)[..., None] * eye
        damped = normal + damped_by[:, None, None] * scale + 1e-9 * eye
        way = _step_within(damped, slope, least - now, most - now)
        moved = np.clip(now + way, least, most)
        step = np.concatenate((np.ones((len(at), 1)), moved - now), axis=-1)
        shifted: Array = starts[:, at] - np.moveaxis(follow @ step[:, None, :, None], -2, 0)[..., 0]
        if polish:
            shifted = fit_starts(problem, moved, shifted, polish)
        trial = problem.linearise(moved, shifted)
        trial_cost = problem.cost(trial.r) + (moved - mean) ** 2 @ precision
        better = trial_cost < cost[at]
        gained = better & (cost[at] - trial_cost >= control.cost_tolerance * cost[at])
        to = at[better]
        theta[to], starts[:, to], cost[to] = moved[better], shifted[:, better], trial_cost[better]
        current.replace_at(to, trial, better)
        decreased = np.maximum(damped_by / control.damping_decrease, control.min_damping)
        damping[at] = np.where(better, decreased, damped_by * control.damping_increase)
        idle[at] = np.where(gained, 0, idle[at] + 1)
    reason = CONVERGED if idle[np.argmin(cost)] >= patience else STEP_LIMIT_REACHED
    return Minimum(theta, starts, cost, current, Termination(reason, steps, step_limit))


Problem_co = TypeVar("Problem_co", bound=FitProblem[SampleWindows], covariant=True)


@dataclass(frozen=True)
class Fit(Generic[Problem_co]):
    """The best fit found.

    Attributes:
        problem: What was fitted.
        found: The minimum, of one candidate.
    """

    problem: Problem_co
    found: Minimum

    def value(self, name: str) -> float:
        """A parameter; 0 if it is not fitted."""
        names = self.problem.names
        return float(self.found.theta[0, names.index(name)]) if name in names else 0.0

    @property
    def by_unknowns(self) -> Array:
        """Slopes of the residuals by C unknowns that were set to what the log shows, (W, M, C)."""
        return np.zeros((*self.found.linearisation.r.shape[1:], 0))

    def estimate(self, *, white: bool = False) -> Estimate:
        """The parameters and their uncertainty, every window an independent observation.

        They are as uncertain as what the log shows of further unknowns makes them.

        Args:
            white: Whether the residuals are white, so that the noise is the same everywhere.
        """
        line, theta = self.found.linearisation, self.found.theta[0]
        slopes = np.concatenate((line.by_parameter, self.by_unknowns[None]), axis=-1)
        line, none = line._replace(by_parameter=slopes), np.zeros(slopes.shape[-1] - len(theta))
        theta, mean, precision = (np.append(each, none) for each in (theta, *self.problem.known))
        free, _ = line.eliminate_starts()
        r, J = free[0, ..., 0], free[0, ..., 1:]  # noqa: N806
        weight = self.problem.weights(line.r)[0]
        # what is believed before counts as one window more
        information = np.einsum("wmi,wmj,w->wij", J, J, weight)
        score = np.einsum("wmi,wm,w->wi", J, r, weight)
        noise = np.einsum("wmi,wmj,w->ij", J, J, weight**2) + np.diag(precision)
        if (shared := self.problem.windows.shared) is not None:
            each = np.swapaxes(J, -1, -2) @ shared * weight[:, None, None]
            noise += each.sum(axis=0) @ each.sum(axis=0).T - np.einsum("wik,wjk->ij", each, each)
        return estimate(
            theta,
            np.concatenate((information, np.diag(precision)[None])),
            np.concatenate((score, (precision * (theta - mean))[None])),
            noise,
            residual=float((line.r**2).sum() / self.problem.windows.size.sum()) if white else None,
        ).first(len(self.problem.names))

    def bound_bias(self, unexplained: float) -> Array:
        """By how much motion that the model does not explain moves the parameters at worst, (P,).

        Least squares takes motion m into the parameters as inv(J'J) J'm, no more of one than
        |m| sqrt(inv(J'J)), if all of it looks like that parameter (Cauchy and Schwarz).

        Args:
            unexplained: Variance of the motion in noise variances.
        """
        line = self.found.linearisation
        free, _ = line.eliminate_starts()
        J, weight = free[0, ..., 1:], self.problem.weights(line.r)[0]  # noqa: N806
        precision = np.diag(self.problem.known[1])
        information = np.einsum("wmi,wmj,w->ij", J, J, weight) + precision
        diagonal = np.diagonal(information)
        scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        inverse = np.linalg.pinv(information / np.outer(scale, scale), hermitian=True)
        size = unexplained * float(weight @ self.problem.windows.size)
        return np.asarray(np.sqrt(size * np.maximum(np.diagonal(inverse), 0.0)) / scale)
