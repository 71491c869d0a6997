"""How the ball holds still and rolls true on the screen, from the model file alone."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.paths import model_path

BALL = BallPlate()
LEVER = 0.2e-3
"""Rolling friction of these tests in m, unless a test says otherwise."""


def mechanism(rolling=LEVER):
    """The model file with only its documented setting changed: rolling friction in m, or None."""
    spec = mujoco.MjSpec.from_file(str(model_path()))
    pair = spec.pair("ball_plate")
    if rolling is None:
        pair.condim = 3
    else:
        pair.friction[3:5] = rolling
    return spec.compile()


def lay_ball(model, data, x=0.0):
    """Put the ball on (x, 0) of the plate as it stands and moves, at rest relative to it."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    height = model.key("level").qpos[model.joint("ball").qposadr[0] + 2]
    plate = data.site("plate_frame").xmat.reshape(3, 3)
    centre = plate @ (x, 0, height)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jac(model, data, jacobian[:3], jacobian[3:], centre, model.body("plate").id)
    data.joint("ball").qpos = [*centre, 1, 0, 0, 0]
    data.joint("ball").qvel = jacobian @ data.qvel


def drive(model, data, rate, seconds, hold=None):
    """Run under motor speeds rate(t), the ball held at (hold, 0) until the end if given.

    Returns x, x', y, y' of the ball and phi, phi', theta, theta' of the plate at every step.
    """
    names = ("phi", "phi_rate", "theta", "theta_rate")
    rows = np.empty((round(seconds / model.opt.timestep) + 1, 8))
    for k, row in enumerate(rows):
        if hold is not None:
            lay_ball(model, data, hold)
        mujoco.mj_step1(model, data)
        row[0:3:2] = data.sensor("ball_position").data[:2]
        row[1:4:2] = data.sensor("ball_velocity").data[:2]
        row[4:] = [data.sensor(name).data[0] for name in names]
        if k < len(rows) - 1:
            data.ctrl[:] = rate(k * model.opt.timestep)
            mujoco.mj_step2(model, data)
    return rows


def rest(_t):
    return 0.0, 0.0


def tilted(model, phi, theta=0.0, x=0.0):
    """A plate brought to rest at a slope by its motors, with the ball laid at rest on (x, 0)."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)

    def to_slope(_t):
        error = np.array([phi, theta]) - (data.joint("phi").qpos[0], data.joint("theta").qpos[0])
        return np.clip(25 * error, -0.3, 0.3)

    drive(model, data, to_slope, 3.0, hold=x)
    return data


@pytest.mark.long
@pytest.mark.parametrize(("phi", "theta"), [(0.3, 0.0), (0.5, 0.0), (0.0, -0.5), (-0.3, 0.4)])
def test_a_ball_below_its_breakaway_slope_creeps_less_than_a_micrometre(phi, theta):
    model = mechanism()
    rows = drive(model, tilted(model, math.radians(phi), math.radians(theta)), rest, 2.0)
    assert np.degrees(rows[:, [4, 6]]) == pytest.approx(np.tile([phi, theta], (2001, 1)), abs=2e-3)
    assert np.abs(rows[:, [0, 2]] - rows[0, [0, 2]]).max() < 1e-6


def exact_path(rows, step):
    """Ball of the exact model (5.9) on the plate motion of the rows, from the ball's first row.

    Runge-Kutta over two samples at a time, so that no plate angle is interpolated.
    """
    plate = rows[:, 4:]
    acceleration = np.gradient(plate[:, 1::2], step, axis=0)

    def ball_rate(ball, k):
        state = np.array([*ball[:2], *plate[k, :2], *ball[2:], *plate[k, 2:]])
        return BALL.derivative(state, acceleration[k])[[0, 1, 4, 5]]

    path = [rows[0, :4]]
    for k in range(0, len(rows) - 2, 2):
        ball, h = path[-1], 2 * step
        k1 = ball_rate(ball, k)
        k2 = ball_rate(ball + h / 2 * k1, k + 1)
        k3 = ball_rate(ball + h / 2 * k2, k + 1)
        k4 = ball_rate(ball + h * k3, k + 2)
        path.append(ball + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(path)


def test_a_ball_on_the_moving_plate_follows_the_exact_model():
    model = mechanism(rolling=None)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    omega = math.pi * np.array([1.0, 1.3])

    def motor_speed(t):
        # plate angles 2 deg sin^3, 0.5 Hz and faster: smooth from rest
        wave = 3 * np.sin(omega * t) ** 2 * np.cos(omega * t)
        return 5 * math.radians(2) * omega * wave

    rows = drive(model, data, motor_speed, 2.0)
    assert np.ptp(np.degrees(rows[:, [4, 6]]), axis=0) == pytest.approx([4, 4], abs=0.4)
    path = exact_path(rows, model.opt.timestep)
    assert np.abs(rows[::2, [0, 2]] - path[:, [0, 2]]).max() < 1e-4
