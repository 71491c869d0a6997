"""The fit of all windows at once: parameters common to all, the ball's start free in each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.identify.parameters import BALL, IdentifiedParameter, friction
from twin.identify.replay import replay
from twin.identify.windows import LOOKBACK, Windows

START_DIFFERENCES = np.array([1e-4, 1e-4, 1e-3, 1e-3])
"""Steps of finite differences of the ball's start: m and m/s."""
TOLERATED = 3.0
"""Mean square misfit, in noise variances, above which a window loses weight (Geman and McClure):
a window that no replay explains costs no more than a few that are explained badly, however far off
it is. Where a loss goes on growing, such windows pull the fit to where it explains none well."""
# A weak prior of the ball's start (m, m/s), for windows whose samples do not determine it.
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
        """That of some of the windows."""
        r, by_start, by_parameter = (part[:, which] for part in self[:3])
        return Linearisation(r, by_start, by_parameter, self.prior)

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


class Fitting:
    """What any fit of windows minimises.

    Attributes:
        windows: The samples.
        names: Names of the parameters that are fitted, P of them.
        about: What is known of each parameter.
        start_steps: Steps of finite differences of a start.
        prior: Weak knowledge of a start, its inverse covariance.
    """

    windows: Any
    names: tuple[str, ...]
    about: ClassVar[Mapping[str, IdentifiedParameter]]
    start_steps: ClassVar[Array]
    prior: ClassVar[Array]

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Least and largest values of the parameters, shapes (P,)."""
        about = [self.about[name] for name in self.names]
        return np.array([each.least for each in about]), np.array([each.most for each in about])

    def initial_starts(self) -> Array:
        """First guesses of the starts, S numbers of each window, shape (S, 1, W)."""
        raise NotImplementedError

    def reported(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """What the samples would be, in m, and how fast they change, (C, W, ...) like the samples.

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
        batch = [(theta, starts)]
        for k in range(free):
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
        places, rates = self.reported(
            np.concatenate([each[0] for each in batch]),
            np.concatenate([each[1] for each in batch], axis=1),
        )
        shape = (len(batch), count, len(weight), weight[0].size)
        scaled = (places * weight).reshape(shape)
        by_start = np.stack(
            [(scaled[1 + k] - scaled[0]) / self.start_steps[k] for k in range(free)], axis=-1
        )
        by_parameter = np.zeros((*shape[1:], len(self.names) if slopes else 0))
        for j, (k, width) in enumerate(widths.items()):
            up, down = scaled[1 + free + 2 * j : 3 + free + 2 * j]
            by_parameter[..., k] = (up - down) / width
        if slopes and "delay" in self.names:
            by_delay = (-rates[:count] * weight).reshape(shape[1:])
            by_parameter[..., self.names.index("delay")] = by_delay
        target = (self.windows.ball * weight).reshape(shape[2:])
        return Linearisation(scaled[0] - target, by_start, by_parameter, self.prior)

    def misfit(self, r: Array) -> Array:
        """Mean square residual of each window in noise variances, shape (C, W)."""
        return np.asarray((r**2).sum(axis=-1) / self.windows.size)

    def cost(self, r: Array) -> Array:
        """What a fit minimises: robust against windows that cannot be explained, shape (C,)."""
        misfit = self.misfit(r)
        each = self.windows.size * misfit / (1 + misfit / TOLERATED)
        return np.asarray(each.sum(axis=-1))

    def weights(self, r: Array) -> Array:
        """How much each window counts, 1 for a perfect one, shape (C, W)."""
        return np.asarray(1 / (1 + self.misfit(r) / TOLERATED) ** 2)


@dataclass(frozen=True)
class Problem(Fitting):
    """What is fitted to what.

    Attributes:
        model: Ball parameters.
        windows: The samples.
        names: Names of the parameters that are fitted, P of them.
        grip: Time in s within which friction stops a ball, see ``replay``.
    """

    model: BallPlate
    windows: Windows
    names: tuple[str, ...]
    grip: float = 0.0
    about = BALL
    start_steps = START_DIFFERENCES
    prior = START_PRIOR

    def values(self, theta: Array) -> dict[str, Array]:
        """All ball parameters by name, those not fitted at values without effect, shape (C, 1).

        Args:
            theta: Parameters, shape (C, P), or (C, W, P) for (C, W) of each.
        """
        defaults = {name: BALL[name].least if name != "stribeck" else 0.005 for name in BALL}
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
            first = (windows.time[w] < LOOKBACK + 0.25) & (windows.weight[w, :, 0] > 0)
            t = windows.time[w, first] - 0.04
            line = np.stack((np.ones_like(t), t), axis=-1)[:, : 1 if resting else 2]
            found = np.linalg.lstsq(line, windows.ball[w, first], rcond=None)[0]
            out[: 2 * len(found), 0, w] = found.ravel()
        return out

    def replayed(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """Positions and velocities of the ball in m and m/s, both shape (N, 2, C, W).

        Args:
            theta: Parameters, shape (C, P), or (C, W, P) if they differ from window to window.
            starts: x, y, x', y' at the beginning of each window, shape (4, C, W).
        """
        values = self.values(theta)
        level = np.stack((values["level_phi"], values["level_theta"]))
        return replay(
            self.windows.field,
            self.model,
            friction(values),
            level,
            starts,
            self.grip,
            values["gain"],
            self.windows.paces,
        )

    def reported(self, theta: Array, starts: Array) -> tuple[Array, Array]:
        """What the screen would have reported in m, and its rate in m/s, (C, W, B, 2)."""
        places, speeds = self.replayed(theta, starts)
        return self.windows.at_samples(places, speeds, self.values(theta)["delay"])

    def linearise(self, theta: Array, starts: Array, *, slopes: bool = True) -> Linearisation:
        """Residuals and slopes of C candidates; a resting ball has no speed to be fitted."""
        found = super().linearise(theta, starts, slopes=slopes)
        found.by_start[:, self.windows.resting, :, 2:] = 0.0
        return found
