"""What a scenario may say of the plant: ball, friction, surface, drives, mechanism."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Pair = tuple[NotNegative, NotNegative]
Tilt = Annotated[float, Field(ge=-5, le=5)]
Grid = tuple[tuple[float, ...], ...]

LEAST_ROLLING_MM = 0.01
"""The smallest arm of rolling resistance the engine can simulate, in mm."""

BALLS: dict[str, dict[str, dict[str, float]]] = {
    "hollow": {"ball": {}, "friction": {}},
    "steel": {
        # A solid sphere of 7850 kg/m^3 and the hollow ball's radius: 4/3 pi r^3 rho and 2/5 m r^2.
        "ball": {"mass": 0.263, "inertia": 4.208e-5},
        # Assumed: Appendix E says only that its friction is less. It dents the screen less for its
        # stiffness and more for its weight; a quarter to a third of the hollow ball's is plausible.
        "friction": {"rolling_mm": 0.05},
    },
}
"""What each kind of ball sets where a scenario does not."""


class Section(BaseModel):
    """A table of a scenario: unknown keys, wrong types and non-finite numbers are refused."""

    model_config = STRICT


class Ball(Section):
    """The ball; defaults are the thesis's Table A.2, or those of the solid steel ball.

    ``offset_mm``: centre of mass off the middle, (x, y, z) as the ball lies at the start.
    ``oval_mm``: by how much its upright diameter is shorter than the others.
    """

    kind: Literal["hollow", "steel"] = "hollow"
    mass: Positive = 0.024
    radius: Annotated[float, Field(ge=0.005, le=0.05)] = 0.02
    inertia: Positive = 6.4e-6
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    oval_mm: NotNegative = 0.0

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        far = 1000 * self.radius
        most = self.mass * self.radius**2
        if sum(part**2 for part in self.offset_mm) >= far**2:
            return f"plant.ball.offset_mm: must lie within the ball's radius of {far:g} mm"
        if self.oval_mm >= far:
            return f"plant.ball.oval_mm: must be less than the ball's radius of {far:g} mm"
        if self.inertia > most:
            return f"plant.ball.inertia: must be at most mass x radius^2 = {most:g} kg m^2"
        return ""


class Friction(Section):
    """Resistance of ball on screen; all of rolling_mm, viscous_mm 0 for frictionless rolling.

    ``rolling_mm``: arm of steady rolling. ``breakaway_ratio``: arm after long rest over it, lost
    about ``stribeck_speed`` (m/s), regained at rest with ``dwell_time`` (s). ``viscous_mm``:
    further arm at 1 m/s. ``sliding``: coefficient of sliding friction. ``spinning_mm``: arm of the
    resistance to spin about the vertical.
    """

    rolling_mm: Annotated[float, Field(ge=0, le=10)] = 0.18
    breakaway_ratio: Annotated[float, Field(ge=1, le=20)] = 1.0
    stribeck_speed: Annotated[float, Field(ge=1e-4, le=10)] = 0.005
    dwell_time: NotNegative = 0.0
    viscous_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    sliding: Positive = 0.5
    spinning_mm: Annotated[float, Field(ge=0.01, le=10)] = 0.01


class Surface(Section):
    """How friction and level vary over the screen: drawn at random, or grids from edge to edge.

    ``spread_percent``: standard deviation of the friction; ``slope_deg``: root mean square of the
    local slope; both change over about ``patch_mm``, as the number ``seed`` draws them.
    ``relative``: friction relative to rolling_mm; ``height_um``: height. Rows go along x, columns
    along y, both from the negative edge to the positive one.
    """

    spread_percent: Annotated[float, Field(ge=0, le=100)] = 0.0
    slope_deg: Annotated[float, Field(ge=0, le=2)] = 0.0
    patch_mm: Annotated[float, Field(ge=5, le=300)] = 50.0
    seed: Annotated[int, Field(ge=0)] = 0
    relative: Grid = ()
    height_um: Grid = ()

    @property
    def given(self) -> bool:
        """Whether grids are given."""
        return bool(self.relative or self.height_um)

    @property
    def drawn(self) -> bool:
        """Whether the surface is drawn at random."""
        return self.spread_percent > 0 or self.slope_deg > 0

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        if self.given and self.drawn:
            return "plant.surface: give either grids or spread_percent and slope_deg, not both"
        shapes = {}
        for name in ("relative", "height_um"):
            rows = getattr(self, name)
            if rows and (min(len(rows), *map(len, rows)) < 2 or len(set(map(len, rows))) > 1):
                return f"plant.surface.{name}: must be 2 or more rows of equally many, 2 or more"
            if rows:
                shapes[name] = f"{len(rows)} x {len(rows[0])}"
        if len(set(shapes.values())) > 1:
            sizes = " and ".join(f"{name} is {shape}" for name, shape in shapes.items())
            return f"plant.surface: grids must be of one size, but {sizes}"
        if any(value < 0 for row in self.relative for value in row):
            return "plant.surface.relative: must not be negative"
        return ""


class Servo(Section):
    """The drives. Without a number: as in the model file (for the exact equations: ideal).

    ``bandwidth_hz``: corner of a first-order lag of the speed loop, 0 for none. ``backlash_deg``:
    play, in degrees of plate angle. ``speed_limit``, ``torque_limit``: of a motor, rad/s and N m.
    """

    bandwidth_hz: Annotated[float, Field(ge=0, le=1000)] = 0.0
    backlash_deg: Annotated[float, Field(ge=0, le=5)] = 0.0
    speed_limit: Positive | None = None
    torque_limit: Positive | None = None


class Wheels(Section):
    """Contact of the follower wheels with their cams, in which the plate rings on its spring.

    Without a number: as in the model file, 80,000 N/m and 0.08. ``damping_ratio`` 1: no ringing.
    """

    stiffness: Annotated[float, Field(ge=5e3, le=2e6)] | None = None
    damping_ratio: Annotated[float, Field(ge=0, le=2)] | None = None


class Spring(Section):
    """The spring that holds the wheels on their cams; without a number 90 N at level.

    At a low ``preload`` (N) a wheel lifts off its cam when the plate is moved briskly.
    """

    preload: Annotated[float, Field(ge=1, le=500)] | None = None


class Plate(Section):
    """The plate: its centre of mass off the joint along x and y; without numbers (4, -3) mm."""

    offset_mm: tuple[float, float] | None = None


class Start(Section):
    """Where the ball begins on the level plate: m and m/s in plate axes, spin in rad/s."""

    x: Annotated[float, Field(ge=-0.35, le=0.35)] = 0.0
    y: Annotated[float, Field(ge=-0.1975, le=0.1975)] = 0.0
    x_rate: float = 0.0
    y_rate: float = 0.0
    spin: Annotated[float, Field(ge=-500, le=500)] = 0.0


class Plant(Section):
    """What is simulated: the mechanism in MuJoCo, or the exact equations (5.9).

    ``level_deg``: tilt (phi, theta) of the base the rig stands on, which its encoders cannot see.
    """

    kind: Literal["mujoco", "lagrange"] = "mujoco"
    step: Annotated[float, Field(ge=1e-5, le=1)] = 0.001
    level_deg: tuple[Tilt, Tilt] = (0.0, 0.0)
    ball: Ball = Ball()
    friction: Friction = Friction()
    surface: Surface = Surface()
    servo: Servo = Servo()
    wheels: Wheels = Wheels()
    spring: Spring = Spring()
    plate: Plate = Plate()
    start: Start = Start()

    @model_validator(mode="after")
    def _kind_of_ball(self) -> Plant:
        """Put in what the kind of ball sets and the scenario does not."""
        for table, values in BALLS[self.ball.kind].items():
            section: Section = getattr(self, table)
            left = {
                key: value for key, value in values.items() if key not in section.model_fields_set
            }
            if left:
                object.__setattr__(self, table, section.model_copy(update=left))
        return self

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        if self.kind == "lagrange":
            for key, what in MECHANISM_ONLY.items():
                table, _, name = key.rpartition(".")
                section: Section = getattr(self, table)
                if getattr(section, name) != type(section).model_fields[name].default:
                    return f"plant.{key}: the exact equations {what}; set plant.kind=mujoco"
        elif self.step > 0.002:
            return f"plant.step: must be at most 0.002 s for the mechanism, got {self.step:g}"
        elif 0 < self.friction.rolling_mm < LEAST_ROLLING_MM:
            return (
                f"plant.friction.rolling_mm: must be 0 or at least {LEAST_ROLLING_MM:g} for the "
                f"mechanism, got {self.friction.rolling_mm:g}"
            )
        return self.ball.problem() or self.surface.problem()


MECHANISM_ONLY = {
    "ball.offset_mm": "have a ball with its centre of mass in the middle",
    "ball.oval_mm": "have a round ball",
    "friction.sliding": "have a ball that never slides",
    "friction.spinning_mm": "have a ball that never spins",
    "start.spin": "have a ball that never spins",
    "servo.speed_limit": "have ideal motors",
    "servo.torque_limit": "have ideal motors",
    "wheels.stiffness": "have no wheels",
    "wheels.damping_ratio": "have no wheels",
    "spring.preload": "have no spring",
    "plate.offset_mm": "have a plate that goes where it is told",
}
"""Keys of ``plant`` that the exact equations cannot follow, and why."""
