"""From a scenario to the objects that run it: plant, rig, controller."""

from __future__ import annotations

from math import radians
from typing import NamedTuple

import numpy as np

from controllers.ballplate import BallPlate
from controllers.interfaces import Law, Observer, Reference
from controllers.smith import Smith
from controllers.stack import Controller
from twin.errors import ScenarioError
from twin.hal.cams import CamTable, Direct
from twin.hal.limits import Limits
from twin.hal.rig import Transmission
from twin.paths import model_path
from twin.scenario.plant import Plant as PlantTables
from twin.scenario.schema import Choice, Scenario, checked_settings, choices
from twin.scenario.schema import Limits as LimitTable
from twin.sim.drives import DriveModel
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Plant
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.parts import Parts
from twin.sim.plant.surface import SurfaceMap
from twin.sim.rig import Bench, SimulatedRig
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission_error import Misjudged


class Experiment(NamedTuple):
    """A rig and the controller to drive it."""

    rig: SimulatedRig
    controller: Controller


def assemble(scenario: Scenario, *, rigs: int = 1, threads: int = 0) -> Experiment:
    """Build a scenario's rig and controller, N rigs side by side that differ in their noise.

    Raises:
        ScenarioError: If the parts do not fit together.
        ModelError: If the mechanism or its cam table cannot be used.
    """
    controller = build_controller(scenario)
    plant, transmission = build_plant(scenario, rigs=rigs, threads=threads)
    period = scenario.rig.period
    touch, encoders = scenario.sensors.touch, scenario.sensors.encoders
    bench = build_bench(
        scenario,
        plant,
        period=period,
        touch=TouchModel(
            dead_time=touch.dead_time,
            spread=touch.dead_time_spread,
            frame_rate=touch.frame_rate,
            grid=touch.grid,
            variance=touch.variance,
            rotation=radians(touch.rotation_deg),
        ),
        encoders=EncoderModel(**dict(encoders)),
    )
    rig = SimulatedRig(
        bench,
        transmission=transmission,
        limits=build_limits(scenario.rig.limits),
        period=period,
        ideal=scenario.sensors.ideal,
    )
    return Experiment(rig, controller)


def build_bench(
    scenario: Scenario, plant: Plant, *, period: float, touch: TouchModel, encoders: EncoderModel
) -> Bench:
    """A scenario's devices around its plant, the plant started; period in s."""
    servo = scenario.plant.servo
    start_plant(plant, scenario)
    hold = max(scenario.sensors.noise_hold, scenario.rig.period)
    return Bench(
        plant,
        period=period,
        touch=touch,
        encoders=encoders,
        drives=DriveModel(bandwidth=servo.bandwidth_hz, backlash=radians(servo.backlash_deg)),
        disturbance=scenario.disturbance.variance,
        hold=round(hold / period),
        seed=scenario.seed,
    )


def start_plant(plant: Plant, scenario: Scenario) -> None:
    """Put the balls where the scenario starts, the plates level."""
    start = scenario.plant.start
    ball = np.tile([start.x, start.x_rate, start.y, start.y_rate], (plant.rigs, 1))
    if isinstance(plant, Mechanism):
        plant.start(ball, start.spin)
    else:
        plant.start(ball)


def build_plant(
    scenario: Scenario, *, rigs: int = 1, threads: int = 0
) -> tuple[Plant, Transmission]:
    """The plant of a scenario and the transmission that the rig believes in.

    Raises:
        ModelError: If the mechanism or its cam table cannot be used.
    """
    settings = scenario.plant
    friction = build_friction(settings)
    plant: Plant
    known: Transmission
    if settings.kind == "lagrange":
        ball = settings.ball
        plant = ExactPlant(
            BallPlate(mass=ball.mass, radius=ball.radius, inertia=ball.inertia),
            rigs=rigs,
            step=settings.step,
            friction=friction,
            level=np.radians(settings.level_deg),
        )
        known = Direct()
    else:
        plant = Mechanism(
            rigs=rigs,
            step=settings.step,
            threads=threads,
            friction=friction or Friction(),
            parts=build_parts(settings),
        )
        known = _cams(scenario.rig.cams, plant.ratio)
    error = np.divide(scenario.rig.cam_error_percent, 100)
    return plant, Misjudged(known, 1 + error) if error.any() else known


def _cams(kind: str, ratio: float) -> Transmission:
    """What the rig knows of its cams."""
    if kind == "ratio":
        return Direct(ratio)
    table = CamTable.from_file(model_path("cams.json"))
    table.check(model_path())
    return table.per_axis() if kind == "per_axis" else table


def build_friction(settings: PlantTables) -> Friction | None:
    """The resistance of ball on screen; None if the screen is level and without friction."""
    given, surface = settings.friction, settings.surface
    patchwork: SurfaceMap | None = None
    if surface.given:
        patchwork = SurfaceMap(
            relative=np.array(surface.relative) if surface.relative else None,
            height=np.array(surface.height_um) * 1e-6 if surface.height_um else None,
        )
    elif surface.drawn:
        patchwork = SurfaceMap.random(
            seed=surface.seed,
            patch=surface.patch_mm / 1000,
            spread=surface.spread_percent / 100,
            slope=radians(surface.slope_deg),
        )
    friction = Friction(
        rolling=given.rolling_mm / 1000,
        breakaway_ratio=given.breakaway_ratio,
        stribeck_speed=given.stribeck_speed,
        dwell_time=given.dwell_time,
        viscous=given.viscous_mm / 1000,
        map=patchwork,
    )
    return None if friction.absent and patchwork is None else friction


def build_parts(settings: PlantTables) -> Parts:
    """What of the mechanism differs from its model file."""
    ball, friction, servo = settings.ball, settings.friction, settings.servo
    nominal = type(ball)()

    def changed(value: float, default: float) -> float | None:
        return None if value == default else value

    centre = settings.plate.offset_mm
    offset = tuple(part / 1000 for part in ball.offset_mm)
    tilt = tuple(radians(angle) for angle in settings.level_deg)
    return Parts(
        mass=changed(ball.mass, nominal.mass),
        radius=changed(ball.radius, nominal.radius),
        inertia=changed(ball.inertia, nominal.inertia),
        offset=(offset[0], offset[1], offset[2]) if any(offset) else None,
        oval=changed(ball.oval_mm / 1000, 0.0),
        sliding=changed(friction.sliding, type(friction)().sliding),
        spinning=changed(friction.spinning_mm / 1000, type(friction)().spinning_mm / 1000),
        stiffness=settings.wheels.stiffness,
        damping_ratio=settings.wheels.damping_ratio,
        preload=settings.spring.preload,
        torque=servo.torque_limit,
        speed=servo.speed_limit,
        plate_centre=(centre[0] / 1000, centre[1] / 1000) if centre is not None else None,
        level=(tilt[0], tilt[1]) if any(tilt) else None,
    )


def build_limits(given: LimitTable) -> Limits:
    """The limits of a scenario or a rig in SI units."""
    return Limits(
        angle=radians(given.angle_deg),
        rate=radians(given.rate_deg),
        acceleration=given.acceleration,
        area=given.area,
        margin=given.margin,
        ball_speed=given.ball_speed,
    )


def build_controller(scenario: Scenario) -> Controller:
    """The controller of a scenario, designed on the nominal model of Table A.2.

    Raises:
        ScenarioError: If a law, observer or reference refuses its settings.
    """
    period = scenario.rig.period
    model = BallPlate()
    law: Law = _build("controller", scenario.controller, model=model)
    observer: Observer = _build("observer", scenario.observer, model=model, period=period)
    if scenario.predictor is not None:
        observer = Smith(
            observer=observer, delay=scenario.predictor.delay, model=model, period=period
        )
    return Controller(law, observer, build_reference(scenario), period)


def build_reference(scenario: Scenario) -> Reference:
    """The reference of a scenario, which must stay within the operating area.

    Raises:
        ScenarioError: If it leaves the area or refuses its settings.
    """
    area = np.asarray(scenario.rig.limits.area)
    times = np.linspace(0, scenario.duration, 2001)
    with np.errstate(over="ignore", invalid="ignore"):
        reference: Reference = _build("reference", scenario.reference)
        motion = reference(times)
    if not np.isfinite(motion).all():
        raise ScenarioError("reference: it or a derivative of it is no finite number at some time")
    farthest = np.abs(motion[0]).max(axis=0)
    if (farthest > area + 1e-9).any():
        raise ScenarioError(
            f"reference: reaches |x|, |y| = {farthest[0]:.3f}, {farthest[1]:.3f} m; "
            f"rig.limits.area allows {area[0]:g}, {area[1]:g} m"
        )
    return reference


def _build(table: str, choice: Choice, **given: object):  # type: ignore[no-untyped-def]
    cls = choices(table)[choice.kind]
    settings = checked_settings(cls, choice.settings)
    try:
        return cls(**settings, **given)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ScenarioError(f"{table}: {error}") from error
