"""Parts of a mechanism that a rig may have otherwise than the model file says."""

from __future__ import annotations

from dataclasses import dataclass, replace

from twin.settings import Unit, check, jump, ramp, setting


@dataclass(frozen=True, kw_only=True)
class Parts:
    """Numbers of one mechanism, SI units; None leaves what the model file says.

    A mechanism whose balance they change is levelled again, as a rig is after work on it: the
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
        joint_friction: Dry friction of each of the plate's two joints, N m: as wheels and servos
            give way, lost motion between motor and plate.
        plate_centre: Centre of mass of the plate off the cardan joint along x and y, m.
        level: Tilt (phi, theta) of the base that everything stands on, rad; encoders cannot see it.

    Raises:
        ModelError: If a number is out of range.
    """

    mass: float | None = jump("plant.ball.mass", 0.024, otherwise=None, gt=0)
    radius: float | None = setting("plant.ball.radius", 0.02, otherwise=None, ge=0.005, le=0.05)
    inertia: float | None = jump("plant.ball.inertia", 6.4e-6, otherwise=None, gt=0)
    offset: tuple[float, float, float] | None = setting(
        "plant.ball.offset_mm",
        (0.0, 0.0, 0.0),
        Unit.MM,
        otherwise=None,
        exact="have a ball with its centre of mass in the middle",
    )
    oval: float | None = setting(
        "plant.ball.oval_mm", 0.0, Unit.MM, otherwise=None, ge=0, exact="have a round ball"
    )
    sliding: float | None = jump(
        "plant.friction.sliding", 0.5, otherwise=None, gt=0, exact="have a ball that never slides"
    )
    spinning: float | None = jump(
        "plant.friction.spinning_mm",
        0.01,
        Unit.MM,
        otherwise=None,
        ge=0.01,
        le=10,
        exact="have a ball that never spins",
    )
    stiffness: float | None = setting(
        "plant.wheels.stiffness", None, ge=5e3, le=2e6, exact="have no wheels"
    )
    damping_ratio: float | None = setting(
        "plant.wheels.damping_ratio", None, ge=0, le=2, exact="have no wheels"
    )
    preload: float | None = setting(
        "plant.spring.preload", None, ge=1, le=500, exact="have no spring"
    )
    torque: float | None = jump("plant.servo.torque_limit", None, gt=0, exact="have ideal motors")
    speed: float | None = jump("plant.servo.speed_limit", None, gt=0, exact="have ideal motors")
    joint_friction: float | None = setting(
        "plant.plate.joint_friction",
        0.0,
        otherwise=None,
        ge=0,
        le=20,
        exact="have a plate that goes where it is told",
    )
    plate_centre: tuple[float, float] | None = setting(
        "plant.plate.offset_mm",
        None,
        Unit.MM,
        type=tuple[float, float],
        exact="have a plate that goes where it is told",
    )
    level: tuple[float, float] | None = ramp(
        "plant.level_deg", (0.0, 0.0), Unit.DEG, otherwise=None, ge=-5, le=5
    )

    def __post_init__(self) -> None:
        """Check the ranges."""
        check(self)

    @property
    def compiled(self) -> Parts:
        """Those of ball and plate, with which a mechanism has to be compiled."""
        return Parts(
            mass=self.mass,
            radius=self.radius,
            inertia=self.inertia,
            offset=self.offset,
            oval=self.oval,
            plate_centre=self.plate_centre,
        )

    @property
    def balanced(self) -> bool:
        """Whether the mechanism's balance on a level base is that of the file."""
        other = replace(
            self,
            inertia=None,
            offset=None,
            sliding=None,
            spinning=None,
            damping_ratio=None,
            joint_friction=None,
            torque=None,
            speed=None,
            level=None,
        )
        return other == Parts()
