"""Interface of every simulated plant, start of the ball, parts, and kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.arrays import Array, Mask, Number, put
from twin.base.followers import FREE, GIVEN, Followers
from twin.base.settings import Unit, check, jump, ramp, setting
from twin.hal.linkage import Linkage

BallSpin = Literal["free", "locked", "thesis"]
"""The ball's spin about the plate's normal in the exact equations: a state, locked to the plate, or
locked with the equations (5.9) of the thesis; ``twin.sim.plant.exact`` derives them."""


START_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    explain="compares runs with the same start",
    identify="finds where the ball of each window begins",
    symbols="leave the initial state open",
)


@dataclass(frozen=True, kw_only=True)
class BallStart:
    """Where the ball begins on the level plate; fields may be arrays with one entry per rig.

    Attributes:
        x: Position along x in plate axes, m.
        y: Along y, m.
        x_rate: Speed along x, m/s; the ball rolls.
        y_rate: Along y, m/s.
        spin: Rate about the vertical, rad/s.
    """

    x: Number = setting("plant.start.x", 0.0, followed_by=START_FOLLOWERS, ge=-2.5, le=2.5)
    y: Number = setting("plant.start.y", 0.0, followed_by=START_FOLLOWERS, ge=-2.5, le=2.5)
    x_rate: Number = setting("plant.start.x_rate", 0.0, followed_by=START_FOLLOWERS)
    y_rate: Number = setting("plant.start.y_rate", 0.0, followed_by=START_FOLLOWERS)
    spin: Number = setting(
        "plant.start.spin", 0.0, followed_by=START_FOLLOWERS.by("rolling"), ge=-500, le=500
    )

    @property
    def ball(self) -> Array:
        """(x, x', y, y') in m and m/s, shape (4,) or (N, 4)."""
        return np.stack(np.broadcast_arrays(self.x, self.x_rate, self.y, self.y_rate), axis=-1)


class Plant(Protocol):
    """N ball-and-plate mechanisms advanced together; two-vectors are ordered (phi, theta).

    Attributes:
        rigs: Number N of mechanisms.
        step: Physics step in s.
        ratio: Motor angle per plate angle about level, dimensionless; also (2,) or (N, 2).
        channels: Names of the columns of ``telemetry``, each ending in its unit.
    """

    rigs: int
    step: float
    ratio: Number
    channels: tuple[str, ...]

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put every plate level and at rest with its ball at (x, x', y, y'), shape (N, 4).

        Args:
            ball: Positions in m and speeds in m/s of the rolling balls.
            spin: Their rates about the vertical, rad/s; 0 on plants with a ball that cannot spin.
        """

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some rigs to the start as ``start`` does, the others as they are.

        Args:
            rigs: Their numbers, shape (k,).
            ball: (x, x', y, y') of their balls in m and m/s, shape (k, 4).
            spin: Their rates about the vertical, rad/s.
        """

    def place(self, ball: Array) -> None:
        """Put the balls, rolling, at (x, x', y, y') on plates that stay as they are, (N, 4).

        Positions in m, speeds in m/s, in plate axes.
        """

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Hold the motor rates (rad/s, shape (N, 2)) for a number of physics steps."""

    @property
    def state(self) -> Array:
        """True state in the order of (5.5), shape (N, 8), at the present instant."""

    @property
    def motor(self) -> Array:
        """Motor shaft angles in rad, shape (N, 2), as the motor encoders give them."""

    @property
    def on_plate(self) -> Mask:
        """Whether the ball touches the screen's surface area (not fallen off), shape (N,)."""

    @property
    def diverged(self) -> Mask:
        """Whether the numbers have run away at some time since the start, shape (N,)."""

    def telemetry(self) -> Array:
        """Further true quantities for the record, shape (N, channels)."""


class SomeRigs:
    """Some rigs of a plant, that may be looked at and put somewhere; time passes for all alike.

    Args:
        plant: All of them.
        which: Numbers of those, shape (k,).
    """

    def __init__(self, plant: Plant, which: NDArray[np.integer]) -> None:
        self._plant, self._which = plant, which
        self.rigs, self.step, self.ratio = len(which), plant.step, plant.ratio
        self.channels = plant.channels

    def start(self, ball: Array, spin: Number = 0.0) -> None:
        """Put these rigs to the start with their balls at (x, x', y, y'), shape (k, 4)."""
        self._plant.begin(self._which, ball, spin)

    def begin(self, rigs: NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Put some of these to the start."""
        self._plant.begin(self._which[rigs], ball, spin)

    def place(self, ball: Array) -> None:
        """Put these balls at (x, x', y, y') on plates that stay as they are, shape (k, 4)."""
        self._plant.place(put(self._plant.state[:, (0, 1, 4, 5)], self._which, ball))

    def advance(self, motor_rate: Array, steps: int) -> None:
        """Not possible of some rigs alone.

        Raises:
            TypeError: Always.
        """
        raise TypeError("the rigs of a plant are advanced together")

    @property
    def state(self) -> Array:
        """Their true states, shape (k, 8)."""
        return self._plant.state.take(self._which, axis=0)

    @property
    def motor(self) -> Array:
        """Their motor shaft angles in rad, shape (k, 2)."""
        return self._plant.motor.take(self._which, axis=0)

    @property
    def on_plate(self) -> Mask:
        """Whether their balls are on the screen, shape (k,)."""
        return self._plant.on_plate.take(self._which, axis=0)

    @property
    def diverged(self) -> Mask:
        """Whether their numbers have run away, shape (k,)."""
        return self._plant.diverged.take(self._which, axis=0)

    def telemetry(self) -> Array:
        """Their further true quantities, shape (k, channels)."""
        return self._plant.telemetry().take(self._which, axis=0)


BALL_FOLLOWERS = Followers(
    mechanism=GIVEN,
    equations=GIVEN,
    source=FREE,
    explain="keeps the ball, which the design knows unless controller.model differs",
    identify=GIVEN,
    symbols=FREE,
)
HEIGHT_FOLLOWERS = replace(
    BALL_FOLLOWERS, explain="compares runs of one build of the rig", symbols=GIVEN
)
LEVEL_FOLLOWERS = replace(BALL_FOLLOWERS, identify=FREE)
UNEVEN_BALL_FOLLOWERS = replace(
    BALL_FOLLOWERS,
    equations="have a ball with its centre of mass in the middle",
    source="has the exact equations only",
    identify="fits a ball that is round, in balance, and rolls",
    symbols="are the exact equations",
)
OVAL_FOLLOWERS = replace(UNEVEN_BALL_FOLLOWERS, equations="have a round ball")
SLIDING_FOLLOWERS = replace(UNEVEN_BALL_FOLLOWERS, equations="have a ball that never slides")
SPINNING_FOLLOWERS = replace(
    UNEVEN_BALL_FOLLOWERS, equations="have a ball that spins without friction"
)
WHEEL_FOLLOWERS = replace(
    UNEVEN_BALL_FOLLOWERS,
    equations="have no wheels",
    identify="has no measurement that shows it",
    rods="a plate on rods has none",
)
STIFFNESS_FOLLOWERS = replace(WHEEL_FOLLOWERS, explain="compares runs of one build of the rig")
SPRING_FOLLOWERS = replace(WHEEL_FOLLOWERS, equations="have no spring")
PLATE_FOLLOWERS = replace(
    WHEEL_FOLLOWERS, equations="have a plate that follows its command exactly", rods=""
)
PLATE_MASS_FOLLOWERS = replace(PLATE_FOLLOWERS, rods=WHEEL_FOLLOWERS.rods)
MOTOR_FOLLOWERS = replace(PLATE_FOLLOWERS, equations="have ideal motors")


@dataclass(frozen=True, kw_only=True)
class Parts:
    """Numbers of one mechanism, SI units; None leaves the value of the model file.

    If they change its balance, the mechanism is levelled again, as a rig is after work on it: the
    motor shafts are set to the height at which motor angle 0 is plate angle 0.

    Attributes:
        mass: Mass of the ball, kg.
        radius: Its radius, m.
        inertia: Its moment of inertia about its centre of mass, kg m^2.
        offset: Centre of mass of the ball off its middle, (x, y, z) in the ball's own axes, which
            are those of the plate at the start, m.
        oval: By how much one diameter, upright at the start, is shorter than the others, m.
        sliding: Coefficient of sliding friction of ball on screen, dimensionless.
        spinning: Arm of the resistance to spin about the vertical, m.
        stiffness: Stiffness of wheel on cam, N/m.
        damping_ratio: Damping of the plate on its wheels relative to critical, dimensionless.
        preload: Tension of the spring at level, N.
        torque: Largest torque of a motor, N m.
        speed: Largest speed of a motor, rad/s.
        joint_friction: Dry friction of each of the plate's two joints, N m; as wheels and servos
            yield, it causes lost motion between motor and plate.
        height: Height of the surface above the tilt axes, m; the other masses of the plate on
            cams stay in their place.
        plate_centre: Centre of mass of the plate off the cardan joint along x and y, m.
        level: Tilt (phi, theta) of the base that everything stands on, rad; encoders cannot see it.
        linkage: Cranks and rods in place of cams, wheels and spring.
        size: Sides of the plate along x and y, m; its mass goes with its area.
        rounded: Whether it is round, with the first side as its diameter.

    Raises:
        ModelError: If a number is out of range.
    """

    mass: float | None = jump(
        "plant.ball.mass", 0.024, followed_by=BALL_FOLLOWERS, otherwise=None, gt=0
    )
    radius: float | None = setting(
        "plant.ball.radius", 0.02, followed_by=BALL_FOLLOWERS, otherwise=None, ge=0.002, le=0.05
    )
    inertia: float | None = jump(
        "plant.ball.inertia", 6.4e-6, followed_by=BALL_FOLLOWERS, otherwise=None, gt=0
    )
    offset: tuple[float, float, float] | None = setting(
        "plant.ball.offset_mm",
        (0.0, 0.0, 0.0),
        Unit.MM,
        followed_by=UNEVEN_BALL_FOLLOWERS.by("ball"),
        otherwise=None,
    )
    oval: float | None = setting(
        "plant.ball.oval_mm",
        0.0,
        Unit.MM,
        followed_by=OVAL_FOLLOWERS.by("ball"),
        otherwise=None,
        ge=0,
    )
    sliding: float | None = jump(
        "plant.friction.sliding",
        0.5,
        followed_by=SLIDING_FOLLOWERS.by("sliding"),
        otherwise=None,
        gt=0,
    )
    spinning: float | None = jump(
        "plant.friction.spinning_mm",
        0.01,
        Unit.MM,
        followed_by=SPINNING_FOLLOWERS.by("spinning"),
        otherwise=None,
        ge=0.01,
        le=10,
    )
    stiffness: float | None = setting(
        "plant.wheels.stiffness", None, followed_by=STIFFNESS_FOLLOWERS, ge=5e3, le=2e6
    )
    damping_ratio: float | None = setting(
        "plant.wheels.damping_ratio",
        None,
        followed_by=WHEEL_FOLLOWERS.by("vibration", 1.0),
        ge=0,
        le=2,
    )
    preload: float | None = setting(
        "plant.spring.preload",
        None,
        followed_by=SPRING_FOLLOWERS.by("liftoff"),
        ge=1,
        le=500,
    )
    torque: float | None = jump(
        "plant.servo.torque_limit", None, followed_by=MOTOR_FOLLOWERS.by("drive", 1000.0), gt=0
    )
    speed: float | None = jump(
        "plant.servo.speed_limit", None, followed_by=MOTOR_FOLLOWERS.by("drive", 1000.0), gt=0
    )
    joint_friction: float | None = setting(
        "plant.plate.joint_friction",
        0.0,
        followed_by=PLATE_FOLLOWERS.by("joint_friction"),
        otherwise=None,
        ge=0,
        le=20,
    )
    height: float | None = setting(
        "plant.plate.height", 0.122, followed_by=HEIGHT_FOLLOWERS, otherwise=None, ge=0, le=0.5
    )
    plate_centre: tuple[float, float] | None = setting(
        "plant.plate.offset_mm",
        None,
        Unit.MM,
        followed_by=PLATE_MASS_FOLLOWERS.by("mass", (0.0, 0.0)),
        type=tuple[float, float],
    )
    level: tuple[float, float] | None = ramp(
        "plant.level_deg",
        (0.0, 0.0),
        Unit.DEG,
        followed_by=LEVEL_FOLLOWERS.by("level"),
        otherwise=None,
        ge=-5,
        le=5,
    )
    linkage: Linkage | None = None
    size: tuple[float, float] | None = None
    rounded: bool = False

    def __post_init__(self) -> None:
        """Check the ranges."""
        check(self)

    @property
    def compiled(self) -> Parts:
        """Those of ball and plate, with which a mechanism has to be compiled."""
        ball = "mass", "radius", "inertia", "offset", "oval"
        plate = "height", "plate_centre", "linkage", "size", "rounded"
        return Parts(**{name: getattr(self, name) for name in (*ball, *plate)})

    @property
    def balanced(self) -> bool:
        """Whether the mechanism keeps the balance of the file on a level base."""
        shape = self.mass, self.radius, self.oval, self.height, self.size
        weighs = *shape, self.stiffness, self.preload, self.plate_centre, self.linkage
        return all(each is None for each in weighs)


def tilted_gravity(level: ArrayLike, gravity: float) -> Array:
    """Gravity in the axes of a rig that stands tilted, m/s^2, shape (..., 3).

    Args:
        level: Tilt of the base about y and x, (phi, theta) in rad, shape (..., 2), with the signs
            of the plate's own angles: positive phi lowers the +x side, positive theta lifts +y.
        gravity: Its amount in m/s^2.
    """
    angles = np.moveaxis(np.asarray(level, float), -1, 0)
    return np.stack(gravity_in_rig(np.sin(angles), np.cos(angles), gravity), axis=-1)


def gravity_in_rig(sines: Any, cosines: Any, gravity: Any) -> tuple[Any, Any, Any]:
    """The same from sines and cosines of the tilt (phi, theta); also of symbols."""
    (s_phi, s_theta), (c_phi, c_theta) = sines, cosines
    return gravity * s_phi * c_theta, -gravity * s_theta, -gravity * c_phi * c_theta


def from_plate(vector: Array, phi: Array, theta: Array) -> Array:
    """A vector of plate axes in rig axes, R v with R = Rx(theta) Ry(phi), shape (..., 3)."""
    a, b, c = vector[..., 0], vector[..., 1], vector[..., 2]
    x = np.cos(phi) * a + np.sin(phi) * c
    z = np.cos(phi) * c - np.sin(phi) * a
    y = np.cos(theta) * b - np.sin(theta) * z
    return np.stack((x, y, np.sin(theta) * b + np.cos(theta) * z), axis=-1)


def in_own_axes(vector: Array, orientation: Array) -> Array:
    """A vector of rig axes in the axes of a body, shape (N, 3).

    Args:
        vector: Its components in rig axes, shape (N, 3).
        orientation: Unit quaternion (w, x, y, z) of the body, shape (N, 4).
    """
    w, axis = orientation[:, :1], -orientation[:, 1:]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)


class BallsInPlates:
    """Positions and velocities of N balls in plate axes, from poses and rates of the mechanisms.

    Plate axes are those of R = Rx(theta) Ry(phi) (4.5), so the position is R' r, and its rate
    R' (v - w x r) with the plate's angular velocity w = (theta', phi' cos theta, phi' sin theta)
    in world axes. What is calculated stays in arrays of this object, which are of one piece and of
    one shape where they meet: of few rigs numpy takes several times as long for others, and as long
    to make a view of an array as to calculate with it.

    Args:
        rigs: Their number N.
        poses: In an array of poses, shape (N, ...), the places of phi and theta in rad and of the
            ball's centre in world axes from the cardan joint, m, shape (5,).
        rates: In one of rates those of their rates, shape (5,).
    """

    def __init__(self, rigs: int, poses: NDArray[np.integer], rates: NDArray[np.integer]) -> None:
        # angles twice, for position and velocity; the first two components of w and r once more
        # behind the third: slices of them are a cross product
        self._poses, self._rates = (
            poses[[0, 0, 1, 1, 2, 3, 4, 2, 3]],
            rates[[1, 0, 0, 1, 0, 2, 3, 4]],
        )
        pose, rate = np.empty((9, rigs)), np.empty((8, rigs))
        cosines, sines = np.empty((2, 4, rigs))
        state, ball, height = np.empty((8, rigs)), np.empty((3, 2, rigs)), np.empty((2, rigs))
        self._taken = pose, pose[:4], rate
        self._known = (state[2::4], pose[0:4:2]), (state[3::4], rate[1::-1])
        self._turning = rate[1], rate[2], rate[4], rate[1:4], rate[2:5], rate[5:]
        self._centre = pose[4:7], pose[5:8], pose[6:9]
        self._trigonometric = cosines, cosines[2], sines, sines[2]
        self._parts = ball[:, 0], ball[:, 1], ball, height
        self._turns = cosines[:2], cosines[2:], sines[:2], sines[2:], state[0:2], state[4:6]
        self._state, self._height = state, height[0]

    def look(self, pose: Array, rate: Array) -> tuple[Array, Array]:
        """The states for poses and rates in the order of (5.5), and the balls' heights in m.

        Returns:
            Shape (8, N) and (N,), of which the latter is overwritten by the next call.
        """
        poses, angles, rates = self._taken
        poses[...] = pose.take(self._poses, axis=1).T
        rates[...] = rate.take(self._rates, axis=1).T
        for own, given in self._known:
            own[...] = given
        cosines, cosine, sines, sine = self._trigonometric
        np.cos(angles, cosines)
        np.sin(angles, sines)
        about_y, about_z, again, ahead, behind, moved = self._turning
        np.multiply(about_y, cosine, about_y)
        np.multiply(about_z, sine, about_z)
        again[...] = about_y
        # relative to the turning plate, still in world axes
        r, r_behind, r_ahead = self._centre
        position, velocity, (x, y, z), height = self._parts
        position[...] = r
        velocity[...] = moved - ahead * r_ahead + behind * r_behind
        # back by theta, y with z, then by phi, x with z
        cos_phi, cos_theta, sin_phi, sin_theta, along_x, along_y = self._turns
        np.add(cos_theta * y, sin_theta * z, along_y)
        z = cos_theta * z - sin_theta * y
        np.subtract(cos_phi * x, sin_phi * z, along_x)
        np.add(cos_phi * z, sin_phi * x, height)
        return self._state.copy(), self._height


def one_ball_in_plate(
    plate: Sequence[float],
    plate_rate: Sequence[float],
    ball: Sequence[float],
    ball_rate: Sequence[float],
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    """``BallsInPlates`` of one rig in plain numbers: the same to the bit, and several times faster.

    Args:
        plate: Plate angles (phi, theta) in rad.
        plate_rate: Their rates in rad/s.
        ball: Ball centre in world axes from the cardan joint, m.
        ball_rate: Its velocity in world axes, m/s.

    Returns:
        Along each axis of the plate position in m and velocity in m/s.
    """
    # numpy's sine here too: the math module's need not have the same last bits
    angles = np.array(plate)
    (sin_phi, sin_theta), (cos_phi, cos_theta) = np.sin(angles).tolist(), np.cos(angles).tolist()
    phi_rate, theta_rate = plate_rate
    across, along = phi_rate * cos_theta, phi_rate * sin_theta
    (x, y, z), (vx, vy, vz) = ball, ball_rate
    relative = (
        vx - across * z + along * y,
        vy - along * x + theta_rate * z,
        vz - theta_rate * y + across * x,
    )
    found = []
    for x_, y_, z_ in (ball, relative):
        down = cos_theta * z_ - sin_theta * y_
        found.append(
            (
                cos_phi * x_ - sin_phi * down,
                cos_theta * y_ + sin_theta * z_,
                sin_phi * x_ + cos_phi * down,
            )
        )
    along_x, along_y, along_z = zip(*found, strict=True)
    return along_x, along_y, along_z


def rolling_ball(
    plate: Array, plate_rate: Array, ball: Array, height: Array, radius: Array
) -> tuple[Array, Array, Array]:
    """Position, velocity and angular velocity in world axes of balls that roll on the plate.

    Args:
        plate: Plate angles (phi, theta) in rad, shape (2, N).
        plate_rate: Their rates in rad/s, shape (2, N).
        ball: (x, x', y, y') in plate axes, m and m/s, shape (4, N).
        height: Of their centres over the cardan joint, m, shape (N,).
        radius: Of the balls, m, shape (N,).

    Returns:
        Three arrays (N, 3), in m, m/s and rad/s.
    """
    (phi, theta), (phi_rate, theta_rate) = plate, plate_rate
    x, vx, y, vy = ball
    zero = np.zeros_like(height)
    centre = from_plate(np.stack((x, y, height), axis=-1), phi, theta)
    # the plate's own angular velocity
    turn = np.stack((theta_rate, phi_rate * np.cos(theta), phi_rate * np.sin(theta)), axis=-1)
    along = from_plate(np.stack((vx, vy, zero), axis=-1), phi, theta)
    roll = from_plate(np.stack((-vy / radius, vx / radius, zero), axis=-1), phi, theta)
    return centre, along + np.cross(turn, centre), turn + roll
