"""The calibration of a rig's touch screen: points of the plate are touched in turn and read."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.devices.lumio.calibration import Calibration, CalibrationError
from twin.devices.lumio.calibration_fit import CalibrationFit, check_spread, fit, outlier
from twin.devices.lumio.conditions import TWO_CONTACTS
from twin.devices.lumio.config import LumioConfig, PlausibilityLimits
from twin.devices.lumio.mounting import Mounting
from twin.devices.lumio.presence import TouchState
from twin.devices.lumio.screen import LumioScreen
from twin.devices.lumio.tracking import Sample
from twin.doctor.check import Ask
from twin.doctor.steps import wait_until
from twin.errors import RigError
from twin.hal.interface import SCREEN

LEAST = 4
"""Points: three would fit whatever was touched."""
SHARE = 0.8
"""Of the screen's sides that the usual points span."""
READINGS = 20
"""Reports in a row that a point is the mean of, a third of a second of them."""
STILL = 0.003
"""Spread of these, in sides of the screen, beyond which the touch is still settling or moving."""
SLIP = 0.003
"""Distance in m by which a finger or a ball misses a mark at most (assumed)."""
SCATTER = 0.005
"""Root mean square in m from which the points cannot be those that were asked for."""
SCREEN_UNITS = Calibration(((1.0, 0.0), (0.0, 1.0)), (0.0, 0.0))


def usual_points() -> list[tuple[float, float]]:
    """Nine points in rows over most of the screen, m in plate axes."""
    x, y = (round(SHARE * side / 2, 3) for side in SCREEN[:2])
    return [(i * x, j * y) for j in (-1, 0, 1) for i in (-1, 0, 1)]


@dataclass(frozen=True)
class MeasuredTouch:
    """A measured calibration.

    Attributes:
        fit: The calibration and what it leaves.
        points: The points touched, m in plate axes, shape (K, 2).
    """

    fit: CalibrationFit
    points: Array

    @property
    def mounting(self) -> Mounting:
        """What it says of the screen."""
        return Mounting.of(self.fit.calibration)

    def as_dict(self) -> dict[str, Any]:
        """What it says and leaves, for ``--json``."""
        return {
            **self.mounting.as_dict(),
            "points": len(self.points),
            "rms_mm": round(1e3 * self.fit.rms, 4),
            "residuals": [
                {"point_mm": point, "off_mm": off}
                for point, off in zip(
                    np.round(1e3 * self.points, 3).tolist(),
                    np.round(1e3 * self.fit.left, 4).tolist(),
                    strict=True,
                )
            ],
        }

    def save(self, path: Path) -> None:
        """Write the file that a rig file names as ``touch.calibration_file``."""
        date = time.strftime("%Y-%m-%d")
        made = {"made": "measured on a rig", "date": date, **self.as_dict()}
        self.fit.calibration.save(path, made)


def measure(
    config: LumioConfig,
    points: Sequence[tuple[float, float]],
    ask: Ask,
    patience: float,
    progress: Callable[[float], None] = lambda _: None,
) -> MeasuredTouch:
    """Have points touched in turn and fit the calibration to what the screen says.

    Args:
        config: The screen's settings; its calibration is not used.
        points: Where to touch, m in plate axes.
        ask: Asks for a touch, ``touch X Y`` in mm, and for its end, ``lift``.
        patience: Seconds that each of these is waited for.
        progress: Called with the number of points done.

    Raises:
        CalibrationError: Too few points, all on one line, or touched wrongly.
        RigError: The screen cannot be opened, or a point was not touched.
    """
    goals = np.array(points, float).reshape(-1, 2)
    if len(goals) < LEAST:
        raise CalibrationError(
            f"calibration: {len(goals)} points; {LEAST} or more are needed to see a wrong one"
        )
    check_spread(goals)
    gate = PlausibilityLimits()
    screen = LumioScreen(replace(config, calibration=SCREEN_UNITS, gate=gate))
    seen = []
    with screen:
        for index, goal in enumerate(goals):
            words = place(goal)
            ask(f"touch {1e3 * goal[0]:g} {1e3 * goal[1]:g}")
            seen.append(_read(screen, words, patience))
            ask("lift")
            if not wait_until(lambda: screen.state is TouchState.LOST, patience):
                raise RigError(f"calibration: {words} was not let go within {patience:g} s")
            progress(index + 1)
    return MeasuredTouch(judged(np.array(seen), goals), goals)


def judged(seen: Array, points: Array) -> CalibrationFit:
    """The calibration of touched points.

    Args:
        seen: What the screen said, screen units, shape (K, 2).
        points: Where they are, m, shape (K, 2).

    Raises:
        CalibrationError: They do not fit together; one that does not fit the others is named.
    """
    wrong = outlier(seen, points)
    if wrong is not None and wrong[1] > SLIP:
        index, distance = wrong
        raise CalibrationError(
            f"calibration: point {index + 1}, {place(points[index])}, was touched "
            f"{1e3 * distance:.1f} mm from where the others put it; begin again"
        )
    found = fit(seen, points)
    if found.rms > SCATTER:
        raise CalibrationError(
            f"calibration: the points do not fit together ({1e3 * found.rms:.1f} mm RMS, at most "
            f"{1e3 * SCATTER:g}); touch them in the order in which they are asked for"
        )
    return found


def place(point: Array) -> str:
    """A point of the plate in words."""
    return f"x {1e3 * point[0]:+.0f}, y {1e3 * point[1]:+.0f} mm"


def _read(screen: LumioScreen, words: str, patience: float) -> tuple[float, float]:
    """The mean position of a steady touch, screen units."""
    before = screen.stream.sample
    kept: list[Sample] = []

    def steady() -> bool:
        sample, last = screen.stream.sample, kept[-1] if kept else before
        if any(fault.condition is TWO_CONTACTS for fault in screen.faults()):
            kept.clear()
        elif sample is not None and (last is None or sample.time > last.time):
            if kept and sample.time - kept[-1].time > screen.config.gate.lost:
                kept.clear()
            kept.append(sample)
            del kept[:-READINGS]
        if len(kept) < READINGS:
            return False
        return bool(np.ptp([each.position for each in kept], axis=0).max() < STILL)

    if not wait_until(steady, patience):
        hint = f"; {screen.hint}" if screen.hint and not kept else ""
        what = "touched steadily" if kept else "touched"
        raise RigError(f"calibration: {words} was not {what} within {patience:g} s{hint}")
    x, y = np.mean([each.position for each in kept], axis=0).tolist()
    return x, y
