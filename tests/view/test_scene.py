"""Tests of `twin.view.streams`."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin.hal.linkage import Linkage
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.model import load_model
from twin.view.streams import Scene, rolling_attitude

ANGLE = st.floats(-0.17, 0.17)
MODEL = load_model()
LINKAGE = Linkage(crank=(0.04, 0.03), rod=(0.09, 0.1), arm=(0.1, 0.07), distance=(0.05, 0.045))
RODS = load_model(parts=Parts(linkage=LINKAGE))


def forward(phi, theta, motor_phi, motor_theta):
    """MuJoCo's own kinematics at these joint angles: an independent truth."""
    data = mujoco.MjData(MODEL)
    angles = {"phi": phi, "theta": theta, "cam_phi": motor_phi, "cam_theta": motor_theta}
    for name, angle in angles.items():
        data.qpos[MODEL.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(MODEL, data)
    mujoco.mj_tendon(MODEL, data)
    return data


def poses(phi, theta, motor_phi, motor_theta, x=0.1, y=-0.05):
    scene = Scene(MODEL, "/run/mechanism")
    state = np.array([[x, 0, phi, 0, y, 0, theta, 0.0]])
    turn = np.array([[0, 0, 0, 1.0]])
    return scene, scene.poses(state, np.array([[motor_phi, motor_theta]]), turn)


def chained(found, path, point):
    """A point of an entity in rig axes, through all its parents."""
    point = np.atleast_2d(np.asarray(point, float))
    while path in found:
        pose = found[path]
        point = Rotation.from_quat(pose["quaternion"]).apply(point) + pose["translation"]
        path = path.rpartition("/")[0]
    return point[0]


@given(ANGLE, ANGLE, st.floats(-1, 1), st.floats(-1, 1))
def test_every_drawn_part_lies_where_the_engine_puts_it(phi, theta, motor_phi, motor_theta):
    data = forward(phi, theta, motor_phi, motor_theta)
    scene, found = poses(phi, theta, motor_phi, motor_theta)
    for name, path in (
        ("cam_phi", f"{scene.root}/motor_phi"),
        ("cam_theta", f"{scene.root}/motor_theta"),
        ("cross_phi", f"{scene.root}/cardan"),
        ("wheel_theta_disc", scene.plate),
        ("plate", scene.plate),
    ):
        beside = np.array([0.01, 0.02, 0.03])
        own = MODEL.geom(name).pos + beside
        turn = data.xmat[MODEL.geom(name).bodyid[0]].reshape(3, 3)
        expected = data.geom(name).xpos + turn @ beside
        assert chained(found, path, own) == pytest.approx(expected, abs=1e-9)


@given(ANGLE, ANGLE)
def test_the_spring_hangs_between_its_two_sites(phi, theta):
    data = forward(phi, theta, 0, 0)
    state = np.array([[0, 0, phi, 0, 0, 0, theta, 0.0]])
    ((high, low),) = Scene(MODEL, "/m").lines(state, np.zeros((1, 2)))["/m/spring"]
    assert low == pytest.approx(data.site("spring_base").xpos)
    assert high == pytest.approx(data.site("spring_plate").xpos, abs=1e-9)
    assert np.linalg.norm(high - low) == pytest.approx(data.ten_length[0])


@given(ANGLE, ANGLE)
def test_rods_join_cranks_and_arms(phi, theta):
    state = np.array([[0, 0, phi, 0, 0, 0, theta, 0.0]])
    motor = LINKAGE.motor(state[:, 2::4])
    for axis, ends in enumerate(Scene(RODS, "/m").lines(state, motor).values()):
        assert np.linalg.norm(ends[0, 1] - ends[0, 0]) == pytest.approx(LINKAGE.rod[axis], rel=1e-5)


def test_the_ball_touches_the_tilted_screen():
    scene, found = poses(0.1, -0.08, 0, 0)
    middle = chained(found, scene.ball, [0, 0, 0])
    normal = Rotation.from_euler("XY", [-0.08, 0.1]).apply([0, 0, 1.0])  # (4.5)
    assert middle @ normal == pytest.approx(0.122 + 0.02)


def test_the_drawn_ball_rolls_as_the_simulated_one():
    plant = Mechanism(friction=Friction(rolling=0.0))
    plant.start(np.array([[0.0, 0.2, 0.05, -0.1]]))
    adr = MODEL.joint("ball").qposadr[0]
    path, before = [plant.state[0, 0::4].copy()], plant._qpos[0, adr + 3 : adr + 7].copy()
    for _ in range(300):
        plant.advance(np.zeros((1, 2)), 1)
        path.append(plant.state[0, 0::4].copy())
    w, x, y, z = plant._qpos[0, adr + 3 : adr + 7]
    turn = rolling_attitude(np.array([*before[1:], before[0]]), np.array(path), 0.02)[-1]
    assert abs(turn @ [x, y, z, w]) == pytest.approx(1, abs=1e-3)
