"""What the thesis does not say of its rig: one set of parameters for all experiments."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import radians

from twin.thesis.reproduce.noise import BALL, DISTURBANCE, PLATE

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A rig as it might have been; the defaults are what the thesis states, without friction.

    Attributes:
        rolling: Arm of the rolling friction in m.
        breakaway_ratio: Its arm at rest over that of a fast ball.
        stribeck_speed: Speed in m/s at which half of the surplus at rest is gone.
        dwell_time: Seconds in which the surplus builds up at rest.
        viscous: Further arm per speed, m per m/s.
        servo_lag: Time constant in s with which the plate's rate follows its command.
        level: Tilt (phi, theta) in rad of the base that the plate's encoders count from.
        coupling: Share of one axis's command that turns the other, too.
        cam_error: Relative error of the slope of the cam tables.
        offset: How far the ball's centre of mass is off its middle, m (mechanism only).
        oval: By how much one of its diameters is shorter, m (mechanism only).
        waves: Root mean square slope of the screen's unevenness in rad.
        patches: Standard deviation of the logarithm of the friction from place to place.
        surface: Which screen is drawn.
        dead_time: Dead time of the touch screen in s.
        rate: Largest plate rate in rad/s that may be commanded.
        poles: Poles of the Luenberger observer in 1/s.
        epsilon: Width of the sliding mode's sigmoid.
        hold: Control periods for which noise and disturbance are held.
        noise: Factor on the variances of Table B.1; 0 leaves out counts and grid, too.
        dither: Amplitude in rad/s^2 of a vibration of both plate axes.
        dither_frequency: Its frequency in Hz.
    """

    rolling: float = 0.0
    breakaway_ratio: float = 1.0
    stribeck_speed: float = 0.005
    dwell_time: float = 0.0
    viscous: float = 0.0
    servo_lag: float = 0.0
    level: Pair = (0.0, 0.0)
    coupling: float = 0.0
    cam_error: float = 0.0
    offset: float = 0.0
    oval: float = 0.0
    waves: float = 0.0
    patches: float = 0.0
    surface: int = 0
    dead_time: float = field(default=0.042, metadata={"common": True})
    rate: float = field(default=radians(35), metadata={"common": True})
    poles: tuple[float, ...] = field(default=(-8, -10, -14, -16), metadata={"common": True})
    epsilon: float = field(default=0.3, metadata={"common": True})
    hold: int = field(default=1, metadata={"common": True})
    noise: float = field(default=1.0, metadata={"common": True})
    dither: float = 0.0
    dither_frequency: float = field(default=13.0, metadata={"common": True})

    @property
    def common(self) -> tuple[object, ...]:
        """What rigs of one batch must have in common."""
        names = [item.name for item in fields(self) if item.metadata.get("common")]
        return tuple(getattr(self, name) for name in names)

    def variances(self) -> tuple[Pair, Pair, Pair]:
        """Noise of ball and plate and disturbance, scaled."""
        ball, plate, push = (
            (self.noise * first, self.noise * second)
            for first, second in (BALL, PLATE, DISTURBANCE)
        )
        return ball, plate, push
