"""How a mechanism comes to stand level and at rest, with other parts and on a tilted base."""

from __future__ import annotations

import mujoco
import numpy as np

from controllers.arrays import Array
from twin.errors import ModelError

AXES = ("phi", "theta")

_UNSEEN = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
"""Nobody looks while a mechanism comes to rest."""

_NEVER_LEVEL = "mechanism: these parts do not come to rest level"

_NUDGE = 1e-6
"""By how much unknowns of the balance are varied for its derivatives, m and rad."""
_LEAST = 1e-10
"""Newton steps of the balance smaller than this are the last, m and rad."""


def put_level(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Put a mechanism to its keyframe, everything worked out."""
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    mujoco.mj_forward(model, data)


def settle(model: mujoco.MjModel, data: mujoco.MjData, time: float = 0.1, rounds: int = 4) -> None:
    """Set the shafts' heights and the servos' set points so that all angles are 0 at rest.

    The mechanism is left to come to rest, wherever that is, and its shafts are moved by what it is
    off; again and again.

    Raises:
        ModelError: If the mechanism does not come to rest level.
    """
    key = model.key("level")
    damping = model.dof_damping.copy()
    joints = [model.joint(axis) for axis in AXES]
    shafts = [model.joint(f"cam_{axis}") for axis in AXES]
    ball = model.joint("ball")
    place, speed = ball.qposadr[0], ball.dofadr[0]
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    for joint in joints:
        model.dof_damping[joint.dofadr[0]] = 20.0  # near critical: rests within a few periods
    flags = model.opt.disableflags
    model.opt.disableflags |= _UNSEEN
    middle, turn = data.qpos[place : place + 2], data.qpos[place + 3 : place + 7]
    slide, spin = data.qvel[speed : speed + 2], data.qvel[speed + 3 : speed + 6]
    for _ in range(rounds):
        put_level(model, data)
        for _ in range(round(time / model.opt.timestep)):
            mujoco.mj_step(model, data)
            middle[:] = slide[:] = spin[:] = 0.0
            turn[:] = upright
        angles = data.qpos[[joint.qposadr[0] for joint in joints]]
        key.qpos[:] = data.qpos
        key.act[:] = data.act
        for axis, joint, shaft, angle in zip(AXES, joints, shafts, angles, strict=True):
            lever = np.abs(model.geom(f"wheel_{axis}").pos[:2]).max()
            model.body(f"motor_{axis}").pos[2] -= lever * angle
            servo = model.actuator(f"servo_{axis}")
            key.act[servo.actadr[0]] -= data.qpos[shaft.qposadr[0]]
            key.qpos[[joint.qposadr[0], shaft.qposadr[0]]] = 0.0
    model.dof_damping[:] = damping
    model.opt.disableflags = flags
    if not np.abs(angles).max() < 1e-5:
        raise ModelError(_NEVER_LEVEL)


def balance(model: mujoco.MjModel, data: mujoco.MjData, rounds: int = 8) -> None:
    """Set shafts and set points as ``settle`` does, for gravity that has tilted a little.

    Level and at rest, the accelerations of plate, motors and height of the ball are 0. Newton's
    method solves that for the shafts' heights, the set points and the height of the ball, with
    the derivatives that it has at the first guess, the keyframe: they hardly change. As in
    ``settle`` the ball does not roll off; its height is not waited for, as it moves nothing else
    and comes slowly where the ball slides.

    Raises:
        ModelError: If there is no such balance.
    """
    key = model.key("level")
    hinges = [model.joint(name) for axis in AXES for name in (axis, f"cam_{axis}")]
    ball = model.joint("ball")
    height = ball.qposadr[0] + 2
    moving = [*(hinge.dofadr[0] for hinge in hinges), ball.dofadr[0] + 2]
    shafts = [model.body(f"motor_{axis}").id for axis in AXES]
    servos = [model.actuator(f"servo_{axis}").actadr[0] for axis in AXES]

    def acceleration(x: Array) -> Array:
        model.body_pos[shafts, 2], data.act[servos], data.qpos[height] = x[:2], x[2:4], x[4]
        mujoco.mj_forward(model, data)
        return np.array(data.qacc[moving])

    flags = model.opt.disableflags
    model.opt.disableflags |= _UNSEEN
    key.qpos[[hinge.qposadr[0] for hinge in hinges]] = 0.0
    put_level(model, data)
    x = np.array([*model.body_pos[shafts, 2], *data.act[servos], data.qpos[height]])
    now = acceleration(x)
    slopes = [(acceleration(x + nudge) - now) / _NUDGE for nudge in _NUDGE * np.eye(len(x))]
    try:
        inverse = np.linalg.inv(np.transpose(slopes))
    except np.linalg.LinAlgError:  # more does not help a motor that gives all it can
        raise ModelError(_NEVER_LEVEL) from None
    for _ in range(rounds):
        step = inverse @ acceleration(x)
        x = x - step
        if np.abs(step[:4]).max() < _LEAST:
            break
    else:
        raise ModelError(_NEVER_LEVEL)
    model.body_pos[shafts, 2], key.act[servos], key.qpos[height] = x[:2], x[2:4], x[4]
    model.opt.disableflags = flags
