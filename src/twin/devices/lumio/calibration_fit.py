"""The calibration of a touch screen from known points that were touched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from controllers.arrays import Array
from twin.devices.lumio.calibration import Calibration, CalibrationError

UNKNOWNS = 6
"""Numbers of an affine map of the plane."""
DOUBT = 0.01
"""Chance at which points that were all touched rightly are told to have a wrong one among them."""


@dataclass(frozen=True)
class CalibrationFit:
    """A calibration, and what it leaves.

    Attributes:
        calibration: Screen units to plate axes.
        left: Where the calibration puts the points less where they are, m, shape (K, 2).
    """

    calibration: Calibration
    left: Array

    @property
    def distances(self) -> Array:
        """How far from each point the calibration puts it, m, shape (K,)."""
        return np.asarray(np.hypot(self.left[:, 0], self.left[:, 1]))

    @property
    def rms(self) -> float:
        """Root mean square of these distances, m."""
        return float(np.sqrt(np.mean(self.distances**2)))


def fit(screen: ArrayLike, plate: ArrayLike) -> CalibrationFit:
    """The calibration that suits known points best, by least squares.

    Args:
        screen: What the screen said, screen units, shape (K, 2), K at least 3.
        plate: Where the points are, m in plate axes, shape (K, 2).

    Raises:
        CalibrationError: Fewer than three points, or all on one line.
    """
    seen, true = np.asarray(screen, float), np.asarray(plate, float)
    if seen.ndim != 2 or seen.shape != true.shape or seen.shape[1] != 2 or len(seen) < 3:
        raise CalibrationError(
            f"calibration: needs 3 or more pairs of points, got {seen.shape} and {true.shape}"
        )
    check_spread(true)
    system = _system(seen)
    solution, _, rank, _ = np.linalg.lstsq(system, true, rcond=1e-6)
    if rank < 3:
        raise CalibrationError("calibration: the points must not lie on one line")
    (a, c), (b, d), origin = solution.tolist()
    calibration = Calibration(((a, b), (c, d)), (origin[0], origin[1]))
    return CalibrationFit(calibration, system @ solution - true)


def check_spread(points: ArrayLike) -> None:
    """Make sure that points do not lie on one line.

    Args:
        points: Shape (K, 2).

    Raises:
        CalibrationError: If they do.
    """
    if np.linalg.matrix_rank(_system(np.asarray(points, float)), rtol=1e-6) < 3:
        raise CalibrationError("calibration: the points must not lie on one line")


def outlier(screen: Array, plate: Array) -> tuple[int, float] | None:
    """The point that does not fit the others, if there is one, and how far it is off, in m.

    Each point is compared with the calibration of the others: the square of its distance from
    where they put it, over their own scatter, follows an F distribution if it is one of them. With
    fewer than five points the others leave no scatter to compare with.

    Args:
        screen: What the screen said, screen units, shape (K, 2).
        plate: Where the points are, m, shape (K, 2).
    """
    count = len(plate)
    freedom = 2 * (count - 1) - UNKNOWNS
    if freedom < 1:
        return None
    ratios, distances = np.zeros(count), np.zeros(count)
    for index in range(count):
        others = np.arange(count) != index
        try:
            found = fit(screen[others], plate[others])
        except CalibrationError:
            continue  # nothing but this point keeps the others from a line: it cannot be judged
        system, row = _system(screen[others]), _system(screen[index : index + 1])
        reach = 1 + float((row @ np.linalg.pinv(system.T @ system) @ row.T).item())
        off = np.array(found.calibration.plate(*screen[index])) - plate[index]
        scatter = float((found.left**2).sum()) / freedom
        distances[index] = float(np.hypot(*off))
        ratios[index] = float(off @ off) / 2 / max(scatter * reach, 1e-30)
    worst = int(np.argmax(ratios))
    chance = count * float(scipy.special.fdtrc(2, freedom, ratios[worst]))
    return (worst, float(distances[worst])) if chance < DOUBT else None


def _system(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])
