"""Smooth curves through points: cubic pieces with continuous second derivative.

From plate angles to motor angles: the cams' two-dimensional lookup table, and no cams at all.
"""

from __future__ import annotations

import hashlib
import json
import re
from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from controllers.arrays import Array, Number
from twin.base.data_file import parse_json
from twin.base.errors import ModelError
from twin.base.shipped import model_path


def cubic(grid: Array, values: Array) -> Array:
    """Cubic pieces through points; the first two are one cubic, and so the last two ("not a knot").

    The slopes s at the points follow from a continuous second derivative. Between pieces of length
    h and chords of slope d,

        h_i s_(i-1) + 2 (h_(i-1) + h_i) s_i + h_(i-1) s_(i+1) = 3 (h_i d_(i-1) + h_(i-1) d_i),

    and at both ends from a continuous third one (de Boor, A Practical Guide to Splines, chapter 4).
    ``scipy.interpolate`` gives the same, but takes longer to import than all else of a plant.

    Args:
        grid: Where, rising, shape (n,), n at least 4.
        values: The points, shape (n, ...).

    Returns:
        Coefficients of powers 0 to 3 counted from the lower end of each piece, (4, n - 1, ...).
    """
    n = len(grid)
    points = values.reshape(n, -1)
    h = np.diff(grid)
    d = np.diff(points, axis=0) / h[:, None]
    left, right = h[:-1, None], h[1:, None]
    system, wanted = np.zeros((n, n)), np.empty_like(points)
    inner = np.arange(1, n - 1)
    system[inner, inner - 1], system[inner, inner + 1] = h[1:], h[:-1]
    system[inner, inner] = 2 * (h[:-1] + h[1:])
    wanted[1:-1] = 3 * (right * d[:-1] + left * d[1:])
    for end, near in ((0, 1), (-1, -2)):
        a, b = h[end], h[near]
        system[end, end], system[end, near] = b, a + b
        wanted[end] = ((3 * a + 2 * b) * b * d[end] + a**2 * d[near]) / (a + b)
    s = np.linalg.solve(system, wanted)
    h = h[:, None]
    pieces = points[:-1], s[:-1], (3 * d - 2 * s[:-1] - s[1:]) / h, (s[:-1] + s[1:] - 2 * d) / h**2
    return np.array(pieces).reshape(4, n - 1, *values.shape[1:])


_SPLINE_ORDER = 3
_CAM_CALIBRATION_REMEDY = "run `ballplate calibrate cams --rig FILE --out"


@dataclass(frozen=True)
class FixedRatio:
    """Motors turn the plate's own axes, through a plain ratio."""

    ratio: Number = 1.0
    """Motor angle per plate angle, dimensionless; also (2,) or (N, 2)."""

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for plate angles in rad, both (..., 2)."""
        return self.ratio * plate


@dataclass(frozen=True)
class CamTable:
    """Motor angles over a grid of plate angles, with smooth (cubic) interpolation.

    Both motors depend on both plate angles, because tilting one axis moves the other wheel along
    its cam. Outside the grid the plate angle is clamped to its edge.

    Raises:
        ModelError: If the grid and the table do not fit each other, or are not finite.
    """

    grid: Array
    """Plate angles of the grid's lines in rad, rising, the same for both axes, shape (n,)."""
    angles: Array
    """Motor angles (phi, theta) in rad over plate phi, then plate theta, shape (n, n, 2)."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """How the table was made: model file and its hash, engine, sweep."""
    ratio: float = field(init=False)
    """Motor angle per plate angle about level, mean of the two axes."""
    _pieces: Array = field(init=False, repr=False, compare=False)
    """Of every cell, row by row, the coefficients of powers 0 to 3 of theta, then phi, both counted
    from its lower corner, then motor by motor, shape ((n - 1)^2, 32)."""
    _bounds: tuple[Any, ...] = field(init=False, repr=False, compare=False)
    """First and last line, the last cell, and what makes the place of a cell of its two lines."""
    _lists: tuple[Any, Any] = field(init=False, repr=False, compare=False)
    """Grid, and coefficients cell by cell, as lists, which Python reads faster."""

    def __post_init__(self) -> None:
        """Check the table and prepare its interpolation."""
        n = len(self.grid)
        if self.grid.ndim != 1 or n <= _SPLINE_ORDER or self.angles.shape != (n, n, 2):
            raise ModelError(f"cam table: {self.angles.shape} angles on a grid of {n} lines")
        if not (np.isfinite(self.angles).all() and np.all(np.diff(self.grid) > 0)):
            raise ModelError("cam table: angles must be finite and the grid rising")
        rows = np.moveaxis(cubic(self.grid, self.angles), 2, 0)
        pieces = cubic(self.grid, rows).transpose(4, 2, 0, 3, 1).copy()
        cells = np.moveaxis(pieces, (3, 4), (0, 1))
        theta_first = cells.transpose(0, 1, 4, 3, 2).reshape((n - 1) ** 2, -1)
        object.__setattr__(self, "_pieces", theta_first)
        bounds = (*map(np.asarray, (self.grid[0], self.grid[-1], n - 2)), np.array((n - 1, 1)))
        object.__setattr__(self, "_bounds", bounds)
        object.__setattr__(self, "_lists", (self.grid.tolist(), cells.tolist()))
        i = int(np.clip(self.grid.searchsorted(0.0, "right"), 1, n - 1)) - 1
        u = -float(self.grid[i])
        value, slope = np.array([1.0, u, u**2, u**3]), np.array([0.0, 1.0, 2 * u, 3 * u**2])
        phi, theta = pieces[..., i, i]
        ratio = np.mean((slope @ phi @ value, value @ theta @ slope))
        object.__setattr__(self, "ratio", float(ratio))

    def motor(self, plate: Array) -> Array:
        """Motor angles in rad for plate angles in rad, both (..., 2) in the order phi, theta."""
        if plate.size == 2:  # the same in plain numbers: several times faster for one rig
            grid, cells = self._lists
            first, last = grid[0], grid[-1]
            phi, theta = [
                first if a < first else last if a > last else a for a in plate.ravel().tolist()
            ]
            i, j = [bisect_right(grid, a, 1, len(grid) - 1) - 1 for a in (phi, theta)]
            angles = _bicubic(cells[i][j], phi - grid[i], theta - grid[j])
            return np.array(angles).reshape(plate.shape)
        first, last, end, to_place = self._bounds
        inside = np.minimum(np.maximum(plate.reshape(-1, 2), first), last)
        cell = np.minimum(self.grid.searchsorted(inside, "right") - 1, end)
        into = (inside - self.grid.take(cell)).T
        # each as often as it is multiplied: of few rigs numpy takes three times as long otherwise
        u, v = np.empty((2, *into.shape[1:])), np.empty((8, *into.shape[1:]))
        u[...], v[...] = into
        # in the order of ``_bicubic``, but all of its rows and both motors at once
        patches = self._pieces.take(cell.dot(to_place), axis=0).T.copy()
        rows = patches[:8] + v * (patches[8:16] + v * (patches[16:24] + v * patches[24:]))
        angles = rows[:2] + u * (rows[2:4] + u * (rows[4:6] + u * rows[6:]))
        return angles.T.reshape(plate.shape).copy()

    def per_axis(self) -> CamTable:
        """One table per axis: the angle of each motor while the other axis is level."""
        level = np.zeros_like(self.grid)
        phi = self.motor(np.stack((self.grid, level), axis=-1))[:, 0]
        theta = self.motor(np.stack((level, self.grid), axis=-1))[:, 1]
        angles = np.stack(np.meshgrid(phi, theta, indexing="ij"), axis=-1)
        return CamTable(self.grid, angles, {"made": "one table per axis", "from": self.provenance})

    def save(self, path: Path) -> None:
        """Write the table and its provenance as JSON, a line for every line of the grid."""
        head = json.dumps(self.provenance, indent=2)
        grid = json.dumps([round(float(a), 12) for a in self.grid])
        rows = (json.dumps(np.round(row, 9).tolist()) for row in self.angles)
        body = ",\n    ".join(rows)
        text = (
            f'{{\n"provenance": {head},\n"plate_rad": {grid},\n"motor_rad": [\n    {body}\n]\n}}\n'
        )
        path.write_text(text, encoding="utf-8")

    @classmethod
    def from_file(cls, path: Path) -> Self:
        """Read a table that `save` wrote.

        Raises:
            ModelError: If the file is missing, or is not such a table.
        """
        try:
            data = parse_json(path.read_text(encoding="utf-8"))
            grid = np.array(data["plate_rad"], dtype=float)
            angles = np.array(data["motor_rad"], dtype=float)
            return cls(grid, angles, dict(data["provenance"]))
        except OSError as error:
            raise ModelError(
                f"cam table {path}: {error.strerror}; {_CAM_CALIBRATION_REMEDY} {path}`"
            ) from error
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(
                f"cam table {path}: not a cam table ({error}); {_CAM_CALIBRATION_REMEDY} {path}`"
            ) from error

    @classmethod
    def packaged(cls) -> Self:
        """The table that comes with the packaged model.

        Raises:
            ModelError: If it is missing, is no cam table, or was made with a different model.
        """
        table = cls.from_file(model_path("cams.json"))
        table.check(model_path())
        return table

    def check(self, model: Path) -> None:
        """Make sure the table was made with this very model.

        Raises:
            ModelError: If it was not.
        """
        if self.provenance.get("model_sha256") != model_hash(model):
            raise ModelError(
                f"cam table was not made with this {model.name}, {model}; make it again: "
                "twin.sim.calibration.sweep_cams().save(file)"
            )


def _bicubic(patches: Any, u: Any, v: Any) -> list[Any]:
    """Sums of patch[i][j] u^i v^j over i and j for each patch; numbers or arrays of one shape."""
    rows = [[a + v * (b + v * (c + v * d)) for a, b, c, d in patch] for patch in patches]
    return [a + u * (b + u * (c + u * d)) for a, b, c, d in rows]


def model_hash(model: Path) -> str:
    """SHA-256 of a model file without its comments and spacing.

    Raises:
        ModelError: If the file cannot be read.
    """
    try:
        text = model.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ModelError(f"model {model}: cannot be read") from error
    content = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).split()
    return hashlib.sha256(" ".join(content).encode()).hexdigest()
