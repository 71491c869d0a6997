"""Modes of operation of a drive by CiA 402-2: targets in, demanded motion and status bits out.

Positions are counts, velocities counts/s, ramps counts/s^2, all as the drive's user sees them.
Not emulated: changing on the set-point (bit 9 of the control word), torque modes, jerk limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

HALT, NEW_SET_POINT, AT_ONCE, RELATIVE = 1 << 8, 1 << 4, 1 << 5, 1 << 6
"""Bits of the control word."""
TARGET_REACHED, LIMIT_ACTIVE, MODE_BIT_12, MODE_BIT_13 = 1 << 10, 1 << 11, 1 << 12, 1 << 13
"""Bits of the status word; bits 12 and 13 mean something else in each mode."""
NO_WINDOW = 0xFFFFFFFF
"""Value of a window that switches its supervision off."""


class Mode(IntEnum):
    """Modes of operation (6060h)."""

    NONE = 0
    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    HOMING = 6
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9


VELOCITY_MODES = frozenset({Mode.PROFILE_VELOCITY, Mode.CYCLIC_VELOCITY})
"""Modes in which the drive controls no position."""


class Motion(NamedTuple):
    """A demanded motion.

    Attributes:
        position: Counts.
        velocity: Counts/s.
        acceleration: Counts/s^2.
    """

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


class Piece(NamedTuple):
    """A part of a profile with constant acceleration.

    Attributes:
        duration: Time in s.
        acceleration: Counts/s^2.
    """

    duration: float
    acceleration: float


class Profile(NamedTuple):
    """How to move to a position.

    Attributes:
        speed: Highest speed, counts/s.
        acceleration: Counts/s^2 with which the speed grows.
        deceleration: Counts/s^2 with which it falls.
    """

    speed: float
    acceleration: float
    deceleration: float


def plan_profile(start: Motion, goal: float, profile: Profile) -> list[Piece]:
    """The trapezoid of velocity from a motion to rest at a goal.

    With the speed v0 towards the goal at a distance s, the peak speed w follows from
    s = (w^2 - v0^2) / (2 a) + w^2 / (2 d). A motion that cannot stop before the goal, or goes away
    from it, stops first.

    Args:
        start: The present motion.
        goal: Where to end, counts.
        profile: Speed and ramps, all positive.
    """
    pieces = []
    position, velocity = start.position, start.velocity
    acceleration, deceleration = profile.acceleration, profile.deceleration
    stop = position + velocity * abs(velocity) / (2 * deceleration)
    sign = math.copysign(1.0, goal - stop)
    if velocity * sign < 0:
        pieces.append(Piece(abs(velocity) / deceleration, sign * deceleration))
        position, velocity = stop, 0.0
    distance, speed = sign * (goal - position), abs(velocity)
    if speed > profile.speed:
        pieces.append(Piece((speed - profile.speed) / deceleration, -sign * deceleration))
        distance -= (speed**2 - profile.speed**2) / (2 * deceleration)
        speed = profile.speed
    square = (2 * acceleration * deceleration * distance + deceleration * speed**2) / (
        acceleration + deceleration
    )
    peak = min(profile.speed, math.sqrt(max(0.0, square)))
    if peak > speed:
        pieces.append(Piece((peak - speed) / acceleration, sign * acceleration))
        distance -= (peak**2 - speed**2) / (2 * acceleration)
    else:
        peak = speed
    if peak > 0:
        cruise = max(0.0, (distance - peak**2 / (2 * deceleration)) / peak)
        pieces += [Piece(cruise, 0.0), Piece(peak / deceleration, -sign * deceleration)]
    return pieces


def move_along(start: Motion, pieces: list[Piece], time: float) -> Motion:
    """The motion a time in s after the start of a profile; at rest after its end."""
    position, velocity = start.position, start.velocity
    for duration, acceleration in pieces:
        step = min(time, duration)
        position += velocity * step + acceleration * step**2 / 2
        velocity += acceleration * step
        time -= step
        if time <= 0:
            return Motion(position, velocity, acceleration)
    return Motion(position)


def ramp_velocity(motion: Motion, target: float, ramp: float, dt: float) -> Motion:
    """The motion a time dt in s later, with the velocity on a ramp in counts/s^2 to a target."""
    change = target - motion.velocity
    duration = min(dt, abs(change) / ramp)
    acceleration = math.copysign(ramp, change) if change else 0.0
    velocity = motion.velocity + acceleration * duration
    position = motion.position + (motion.velocity + velocity) / 2 * duration
    if duration < dt:
        velocity = target
        position += target * (dt - duration)
    return Motion(position, velocity, acceleration if duration == dt else 0.0)


class SetPoint(NamedTuple):
    """A position to move to.

    Attributes:
        goal: Counts.
        profile: How, as 6081h, 6083h and 6084h were when the set-point was accepted.
    """

    goal: float
    profile: Profile


class Window:
    """Supervision of a value that must stay within a window for a time."""

    def __init__(self) -> None:
        self._inside = 0.0

    def reset(self) -> None:
        """Begin again."""
        self._inside = 0.0

    def inside(self, deviation: float, window: float, time_ms: float, dt: float) -> bool:
        """Whether a deviation has been within the window for long enough after dt further s."""
        if abs(deviation) > window:
            self._inside = 0.0
            return False
        self._inside += dt
        return self._inside >= time_ms / 1e3 - 1e-9


class ModesOfOperation:
    """Demanded motion in each mode of operation.

    Args:
        get: Value of an object by index and subindex.
        home: Called with a position in counts that the present place gets.
    """

    def __init__(self, get: Callable[[int, int], int], home: Callable[[float], None]) -> None:
        self._get, self._home = get, home
        self.mode = Mode.NONE
        """Mode of operation in force (6061h)."""
        self.demand = Motion(0.0)
        """Demanded motion."""
        self.homed = False
        """Whether homing has been completed since power-up."""
        self._homing_failed = False
        self._word = 0
        self._reached, self._still = Window(), Window()
        self._is_reached, self._is_still = False, True
        self.follow(Motion(0.0))

    def follow(self, actual: Motion) -> None:
        """Let the demand be the actual motion, as without power; set-points are forgotten."""
        self.demand = Motion(actual.position, actual.velocity)
        self._hold(actual.position)

    def enter(self, mode: Mode) -> None:
        """Change the mode of operation; a motion under way ends on the ramp of the new mode."""
        if mode is not self.mode:
            self.mode = mode
            self._hold(self.demand.position)

    def shift(self, counts: float) -> None:
        """Let all positions be greater by some counts, as after homing or a counter's overflow."""
        self.demand = self.demand._replace(position=self.demand.position + counts)
        self._hold(self.demand.position)

    def anchor(self, position: float) -> None:
        """Let the demand have the actual position in counts, where only the velocity counts."""
        self.demand = self.demand._replace(position=position)

    def abandon(self) -> None:
        """Forget the set-points, as at a quick stop; the demand goes on from where it is."""
        self._hold(self.demand.position)

    def _hold(self, position: float) -> None:
        """Forget set-points; the target is a position."""
        self._target = SetPoint(position, self._profile())
        self._moving = False
        self._waiting: SetPoint | None = None
        self._acknowledged = self._limited = False
        self._start, self._pieces, self._elapsed = self.demand, list[Piece](), 0.0
        self._goal, self._left = position, 0.0
        self._reached.reset()

    def _profile(self) -> Profile:
        speed = min(self._get(0x6081, 0), self._get(0x607F, 0))
        return Profile(max(1, speed), self._ramp(0x6083), self._ramp(0x6084))

    def _ramp(self, index: int) -> float:
        return float(max(1, self._get(index, 0)))

    def set_control(self, word: int, *, enabled: bool) -> None:
        """Take a control word: set-points, start of homing, halt.

        Args:
            word: The control word.
            enabled: Whether the drive is in operation enabled.
        """
        rising = word & ~self._word & NEW_SET_POINT and enabled
        released = self._word & ~word & HALT
        self._word = word
        if self.mode is Mode.PROFILE_POSITION:
            if rising and not self._acknowledged:
                self._accept(word)
            if released and self._moving:
                self._begin(self._target)
            self._release()
        elif self.mode is Mode.HOMING and rising:
            self._start_homing()

    def _accept(self, word: int) -> None:
        """Accept a new set-point: at once, or after the one under way."""
        goal = float(self._get(0x607A, 0))
        if word & RELATIVE:
            goal += (self._waiting or self._target).goal
        low, high = self._get(0x607D, 1), self._get(0x607D, 2)
        self._limited = not low <= goal <= high
        point = SetPoint(max(low, min(high, goal)), self._profile())
        self._acknowledged = True
        self._is_reached = False
        if word & AT_ONCE or not self._moving:
            self._waiting = None
            self._begin(point)
        else:
            self._waiting = point

    def _begin(self, point: SetPoint) -> None:
        self._target, self._moving = point, True
        self._start, self._elapsed = self.demand, 0.0
        self._pieces = plan_profile(self.demand, *point)
        self._reached.reset()

    def _release(self) -> None:
        """Take the acknowledgement back once a further set-point can be accepted."""
        if not self._word & NEW_SET_POINT and self._waiting is None:
            self._acknowledged = False

    def _start_homing(self) -> None:
        """Methods 35 and 37: the present place gets the position of the home offset (607Ch)."""
        self._homing_failed = not self._is_still
        self.homed = self._is_still
        if self.homed:
            offset = float(self._get(0x607C, 0))
            self._home(offset)
            self.follow(Motion(offset))

    def set_target(self, index: int) -> None:
        """Take a target that was written: 607Ah is the next point in cyclic position mode."""
        if index == 0x607A and self.mode is Mode.CYCLIC_POSITION:
            self._goal = float(self._get(0x607A, 0))
            self._left = self._get(0x60C2, 1) * 10.0 ** self._get(0x60C2, 2)

    @property
    def halted(self) -> bool:
        """Whether the halt bit is set."""
        return bool(self._word & HALT)

    def step(self, dt: float) -> None:
        """Let the demand of an enabled drive move on by a time in s."""
        if self.halted:
            self.brake(self._ramp(0x6085 if self._get(0x605D, 0) == 2 else 0x6084), dt)
            return
        match self.mode:
            case Mode.PROFILE_POSITION if self._moving:
                self._follow_profile(dt)
            case Mode.PROFILE_VELOCITY:
                self._ramp_to_target(dt)
            case Mode.CYCLIC_POSITION:
                self._interpolate(dt)
            case Mode.CYCLIC_VELOCITY:
                velocity = self._limit(self._get(0x60FF, 0))
                self.demand = Motion(self.demand.position + velocity * dt, velocity)
            case _:
                self.brake(self._ramp(0x6084), dt)
                self._target = self._target._replace(goal=self.demand.position)

    def brake(self, ramp: float, dt: float) -> None:
        """Let the demand come to rest on a ramp in counts/s^2."""
        self.demand = ramp_velocity(self.demand, 0.0, ramp, dt)

    def _follow_profile(self, dt: float) -> None:
        self._elapsed += dt
        self.demand = move_along(self._start, self._pieces, self._elapsed)
        if self._elapsed < sum(each.duration for each in self._pieces):
            return
        self.demand = Motion(self._target.goal)
        self._moving = False
        if self._waiting is not None:
            point, self._waiting = self._waiting, None
            self._begin(point)
            self._release()

    def _ramp_to_target(self, dt: float) -> None:
        target, now = self._limit(self._get(0x60FF, 0)), self.demand.velocity
        faster = abs(target) > abs(now) and target * now >= 0
        ramp = self._ramp(0x6083 if faster else 0x6084)
        self.demand = ramp_velocity(self.demand, target, ramp, dt)

    def _interpolate(self, dt: float) -> None:
        """Move on the straight line to the newest point, where it is after its period (60C2h)."""
        position, remaining = self.demand.position, self._goal - self.demand.position
        if self._left <= 0 and not remaining:
            self.demand = Motion(position)
            return
        velocity = self._limit(remaining / max(self._left, dt))
        self._left -= dt
        self.demand = Motion(position + velocity * dt, velocity)
        if abs(self._goal - self.demand.position) < 1e-6:
            self.demand = Motion(self._goal, velocity)

    def _limit(self, velocity: float) -> float:
        """A velocity within 607Fh; the status word reports where it was not."""
        most = self._get(0x607F, 0)
        self._limited = abs(velocity) > most
        return float(max(-most, min(most, velocity)))

    def look(self, actual: Motion, dt: float) -> None:
        """Compare with the actual motion after a step of dt s."""
        get, speed = self._get, actual.velocity
        self._is_still = self._still.inside(speed, get(0x606F, 0), get(0x6070, 0), dt)
        if self.mode is Mode.PROFILE_VELOCITY:
            deviation, window, time = speed - get(0x60FF, 0), get(0x606D, 0), get(0x606E, 0)
        else:
            deviation = actual.position - self._target.goal
            window, time = get(0x6067, 0), get(0x6068, 0)
        inside = self._reached.inside(deviation, window, time, dt) or window == NO_WINDOW
        self._is_reached = inside and not self._moving

    @property
    def status(self) -> int:
        """Bits 10 to 13 of the status word, apart from a following error."""
        bits = LIMIT_ACTIVE * self._limited
        if self.mode is Mode.HOMING:
            bits |= TARGET_REACHED * self._is_still | MODE_BIT_12 * self.homed
            return bits | MODE_BIT_13 * self._homing_failed
        if self.halted:
            bits |= TARGET_REACHED * self._is_still
        elif self.mode in {Mode.PROFILE_POSITION, Mode.PROFILE_VELOCITY}:
            bits |= TARGET_REACHED * self._is_reached
        match self.mode:
            case Mode.PROFILE_POSITION:
                bits |= MODE_BIT_12 * self._acknowledged
            case Mode.PROFILE_VELOCITY:
                bits |= MODE_BIT_12 * self._is_still
            case Mode.CYCLIC_POSITION | Mode.CYCLIC_VELOCITY:
                bits |= 0 if self.halted else MODE_BIT_12
        return bits
