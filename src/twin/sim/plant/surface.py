"""How a real screen varies from place to place: its friction and how level it is."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.errors import ModelError
from twin.hal.interface import SCREEN
from twin.settings import Unit, setting


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceMap:
    """Relative friction and height over a grid of points, straight between them.

    The grid's lines are spread evenly from edge to edge of the screen: the first index goes along
    x, the second along y, both from the negative to the positive edge. Leading axes are rigs.

    Attributes:
        relative: Rolling friction relative to the friction's own, shape (..., n, m), not negative.
        height: Height of the surface in m, shape (..., n, m); only its slope matters.

    Raises:
        ModelError: If a grid has fewer than two lines a side, the two differ in shape, or a number
            is out of range.
    """

    relative: Array | None = None
    height: Array | None = None
    _grids: Array = field(init=False, repr=False)
    """Relative friction, slope along x and along y as one array, shape (N, n, m, 3)."""
    _steps: NDArray[np.integer] = field(init=False, repr=False)
    """Steps of each rig's grid along x and y, shape (N, 2); what lies beyond is not used."""

    def __post_init__(self) -> None:
        """Check the grids and work out the slopes."""
        given = [
            np.asarray(grid, float) for grid in (self.relative, self.height) if grid is not None
        ]
        if not given:
            raise ModelError("a surface map needs a grid of relative friction or of heights")
        shape = given[0].shape
        if any(grid.shape != shape for grid in given) or len(shape) < 2 or min(shape[-2:]) < 2:
            raise ModelError(
                f"a surface map needs equal grids of at least 2 x 2 points, "
                f"got {' and '.join('x'.join(map(str, grid.shape)) for grid in given)}"
            )
        if not all(np.isfinite(grid).all() for grid in given):
            raise ModelError("a surface map must be finite")
        grids = np.zeros((*shape, 3))
        grids[..., 0] = 1.0 if self.relative is None else self.relative
        if (grids[..., 0] < 0).any():
            raise ModelError("relative friction must not be negative")
        if self.height is not None:
            across = [side / (lines - 1) for side, lines in zip(SCREEN, shape[-2:], strict=True)]
            slopes = np.gradient(np.asarray(self.height, float), *across, axis=(-2, -1))
            grids[..., 1], grids[..., 2] = slopes
        object.__setattr__(self, "_grids", grids.reshape(-1, *shape[-2:], 3))
        steps = np.subtract(shape[-2:], 1)
        object.__setattr__(self, "_steps", np.tile(steps, (len(self._grids), 1)))

    @property
    def sloping(self) -> bool:
        """Whether the surface is anywhere not flat."""
        return bool(self._grids[..., 1:].any())

    def __call__(self, position: Array) -> tuple[Array, Array]:
        """Relative friction, shape (...), and slope (dz/dx, dz/dy), shape (..., 2).

        Args:
            position: Ball in plate axes in m, shape (..., 2); beside the screen its edge counts.
        """
        rig = np.arange(len(self._grids)) if len(self._grids) > 1 else 0
        n, m = self._steps[rig, 0], self._steps[rig, 1]
        u = np.clip((position[..., 0] / SCREEN[0] + 0.5) * n, 0, n)
        v = np.clip((position[..., 1] / SCREEN[1] + 0.5) * m, 0, m)
        i = np.minimum(u.astype(int), n - 1)
        j = np.minimum(v.astype(int), m - 1)
        s, t = (u - i)[..., None], (v - j)[..., None]
        g = self._grids
        near = (1 - t) * g[rig, i, j] + t * g[rig, i, j + 1]
        far = (1 - t) * g[rig, i + 1, j] + t * g[rig, i + 1, j + 1]
        value = (1 - s) * near + s * far
        return value[..., 0], value[..., 1:]

    @classmethod
    def random(
        cls, *, seed: int, patch: float = 0.05, spread: float = 0.0, slope: float = 0.0
    ) -> SurfaceMap:
        """A screen drawn at random: patches of differing friction, and waves.

        Args:
            seed: Which screen.
            patch: Distance of the grid's points in m, roughly the size of a patch.
            spread: Standard deviation of the logarithm of the relative friction, dimensionless.
            slope: Root mean square of the local slope in rad.
        """
        lines = [max(2, round(side / patch) + 1) for side in SCREEN]
        rng = np.random.default_rng(seed)
        relative = np.exp(spread * rng.standard_normal(lines) - spread**2 / 2)
        if slope == 0:
            return cls(relative=relative)
        waves = cls(height=rng.standard_normal(lines))
        scale = slope / np.sqrt((waves._grids[..., 1:] ** 2).mean())
        assert waves.height is not None
        return cls(relative=relative, height=scale * waves.height)

    @classmethod
    def stacked(cls, maps: Sequence[SurfaceMap | None]) -> SurfaceMap | None:
        """The surfaces of N rigs, of one each, as one; None stands for an even, level one."""
        if all(each is maps[0] for each in maps):
            return maps[0]
        even = cls(relative=np.ones((2, 2)))
        given = [even if each is None else each for each in maps]
        steps = np.concatenate([each._steps for each in given])
        grids = np.zeros((len(given), *(steps.max(axis=0) + 1), 3))
        for all_of_it, each in zip(grids, given, strict=True):
            _, n, m, _ = each._grids.shape
            all_of_it[:n, :m] = each._grids[0]
        stacked = copy(even)
        object.__setattr__(stacked, "relative", None)
        object.__setattr__(stacked, "_grids", grids)
        object.__setattr__(stacked, "_steps", steps)
        return stacked


Grid = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class SurfaceModel:
    """How a screen varies: drawn at random, or grids from edge to edge.

    Attributes:
        spread: Standard deviation of the logarithm of the friction, dimensionless.
        slope: Root mean square of the local slope in rad.
        patch: Length in m over which both change.
        seed: Which screen is drawn.
        relative: Friction relative to that of the ball; rows along x, columns along y, both from
            the negative edge to the positive one; empty for none.
        height: Height in m over the same grid; empty for none.
    """

    spread: float = setting("plant.surface.spread_percent", 0.0, Unit.PERCENT, ge=0, le=100)
    slope: float = setting("plant.surface.slope_deg", 0.0, Unit.DEG, ge=0, le=2)
    patch: float = setting("plant.surface.patch_mm", 50.0, Unit.MM, ge=5, le=300)
    seed: int = setting("plant.surface.seed", 0, ge=0)
    relative: Grid = setting("plant.surface.relative", (), type=Grid)
    height: Grid = setting("plant.surface.height_um", (), Unit.UM, type=Grid)

    def map(self) -> SurfaceMap | None:
        """The surface; None if it is even and level."""
        if self.relative or self.height:
            return SurfaceMap(
                relative=np.array(self.relative) if self.relative else None,
                height=np.array(self.height) if self.height else None,
            )
        if self.spread or self.slope:
            return SurfaceMap.random(
                seed=self.seed, patch=self.patch, spread=self.spread, slope=self.slope
            )
        return None
