"""How the ball holds still and rolls true on the screen, from the model file alone."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.paths import model_path

BALL = BallPlate()


def mechanism():
    """The model file with only its documented setting changed: no rolling friction."""
    spec = mujoco.MjSpec.from_file(str(model_path()))
    spec.pair("ball_plate").condim = 3
    return spec.compile()


def drive(model, data, rate, seconds):
    """Run under motor speeds rate(t).

    Returns x, x', y, y' of the ball and phi, phi', theta, theta' of the plate at every step.
    """
    names = ("phi", "phi_rate", "theta", "theta_rate")
    rows = np.empty((round(seconds / model.opt.timestep) + 1, 8))
    for k, row in enumerate(rows):
        mujoco.mj_step1(model, data)
        row[0:3:2] = data.sensor("ball_position").data[:2]
        row[1:4:2] = data.sensor("ball_velocity").data[:2]
        row[4:] = [data.sensor(name).data[0] for name in names]
        if k < len(rows) - 1:
            data.ctrl[:] = rate(k * model.opt.timestep)
            mujoco.mj_step2(model, data)
    return rows


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
    model = mechanism()
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
