"""`twin.sim.plant.mechanism`.

A plate on rods in MuJoCo against closed forms: its angles, torques, energy and its ball."""

import mujoco
import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.hal.linkage import Linkage
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.model import load_model

LINKAGE = Linkage(crank=(0.04, 0.03), rod=(0.09, 0.1), arm=(0.1, 0.07), distance=(0.05, 0.045))
PARTS = Parts(linkage=LINKAGE, size=(0.3, 0.2))
BESIDE = (0.4, 0.0, 0.0, 0.0)
"""Beside the plate: a ball started there falls off."""


@pytest.fixture(scope="module")
def poses():
    """Plates without a ball, their cranks at a grid of angles, at rest."""
    line = np.radians(np.linspace(-40, 40, 5))
    target = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    plant = Mechanism(rigs=len(target), parts=PARTS)
    plant.start(np.tile(BESIDE, (plant.rigs, 1)))
    plant.advance(target / 0.5, 500)
    plant.advance(np.zeros_like(target), 500)
    return plant


def read_telemetry(plant, name):
    return plant.telemetry()[:, plant.channels.index(name)]


def test_at_rest_the_tilt_is_the_linkages(poses):
    tilt = poses.state[:, 2::4]
    assert np.abs(tilt).max(axis=0) == pytest.approx(np.radians([15, 16]), abs=np.radians(2))
    assert tilt == pytest.approx(LINKAGE.plate(poses.motor), abs=np.radians(0.002))
    assert poses.ratio == pytest.approx(LINKAGE.ratio)


def test_at_rest_the_torque_is_the_slope_of_the_plates_height(poses):
    # weight, and where the plate's middle is over the universal joint
    weight, high, nudge = 0.45 * 9.81, 0.1205, 1e-5

    def energy(motor):
        return weight * high * np.cos(LINKAGE.plate(motor)).prod(axis=-1)

    torques = np.stack(
        [read_telemetry(poses, f"torque_{axis}_Nm") for axis in ("phi", "theta")], axis=-1
    )
    for axis, step in enumerate(nudge * np.eye(2)):
        slope = (energy(poses.motor + step) - energy(poses.motor - step)) / (2 * nudge)
        assert np.abs(slope).max() > 0.03
        assert torques[:, axis] == pytest.approx(slope, abs=2e-4)


def test_its_mass_goes_with_its_area_and_a_larger_plate_of_any_lengths_stands_level():
    model = load_model(parts=Parts(linkage=LINKAGE, size=(0.4, 0.3), level=(0.03, -0.02)))
    x, y, z = 2 * model.geom("plate").size
    assert float(model.body("plate").mass[0]) == pytest.approx(x * y * z * 2500)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    mujoco.mj_forward(model, data)
    hinges = [model.joint(name) for name in ("phi", "theta", "cam_phi", "cam_theta")]
    assert np.abs(data.qpos[[hinge.qposadr[0] for hinge in hinges]]).max() == 0
    assert np.abs(data.qacc[[hinge.dofadr[0] for hinge in hinges]]).max() < 1e-4


def test_without_damping_servos_and_ball_the_energy_stays():
    model = load_model(parts=PARTS, drawn=False)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    model.opt.timestep = 1e-4
    model.dof_damping[:] = 0.0
    model.jnt_range[:] *= 2
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    data.joint("ball").qpos[:3] = 9.0, 0.0, 9.0
    cranks = [model.joint(f"cam_{axis}").dofadr[0] for axis in ("phi", "theta")]
    plate = [model.joint(axis).dofadr[0] for axis in ("phi", "theta")]
    rate = np.array([6.0, -4.0])
    data.qvel[cranks] = rate
    data.qvel[plate] = rate / LINKAGE.ratio
    energy, moved = [], 0.0
    for _ in range(600):
        mujoco.mj_step(model, data)
        ball = model.body("ball").id
        fall = model.body_mass[ball] * (9.81 * data.qpos[6] + data.qvel[6] ** 2 / 2)
        energy.append(data.energy.sum() - fall)
        moved = max(moved, np.abs(data.qpos[plate]).max())
    assert moved > np.radians(5)
    kinetic = 0.5 * rate @ rate * 1e-3
    assert np.ptp(energy) < 0.01 * kinetic


def test_a_ball_of_steel_on_a_small_plate_rolls_down_as_it_should():
    ball = BallPlate(mass=0.01378, radius=0.0075, inertia=3.1e-7)
    parts = Parts(
        linkage=LINKAGE, size=(0.3, 0.2), mass=0.01378, radius=0.0075, inertia=3.1e-7,
        level=(0.02, 0.0),
    )  # fmt: skip
    plant = Mechanism(parts=parts, friction=Friction(rolling=0.0))
    plant.start(np.zeros((1, 4)))
    plant.advance(np.zeros((1, 2)), 500)
    assert plant.state[0, 0] == pytest.approx(ball.k1 * np.sin(0.02) * 0.5**2 / 2, rel=3e-3)


def test_theta_turns_phi_by_what_the_closed_loop_says():
    # of the course rig; docs/your-rig.md has the number
    course = Linkage(crank=(0.04, 0.028), rod=(0.09, 0.09), arm=(0.1, 0.07), distance=(0.06, 0.042))
    ten = np.radians(10)
    crank = course.motor(np.array([ten, 0.0]))[0]
    theta = course.motor(np.array([0.0, ten]))[1]
    tilt = course.plate(np.array([crank, theta]))
    assert np.degrees(tilt) == pytest.approx([10.13, 10.0], abs=0.005)
