"""Where on the plate a position on the screen is: orientation, mirror and scale."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from twin.data_file import parse_json
from twin.errors import TwinError
from twin.hal.interface import SCREEN

_REMEDY = "run `ballplate calibrate touch`"


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

    def save(self, path: Path, provenance: Mapping[str, Any]) -> None:
        """Write it and how it was made as JSON.

        Args:
            path: The file.
            provenance: How it was made.
        """
        data = {"provenance": dict(provenance), "matrix_m": self.matrix, "origin_m": self.origin}
        path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")


def read_calibration(path: Path) -> tuple[Calibration, dict[str, Any]]:
    """A calibration that `save` wrote, and how it was made.

    Raises:
        CalibrationError: If the file is missing, or is not such a calibration.
    """
    try:
        data = parse_json(path.read_text(encoding="utf-8"))
        (a, b), (c, d) = data["matrix_m"]
        x, y = data["origin_m"]
        numbers = [a, b, c, d, x, y]
        if not all(type(each) in {int, float} for each in numbers):
            raise TypeError("matrix_m and origin_m must be numbers")
        a, b, c, d, x, y = map(float, numbers)
        return Calibration(((a, b), (c, d)), (x, y)), dict(data["provenance"])
    except OSError as error:
        raise CalibrationError(f"{path}: {error.strerror}; {_REMEDY}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: not a calibration ({error}); {_REMEDY}") from error
