"""Lost motion between motor and plate, from a slow triangle: how wide the loop is, which corners.

What the motor did is sent through the twin's own play and hysteresis of every width; the width that
leaves least of the plate's motion is the rig's.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.errors import LogError
from twin.hal.cams import CamTable
from twin.sim.rig import Hysteresis, Play

SHAPES: dict[str, type[Play] | type[Hysteresis]] = {"flat": Play, "round": Hysteresis}
"""Corners of the loop, and the part of the twin that makes them."""
KEYS = {"flat": "plant.servo.backlash_deg", "round": "plant.servo.hysteresis_deg"}
"""The scenario keys that take the width."""
POINTS = 400
"""Instants of a cycle that are compared."""
CLEAR = 1.5
"""How many times as much one shape must leave as the other to be ruled out."""
NOTHING = 0.01
"""Width in deg up to which there is none: servos and wheels of a rig without any lose half of it at
1 deg/s."""


@dataclass(frozen=True, kw_only=True)
class LostMotion:
    """The loop of plate angle over motor angle of one axis. All in deg of the plate.

    Attributes:
        axis: ``phi`` or ``theta``.
        width: Of the loop along the motor's angle: twice what is lost to each side.
        spread: By how much the cycles differ, largest width less smallest.
        shape: Its corners: ``flat``, ``round``, ``either`` if they cannot be told, or ``none``.
        left: What the best loop of each shape leaves, root mean square.
        gain: Plate angle per motor angle beside the loop, 1 where the cam table is right.
    """

    axis: str
    width: float
    spread: float
    shape: str
    left: dict[str, float]
    gain: float

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {**asdict(self), "key": KEYS.get(self.shape), "verdict": self.words}

    @property
    def words(self) -> str:
        """The verdict in words."""
        if self.shape == "none":
            return f"no lost motion: the loop is {self.width:.3f} deg wide"
        corners = {
            "flat": "flat corners: play, or dry friction in the plate's joint; motor torque, which "
            "jumps at a reversal by friction alone, tells them apart",
            "round": "round corners: hysteresis of elastic parts",
            "either": "the corners cannot be told",
        }[self.shape]
        known = f"{self.width:.3f} deg ({self.spread:.3f} between cycles)"
        return f"lost motion of {known}, {self.width / 2:.3f} to each side; {corners}"


def triangle(amplitude: float, rate: float, cycles: int, period: float) -> Array:
    """Angles of a triangle that begins at 0: a quarter of a cycle, then whole ones, shape (K,).

    Args:
        amplitude: Its largest angle, rad.
        rate: How fast, rad/s.
        cycles: Whole cycles.
        period: From one angle to the next, s.
    """
    length = 4 * amplitude / rate
    phase = np.arange(round((cycles + 0.25) * length / period) + 1) * period / length
    angles: Array = amplitude * (4 * np.abs((phase - 0.25) % 1.0 - 0.5) - 1)
    return angles


def as_plate(cams: CamTable, motor: Array, axis: int) -> Array:
    """Plate angles that motor angles of one axis mean while the other stands level, rad, (K,)."""
    line = np.zeros((len(cams.grid), 2))
    line[:, axis] = cams.grid
    return np.interp(motor, cams.motor(line)[:, axis], cams.grid)


def lost_motion(axis: str, motor: Array, plate: Array, cycles: int) -> LostMotion:
    """The loop of a few cycles of a triangle.

    Args:
        axis: Which.
        motor: Motor angle as plate angle, by the cam table, in rad, evenly in time over a quarter
            of a cycle and then whole ones, shape (K,).
        plate: Angle of the plate's encoder in rad, shape (K,).
        cycles: Whole cycles, 2 or more: the first closes the loop and is not judged.

    Raises:
        LogError: If the motor or the plate did not move.
    """
    every = max(1, round(len(motor) / (cycles + 0.25) / POINTS))
    s, p = np.degrees(motor[::every]), np.degrees(plate[::every])
    travel = float(np.ptp(s))
    if min(travel, float(np.ptp(p))) < NOTHING:
        raise LogError(f"{axis}: motor moved {travel:.4f} deg, plate {np.ptp(p):.4f} deg: too few")
    ends = np.linspace(len(s) * 0.25 / (cycles + 0.25), len(s), cycles + 1).round().astype(int)
    closed = ends[1]
    found = {shape: _best(shape, s[closed:], p[closed:], s[:closed], travel) for shape in SHAPES}
    left = {shape: each[1] for shape, each in found.items()}
    ahead = min(left, key=lambda shape: left[shape])
    width, _, gain = found[ahead]
    own = [
        _best(ahead, s[start:end], p[start:end], s[:start], travel)[0]
        for start, end in pairwise(ends[1:])
    ]
    shape = ahead if max(left.values()) > CLEAR * left[ahead] else "either"
    return LostMotion(
        axis=axis,
        width=width,
        spread=float(np.ptp(own)),
        shape=shape if width > NOTHING else "none",
        left=left,
        gain=gain,
    )


def _best(
    shape: str, s: Array, p: Array, before: Array, travel: float
) -> tuple[float, float, float]:
    """Width in deg, what it leaves in deg rms, and gain, by three ever finer grids."""
    middle, reach = travel / 4, travel / 4
    for _ in range(3):
        widths = np.clip(np.linspace(middle - reach, middle + reach, 41), 0, None)
        left, gains = _left(shape, widths, s, p, before)
        at = int(left.argmin())
        middle, reach = float(widths[at]), reach / 15
    return middle, float(left[at]), float(gains[at])


def _left(shape: str, widths: Array, s: Array, p: Array, before: Array) -> tuple[Array, Array]:
    """What loops of some widths leave, in deg rms, and their gains, shapes (widths,).

    Offset and gain are fitted. What was before brings the loop to where it is.
    """
    part = SHAPES[shape](widths[:, None])
    turns = np.diff(np.concatenate((before, s)), prepend=before[0])
    moved = np.cumsum([part.follow(np.full((1, 2), turn))[:, 0] for turn in turns], axis=0)
    followed = np.where(part.acts[:, 0], moved, np.cumsum(turns)[:, None])[len(before) :]
    followed = followed - followed.mean(axis=0)
    judged = (p - p.mean())[:, None]
    gains = (followed * judged).sum(axis=0) / np.maximum((followed**2).sum(axis=0), 1e-12)
    return np.sqrt(((judged - gains * followed) ** 2).mean(axis=0)), gains
