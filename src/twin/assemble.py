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
from twin.hal.rig import Transmission
from twin.hal.sensors import EncoderModel, TouchModel
from twin.hal.simulated import Bench, SimulatedRig
from twin.hal.supervisor import Limits
from twin.models import model_path
from twin.plant.exact import ExactPlant
from twin.plant.friction import RollingFriction
from twin.plant.interface import Plant
from twin.plant.mechanism import Mechanism
from twin.scenario.schema import Choice, Scenario, checked_settings, choices


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
    start = scenario.plant.start
    plant.start(np.tile([start.x, start.x_rate, start.y, start.y_rate], (rigs, 1)))
    bench = Bench(
        plant,
        period=period,
        touch=TouchModel(**dict(touch)),
        encoders=EncoderModel(**dict(encoders)),
        disturbance=scenario.disturbance.variance,
        hold=max(1, round(scenario.sensors.noise_hold / period)),
        seed=scenario.seed,
    )
    rig = SimulatedRig(
        bench,
        transmission=transmission,
        limits=build_limits(scenario),
        period=period,
        ideal=scenario.sensors.ideal,
    )
    return Experiment(rig, controller)


def build_plant(
    scenario: Scenario, *, rigs: int = 1, threads: int = 0
) -> tuple[Plant, Transmission]:
    """The plant of a scenario and the transmission that fits it."""
    settings = scenario.plant
    rolling = settings.friction.rolling_mm / 1000
    if settings.kind == "lagrange":
        friction = RollingFriction(arm=rolling) if rolling > 0 else None
        model = BallPlate(**dict(settings.ball))
        return ExactPlant(model, rigs=rigs, step=settings.step, friction=friction), Direct()
    if settings.ball != type(settings.ball)():
        raise ScenarioError("plant.ball: fixed by models/ballplate.xml; set plant.kind=lagrange")
    plant = Mechanism(rigs=rigs, step=settings.step, threads=threads, rolling=rolling)
    table = CamTable.from_file(model_path("cams.json"))
    table.check(model_path())
    return plant, table


def build_limits(scenario: Scenario) -> Limits:
    """The limits of a scenario in SI units."""
    given = scenario.rig.limits
    return Limits(
        angle=radians(given.angle_deg),
        rate=radians(given.rate_deg),
        acceleration=given.acceleration,
        area=given.area,
        margin=given.margin,
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
    reference: Reference = _build("reference", scenario.reference)
    area = np.asarray(scenario.rig.limits.area)
    times = np.linspace(0, scenario.duration, 2001)
    farthest = np.abs(reference(times)[0]).max(axis=0)
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
