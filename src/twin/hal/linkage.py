"""Transmissions between two servos and a plate: cranks and rods in closed form, measured tables.

The arm of axis phi lies on the plate's -x axis and the arm of theta on its +y axis, so that a crank
that turns up tilts its axis to positive angles, as a cam does. With c = cos(theta) for phi and 1
for theta, a rod of length l joins, seen from the servo's axis, the end of its crank (r cos m,
r sin m) and the end of the arm a: p = a cos(angle) - d outwards, q = a c sin(angle) + h up, and the
rest of a perpendicular to the crank's plane. At level crank and arm are horizontal, which gives the
depth h.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from controllers.arrays import Array
from twin.base.followers import FREE, GIVEN, Followers
from twin.base.settings import Unit, setting

Pair = tuple[float, float] | Array

ANGLE_SPARE_FACTOR = 1.1
"""Tilt that a linkage must allow, as a multiple of the plate's largest tilt."""
LOCKING_TOLERANCE = 1e-6
"""Difference of a cosine from 1 at which a linkage locks; error in rad above which it does."""


LENGTH_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    explain="compares runs of one build of the rig; its unknown errors belong to rig.cams",
    identify="reads the plate's angles from its encoders",
    symbols="have the plate's acceleration as their input",
)


@dataclass(frozen=True, kw_only=True)
class Linkage:
    """The lengths of both linkages for (phi, theta), shape (2,) or (N, 2); 0 for none.

    As a transmission it knows its own lengths and that phi needs a little more crank the further
    theta is tilted; theta does not depend on phi.

    Attributes:
        crank: From the servo's axis to the rod, m; horizontal and outwards at level.
        rod: Between its two ball joints, m.
        arm: From the universal joint to the rod along the plate, m.
        distance: From the universal joint to the servo's axis, horizontally, m.
    """

    crank: Pair = setting(
        "plant.linkage.crank_mm", (0.0, 0.0), Unit.MM, followed_by=LENGTH_FOLLOWERS, ge=0, le=1000
    )
    rod: Pair = setting(
        "plant.linkage.rod_mm", (0.0, 0.0), Unit.MM, followed_by=LENGTH_FOLLOWERS, ge=0, le=2000
    )
    arm: Pair = setting(
        "plant.linkage.arm_mm", (0.0, 0.0), Unit.MM, followed_by=LENGTH_FOLLOWERS, ge=0, le=1000
    )
    distance: Pair = setting(
        "plant.linkage.distance_mm",
        (0.0, 0.0),
        Unit.MM,
        followed_by=LENGTH_FOLLOWERS,
        ge=0,
        le=1000,
    )

    @property
    def given(self) -> bool:
        """Whether there is one at all."""
        return bool(np.any(self.crank))

    @property
    def ratio(self) -> Array:
        """Crank angle per plate angle at level, dimensionless, shape (2,) or (N, 2)."""
        return np.divide(self.arm, self.crank)

    @property
    def lean(self) -> Array:
        """Horizontal distance of the ends of crank and arm at level, m."""
        return np.subtract(self.arm, self.distance) - self.crank

    @property
    def depth(self) -> Array:
        """Depth of the servos' axes below the universal joint, m."""
        return np.sqrt(np.square(self.rod) - self.lean**2)

    @cached_property
    def _lengths(self) -> tuple[Array, Array, Array, Array, Array]:
        each = self.crank, self.arm, self.distance, self.depth, np.square(self.rod)
        return tuple(map(np.asarray, each))  # type: ignore[return-value]

    def motor(self, plate: Array) -> Array:
        """Crank angles in rad that hold plate angles (phi, theta) in rad, both (..., 2)."""
        r, a, d, h, square = self._lengths
        c, up = _height_share(plate), a * np.sin(plate)
        p, q = a * np.cos(plate) - d, c * up + h
        reach = (p**2 + q**2 + (1 - c**2) * up**2 + r**2 - square) / (2 * r)
        return np.arctan2(q, p) - _arccos(reach / np.hypot(p, q))

    def plate(self, motor: Array) -> Array:
        """Plate angles in rad for crank angles in rad, both (..., 2)."""
        r, a, d, h, square = self._lengths
        u, v = d + r * np.cos(motor), h - r * np.sin(motor)
        reach = (a**2 + u**2 + v**2 - square) / (2 * a)
        tilt = _arccos(reach / np.hypot(u, v)) - np.arctan2(v, u)
        v = _height_share(tilt) * v  # theta is right by now; phi depends on it
        return _arccos(reach / np.hypot(u, v)) - np.arctan2(v, u)

    def plate_rate(self, plate: Array, motor: Array, rate: Array) -> Array:
        """Rates of the plate in rad/s for those of the cranks at their angles; all (..., 2)."""
        by_crank, by_plate, by_other = self._slopes(plate, motor)
        found = -by_crank * rate / by_plate
        found[..., 0] -= by_other * found[..., 1] / by_plate[..., 0]
        return found

    def motor_rate(self, plate: Array, motor: Array, rate: Array) -> Array:
        """Rates of the cranks in rad/s for those of the plate at its angles; all (..., 2)."""
        by_crank, by_plate, by_other = self._slopes(plate, motor)
        turned = by_plate * rate
        turned[..., 0] += by_other * rate[..., 1]
        return -turned / by_crank

    def _slopes(self, plate: Array, motor: Array) -> tuple[Array, Array, Array]:
        """Derivatives of the rods' squared lengths over -2 a, by crank and plate; phi's by theta.

        With the end of a crank u = d + r cos m outwards and v = h - r sin m below the universal
        joint, a rod's squared length is a^2 + u^2 + v^2 - 2 a (u cos - c v sin).
        """
        r, a, d, h, _ = self._lengths
        c, sine, cosine = _height_share(plate), np.sin(plate), np.cos(plate)
        du, dv = -r * np.sin(motor), -r * np.cos(motor)
        u, v = d - dv, h + du
        by_crank = du * cosine - c * dv * sine - (u * du + v * dv) / a
        return by_crank, -u * sine - c * v * cosine, v[..., 0] * sine[..., 0] * sine[..., 1]

    def problem(self, tilt: float) -> str:
        """The error of one pair of linkages, in one line; empty if there is none.

        Args:
            tilt: Largest tilt of the plate in either direction, rad.
        """
        if not self.given:
            return ""
        if not all(np.all(each) for each in (self.crank, self.rod, self.arm)):
            return "plant.linkage: crank_mm, rod_mm and arm_mm must be above 0 for both axes"
        if np.any(np.abs(self.lean) >= self.rod):
            return (
                f"plant.linkage.rod_mm: crank and arm end {_mm(self.lean)} mm apart horizontally "
                f"at level; must be longer, got {_mm(self.rod)}"
            )
        tilts = np.linspace(0, ANGLE_SPARE_FACTOR * tilt, 111)
        corners = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1)
        plate = tilts[:, None, None, None] * corners
        off = np.abs(self.plate(self.motor(plate)) - plate).max(axis=(1, 2))
        locked = np.flatnonzero(off.max(axis=1) > LOCKING_TOLERANCE)
        if len(locked):
            first = locked[0]
            return (
                f"plant.linkage: {('phi', 'theta')[off[first].argmax()]} locks at "
                f"{np.degrees(tilts[first]):.3g} deg; rig.limits.angle_deg = "
                f"{np.degrees(tilt):.3g} needs {ANGLE_SPARE_FACTOR:g} times that"
            )
        return ""


Rows = tuple[tuple[float, float], ...]
POINTS_PER_ROW = 200
"""Points of a table's curve from one row to the next."""


TABLE_FOLLOWERS = replace(
    LENGTH_FOLLOWERS, mechanism="has cams or rods and no table of tilts", source=GIVEN
)


@dataclass(frozen=True, kw_only=True)
class TiltTable:
    """Plate angles as measured over servo angles, of two axes that do not move each other.

    Between rows the curve is the cubic of Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5, 1984),
    which rises as they do; its slope has no jumps at the rows, unlike a polyline. For both
    directions it is divided finely into straight lines. Beyond the ends servo and plate rest.

    Attributes:
        phi: Measured rows [servo angle, plate angle] of phi in rad, both rising; none for no table.
        theta: The same of theta, in rad.
    """

    phi: Rows = setting(
        "plant.linkage.phi_deg", (), Unit.DEG, type=Rows, followed_by=TABLE_FOLLOWERS
    )
    theta: Rows = setting(
        "plant.linkage.theta_deg", (), Unit.DEG, type=Rows, followed_by=TABLE_FOLLOWERS
    )

    @property
    def given(self) -> bool:
        """Whether there is one at all."""
        return bool(self.phi or self.theta)

    @property
    def ratio(self) -> Array:
        """Servo angle per plate angle at level, dimensionless, shape (2,)."""
        return 1 / self._read(self.motor(np.zeros(2)), 0, 2)

    @cached_property
    def curves(self) -> list[tuple[Array, Array, Array]]:
        """Servo angles in rad, plate angles in rad and slopes of each axis, finely, (n,) each."""
        from scipy.interpolate import PchipInterpolator  # noqa: PLC0415  slow: only for a table

        rows = [np.transpose(each) for each in (self.phi, self.theta)]
        fine = [np.unique(np.linspace(servo[:-1], servo[1:], POINTS_PER_ROW)) for servo, _ in rows]
        there = [PchipInterpolator(*each)(at) for each, at in zip(rows, fine, strict=True)]
        return [(x, y, np.gradient(y, x)) for x, y in zip(fine, there, strict=True)]

    def _read(self, angle: Array, of: int, wanted: int, beyond: float | None = None) -> Array:
        """A column of the curves at angles in a second column; beyond the ends the end's value."""
        each = zip(np.moveaxis(angle, -1, 0), self.curves, strict=True)
        return np.stack([np.interp(a, c[of], c[wanted], beyond, beyond) for a, c in each], axis=-1)

    def motor(self, plate: Array) -> Array:
        """Servo angles in rad that hold plate angles (phi, theta) in rad, both (..., 2)."""
        return self._read(plate, 1, 0)

    def plate(self, motor: Array) -> Array:
        """Plate angles in rad for servo angles in rad, both (..., 2)."""
        return self._read(motor, 0, 1)

    def plate_rate(self, plate: Array, motor: Array, rate: Array) -> Array:
        """Rates of the plate in rad/s for those of the servos at their angles; all (..., 2)."""
        return rate * self._read(motor, 0, 2, beyond=0.0)

    def motor_rate(self, plate: Array, motor: Array, rate: Array) -> Array:
        """Rates of the servos in rad/s for those of the plate at its angles; all (..., 2)."""
        return rate / self._read(motor, 0, 2)

    def problem(self, tilt: float) -> str:
        """The error of the table, in one line; empty if there is none.

        Args:
            tilt: Largest tilt of the plate in either direction, rad.
        """
        if not self.given:
            return ""
        for axis in ("phi", "theta"):
            rows, needed = (
                np.degrees(getattr(self, axis)).round(9),
                ANGLE_SPARE_FACTOR * np.degrees(tilt),
            )
            if len(rows) < 2 or (np.diff(rows, axis=0) <= 0).any():
                what = "2 or more rows of servo and plate angle, both rising"
                return f"plant.linkage.{axis}_deg: must be {what}, got {rows.tolist()}"
            if min(-rows[0, 1], rows[-1, 1]) < needed:
                reach = (
                    f"must tilt by {ANGLE_SPARE_FACTOR:g} rig.limits.angle_deg = {needed:.3g} deg "
                    "either way"
                )
                return f"plant.linkage.{axis}_deg: {reach}, got {rows[0, 1]:g} to {rows[-1, 1]:g}"
        return ""


Transmitting = Linkage | TiltTable
"""Transmissions between servos and plate."""


def _height_share(plate: Array) -> Array:
    """Share of an arm's height that remains where theta tilts it sideways, shape (..., 2)."""
    share = np.ones_like(plate)
    share[..., 0] = np.cos(plate[..., 1])
    return share


def _arccos(cosine: Array) -> Array:
    """The angle; of a linkage that locks the angle at which it does."""
    return np.arccos(np.minimum(np.maximum(cosine, LOCKING_TOLERANCE - 1), 1 - LOCKING_TOLERANCE))


def _mm(pair: Any) -> str:
    return " and ".join(f"{round(1000 * each, 3):g}" for each in pair)
