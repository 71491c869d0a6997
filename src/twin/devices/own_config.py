"""Settings of hardware of one's own: the thresholds that watch over it, and its options."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.devices.common import Ranged, net, range_field


@dataclass(frozen=True, kw_only=True)
class OwnSettings(Ranged):
    """Settings of own hardware of any kind.

    Attributes:
        options: What the class is made with.
        silent: Seconds without a new measurement after which the plate is levelled.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    silent: float = net(0.25, 0.01, 5)


@dataclass(frozen=True, kw_only=True)
class PlateThresholds(OwnSettings):
    """Settings of own servos.

    Attributes:
        plate_lag: Time constant in s with which the plate follows its command; the plate angle of a
            rig without an encoder is computed with it.
        astray_deg: By how much the measured plate may differ from its command, deg.
    """

    plate_lag: float = range_field(0.0, 0, 2)
    astray_deg: float = net(3.0, 0.1, 20)

    @property
    def lost(self) -> float:
        """Plate angle in rad by which commanded and measured plate may differ."""
        return math.radians(self.astray_deg)

    @property
    def late(self) -> float:
        """Longest time in s from a command to the motion of the plate."""
        return 0.1 + 2 * self.plate_lag


@dataclass(frozen=True, kw_only=True)
class BallThresholds(OwnSettings):
    """Settings of an own screen.

    Attributes:
        unseen: Seconds without a ball in the measurements after which it counts as not seen.
        rest: Seconds in which a ball is measured in one and the same place, on a plate tilted by
            more than ``steep_deg``, after which the plate is levelled.
        steep_deg: Tilt on which no ball rests, deg.
    """

    unseen: float = net(0.1, 0, 2)
    rest: float = net(0.5, 0.05, 10)
    steep_deg: float = net(2.0, 0.2, 20)


@dataclass(frozen=True, kw_only=True)
class OwnServosConfig(PlateThresholds):
    """The table ``[drives]`` of a rig file with ``kind = "own"``.

    Attributes:
        backend: File and class, ``my_servos.py:Feetech``.
    """

    keys = "drives."
    backend: str


@dataclass(frozen=True, kw_only=True)
class OwnScreenConfig(BallThresholds):
    """The table ``[touch]`` of a rig file with ``kind = "own"``.

    Attributes:
        backend: File and class, ``my_camera.py:Camera``.
    """

    keys = "touch."
    backend: str


@dataclass(frozen=True, kw_only=True)
class OwnConfig(BallThresholds, PlateThresholds):
    """Settings of own hardware that is servos and screen, the table ``[own]``."""

    keys = "own."
