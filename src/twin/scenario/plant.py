"""What a scenario may say of the plant: ball, friction, surface, drives, mechanism."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, WithJsonSchema, model_validator

from controllers.ballplate import BallPlate
from twin.scenario.tables import Section
from twin.settings import settings_of, value_of
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import BallStart
from twin.sim.plant.parts import Parts
from twin.sim.plant.surface import SurfaceModel

SETTINGS = (Friction, SurfaceModel, DriveModel, Parts, BallStart)
"""Dataclasses whose settings are keys of ``plant``."""
PLANTS = ["mujoco", "lagrange"]
"""What ``kind`` may name; ``twin.run.plants.register`` adds to it."""


def _known(kind: str) -> str:
    if kind not in PLANTS:
        raise ValueError(f"must be {' or '.join(map(repr, PLANTS))}, got {kind!r}")
    return kind


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


class BallKeys(Section):
    """The ball; defaults are the thesis's Table A.2, or those of the solid steel ball."""

    kind: Literal["hollow", "steel"] = "hollow"
    """Hollow plastic ball, or a solid steel ball, which sets mass, inertia and friction."""

    @property
    def model(self) -> BallPlate:
        """The exact equations with this ball."""
        return BallPlate(**{name: vars(self)[name] for name in ("mass", "radius", "inertia")})

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        ball: Any = self
        far = 1000 * ball.radius
        most = ball.mass * ball.radius**2
        if sum(part**2 for part in ball.offset_mm) >= far**2:
            return f"plant.ball.offset_mm: must lie within the ball's radius of {far:g} mm"
        if ball.oval_mm >= far:
            return f"plant.ball.oval_mm: must be less than the ball's radius of {far:g} mm"
        if ball.inertia > most:
            return f"plant.ball.inertia: must be at most mass x radius^2 = {most:g} kg m^2"
        return ""


class SurfaceKeys(Section):
    """How friction and level vary over the screen: drawn at random, or grids."""

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        about = vars(self)
        given = {name: about[name] for name in ("relative", "height_um") if about[name]}
        if given and (about["spread_percent"] or about["slope_deg"]):
            return "plant.surface: give either grids or spread_percent and slope_deg, not both"
        shapes = {}
        for name, rows in given.items():
            if min(len(rows), *map(len, rows)) < 2 or len(set(map(len, rows))) > 1:
                return f"plant.surface.{name}: must be 2 or more rows of equally many, 2 or more"
            shapes[name] = f"{len(rows)} x {len(rows[0])}"
        if len(set(shapes.values())) > 1:
            sizes = " and ".join(f"{name} is {shape}" for name, shape in shapes.items())
            return f"plant.surface: grids must be of one size, but {sizes}"
        if any(value < 0 for row in about["relative"] for value in row):
            return "plant.surface.relative: must not be negative"
        return ""


class PlantKeys(Section):
    """What is simulated."""

    kind: Annotated[
        str, AfterValidator(_known), WithJsonSchema({"type": "string", "enum": list(PLANTS)})
    ] = "mujoco"
    """The mechanism in MuJoCo, or the exact equations (5.9)."""
    step: Annotated[float, Field(ge=1e-5, le=1)] = 0.001
    """Time step of the simulation in s; for the mechanism at most 0.002."""

    @model_validator(mode="after")
    def _kind_of_ball(self) -> PlantKeys:
        """Put in what the kind of ball sets and the scenario does not."""
        ball: Any = vars(self)["ball"]
        for name, values in BALLS[ball.kind].items():
            section: Section = vars(self)[name]
            left = {
                key: value for key, value in values.items() if key not in section.model_fields_set
            }
            if left:
                object.__setattr__(self, name, section.model_copy(update=left))
        return self

    def problem(self) -> str:
        """What is wrong with it as a whole, in one line; empty if nothing is."""
        inner: Any = vars(self)
        if self.kind == "lagrange":
            for key, what in MECHANISM_ONLY.items():
                if value_of(self, key) != DEFAULTS[f"plant.{key}"]:
                    return f"plant.{key}: the exact equations {what}; set plant.kind=mujoco"
        mechanism = self.kind == "mujoco"
        if mechanism and self.step > 0.002:
            return f"plant.step: must be at most 0.002 s for the mechanism, got {self.step:g}"
        rolling = inner["friction"].rolling_mm
        if mechanism and 0 < rolling < LEAST_ROLLING_MM:
            return (
                f"plant.friction.rolling_mm: must be 0 or at least {LEAST_ROLLING_MM:g} for the "
                f"mechanism, got {rolling:g}"
            )
        return inner["ball"].problem() or str(inner["surface"].problem())


DEFAULTS = {about.key: about.default for cls in SETTINGS for about in settings_of(cls).values()}
"""What a scenario has of each setting of ``plant`` that it does not give."""
MECHANISM_ONLY = {
    about.key.removeprefix("plant."): about.exact
    for cls in (Parts, BallStart)
    for about in settings_of(cls).values()
    if about.exact
}
"""Keys of ``plant`` that the exact equations cannot follow, and why."""


def without_ball(plant: dict[str, Any], kind: Any) -> None:
    """Take out of the tables of a plant what its kind of ball sets, as a record has it in them."""
    keys = {
        (name, key) for each in BALLS.values() for name, values in each.items() for key in values
    }
    for name, key in keys:
        default = DEFAULTS[f"plant.{name}.{key}"]
        own = plant.get(name, {})
        if own.get(key) == BALLS.get(kind, {}).get(name, {}).get(key, default):
            del own[key]
