"""Where on the plate a position on the screen is: orientation, mirror and scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from twin.errors import TwinError
from twin.hal.interface import SCREEN


class CalibrationError(TwinError, ValueError):
    """A calibration cannot be made from what was given."""


@dataclass(frozen=True)
class Calibration:
    """Plate position = matrix . screen position + origin.

    Attributes:
        matrix: m in plate axes per screen unit; a screen unit is the whole range of an axis.
        origin: Where on the plate the screen's (0, 0) is, m in plate axes.
    """

    matrix: tuple[tuple[float, float], tuple[float, float]]
    origin: tuple[float, float]

    def __post_init__(self) -> None:
        """Refuse what cannot be inverted."""
        (a, b), (c, d) = self.matrix
        if not np.isfinite([a, b, c, d, *self.origin]).all() or abs(a * d - b * c) < 1e-6:
            raise CalibrationError(
                f"calibration: matrix {self.matrix} must be finite and cover an area"
            )

    @classmethod
    def nominal(
        cls,
        *,
        swapped: bool = False,
        mirrored_x: bool = False,
        mirrored_y: bool = True,
        size: tuple[float, float] = (SCREEN[0], SCREEN[1]),
    ) -> Self:
        """A screen mounted square and centred on the plate.

        Args:
            swapped: Whether the screen's first axis runs along the plate's y.
            mirrored_x: Whether the screen's position along the plate's x counts backwards.
            mirrored_y: The same along y; a screen's second axis usually counts downwards.
            size: Sides of the sensing area along the plate's x and y, m.
        """
        x = -size[0] if mirrored_x else size[0]
        y = -size[1] if mirrored_y else size[1]
        matrix = ((0.0, x), (y, 0.0)) if swapped else ((x, 0.0), (0.0, y))
        return cls(matrix, (-x / 2, -y / 2))

    def plate(self, x: float, y: float) -> tuple[float, float]:
        """Position in m in plate axes of one in screen units."""
        (a, b), (c, d) = self.matrix
        return a * x + b * y + self.origin[0], c * x + d * y + self.origin[1]

    def screen(self, x: float, y: float) -> tuple[float, float]:
        """Position in screen units of one in m in plate axes."""
        (a, b), (c, d) = self.matrix
        x, y = x - self.origin[0], y - self.origin[1]
        area = a * d - b * c
        return (d * x - b * y) / area, (a * y - c * x) / area


def fit(screen: ArrayLike, plate: ArrayLike) -> tuple[Calibration, float]:
    """The calibration that suits known points best, by least squares.

    Args:
        screen: What the screen said, screen units, shape (K, 2), K at least 3.
        plate: Where the points are, m in plate axes, shape (K, 2).

    Returns:
        The calibration and the root mean square distance in m that it leaves.

    Raises:
        CalibrationError: Fewer than three points, or all on one line.
    """
    seen, true = np.asarray(screen, float), np.asarray(plate, float)
    if seen.ndim != 2 or seen.shape != true.shape or seen.shape[1] != 2 or len(seen) < 3:
        raise CalibrationError(
            f"calibration: needs 3 or more pairs of points, got {seen.shape} and {true.shape}"
        )
    system = np.column_stack([seen, np.ones(len(seen))])
    solution, _, rank, _ = np.linalg.lstsq(system, true, rcond=1e-6)
    if rank < 3:
        raise CalibrationError("calibration: the points must not lie on one line")
    (a, c), (b, d), origin = solution.tolist()
    left = system @ solution - true
    calibration = Calibration(((a, b), (c, d)), (origin[0], origin[1]))
    return calibration, float(np.sqrt((left**2).sum(axis=1).mean()))
