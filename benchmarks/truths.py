"""What the simulated mechanism is asked to get right, each as one number at a physics step.

Every function takes the physics step in s. Those of ``RUNS`` give the ball's path in closed loop,
those of ``TRUTHS`` numbers that are known from elsewhere or from a finer step.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from controllers.arrays import Array
from twin.emulator.lockstep import LockstepRig
from twin.hal.cams import CamTable
from twin.run.finished import run
from twin.run.record import Recorder
from twin.scenario import load
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.model import load_model

PERIOD = 0.002
AWAY = (0.6, 0.0, 0.0, 0.0)
"""Start of the ball beside the screen."""
AXES = ("phi", "theta")

RUNS: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("runs.toml").read_text(encoding="utf-8")
)
"""What is run in closed loop: scenario, overrides, and whether over emulated drives and screen."""
SECONDS = 10.0


def path(step: float, name: str, seconds: float = SECONDS) -> tuple[Array, Array]:
    """Where the ball is in each control period of a run, and where it is to be, m, each (K, 2)."""
    about = RUNS[name]
    given = [f"duration={seconds}", f"metrics.start={seconds / 2}", f"plant.step={step}"]
    scenario = load(about["scenario"], [*about["set"], *given])
    if not about.get("wired"):
        motion = run(scenario).motion
        return motion.ball, motion.reference
    rig, balls = LockstepRig(scenario), []

    def watch(record: Recorder) -> None:
        # such a rig does not know the truth, its plant does
        record.observers.append(lambda *_: balls.append(rig.plant.devices.state[0, 0::4]))

    motion = run(scenario, watch=watch, rig=rig).motion
    return np.array(balls), motion.reference


def on_slope(step: float, slope_deg: float, seconds: float) -> float:
    """How far the ball has gone from rest on a sloping plate, m."""
    plant = Mechanism(
        step=step,
        friction=Friction(rolling=1.8e-4),
        parts=Parts(level=(math.radians(slope_deg), 0.0)),
    )
    plant.start(np.zeros((1, 4)))
    plant.advance(np.zeros((1, 2)), round(seconds / step))
    return float(np.hypot(*plant.state[0, [0, 4]]))


def breakaway_deg(step: float) -> float:
    """Slope at which a ball that has rested long starts, on a plate tilted slowly, deg."""
    friction = Friction(rolling=1.8e-4, breakaway_ratio=1.5, dwell_time=0.5)
    plant = Mechanism(step=step, friction=friction)
    plant.start(np.zeros((1, 4)))
    rate = np.array([[math.radians(0.05) * plant.ratio, 0.0]])
    for _ in range(round(25 / PERIOD)):
        plant.advance(rate, round(PERIOD / step))
        if abs(plant.state[0, 0]) > 1e-4:
            break
    return math.degrees(plant.state[0, 2])


def ringing(step: float, axis: str, pose_deg: float = 0.0, **parts: Any) -> tuple[float, float]:
    """Frequency in Hz and damping ratio of an axis after a tap, both axes tilted to a pose."""
    model = load_model(parts=Parts(**parts), drawn=False)
    model.opt.timestep = step
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    data.joint("ball").qpos[0] = AWAY[0]
    if pose_deg:
        motor = CamTable.packaged().motor(np.radians([pose_deg, pose_deg]))
        for name, angle in zip(AXES, motor, strict=True):
            data.actuator(f"servo_{name}").ctrl = angle / 2
        mujoco.mj_step(model, data, round(2 / step))
        data.ctrl[:] = 0
        mujoco.mj_step(model, data, round(4 / step))
    data.joint(axis).qvel = 0.02
    angles = np.empty(round(0.6 / step))
    for k in range(len(angles)):
        mujoco.mj_step(model, data)
        angles[k] = data.joint(axis).qpos[0]
    return fit_ringing(angles, step)


def fit_ringing(angle: Array, step: float) -> tuple[float, float]:
    """Frequency in Hz and damping ratio of a decaying sine that begins one step before."""
    t = step * np.arange(1, len(angle) + 1)
    spectrum = np.abs(np.fft.rfft(angle - angle.mean(), 8 * len(angle)))
    guess = 2 * math.pi * spectrum.argmax() / (8 * len(angle) * step)
    scale = np.abs(angle).max()

    def misfit(p: Array) -> Array:
        decay, omega, sine, cosine, offset = p
        wave = sine * np.sin(omega * t) + cosine * np.cos(omega * t)
        return np.asarray(np.exp(-decay * t) * wave + offset - angle / scale)

    decay, omega, *_ = least_squares(misfit, [0.05 * guess, guess, 1.0, 0.0, 0.0], x_scale="jac").x
    natural = math.hypot(decay, omega)
    return natural / (2 * math.pi), float(decay / natural)


def followed(step: float, plate: Array) -> tuple[Array, Array]:
    """Wheel forces in N and motor torques in N m, each (steps, N, 2), along plate angles (K, N, 2).

    The plate angles are those of one control period each.
    """
    plant = Mechanism(rigs=plate.shape[1], step=step, threads=1)
    plant.start(np.repeat([AWAY], plant.rigs, axis=0))
    at = [plant.channels.index(name) for name in ("wheel_phi_N", "wheel_theta_N")]
    turned = [plant.channels.index(name) for name in ("torque_phi_Nm", "torque_theta_Nm")]
    forces, torques = [], []
    motor = CamTable.packaged().motor(plate)
    for now, after in pairwise(motor):
        for _ in range(round(PERIOD / step)):
            plant.advance((after - now) / PERIOD, 1)
            told = plant.telemetry()
            forces.append(told[:, at])
            torques.append(told[:, turned])
    return np.array(forces), np.array(torques)


def least_force(step: float) -> float:
    """Least force of a wheel on its cam over sines of 8 deg with 7 rad/s^2 on both axes, N."""
    amplitude = math.radians(8)
    omega = math.sqrt(7 / amplitude)
    t = np.arange(0, 4, PERIOD)[:, None]
    s = np.minimum(t / 2, 1)
    begin = s**3 * (10 - 15 * s + 6 * s**2)
    shift = np.array([0, math.pi / 2, math.pi])
    phi, theta = (amplitude * begin * np.sin(omega * t + each) for each in (0 * shift, shift))
    forces, _ = followed(step, np.stack((phi, theta), axis=-1))
    return float(forces.min())


def torque_peak(step: float) -> float:
    """Largest motor torque of the sines of ``least_force``, N m; a limit cycle would raise it."""
    t = np.arange(0, 3, PERIOD)[:, None]
    plate = math.radians(8) * np.minimum(t / 2, 1) ** 3 * np.sin(7.08 * t)
    _, torques = followed(step, np.stack((plate, plate), axis=-1))
    return float(np.abs(torques).max())


def at_stop(step: float) -> tuple[float, float]:
    """Angle in deg of a plate tilted to 9.9 deg, and the way in m of a ball on it in 0.15 s."""
    plant = Mechanism(step=step, friction=Friction(rolling=1.8e-4))
    plant.start(np.array([[-0.2, 0.0, 0.1, 0.0]]))
    angle = np.radians([9.9, 9.9])
    motor = CamTable.packaged().motor(angle)
    plant.advance(motor[None] / 0.25, round(0.25 / step))
    before = plant.state[0, [0, 4]]
    plant.advance(np.zeros((1, 2)), round(0.15 / step))
    way = float(np.hypot(*(plant.state[0, [0, 4]] - before)))
    plant.advance(np.zeros((1, 2)), round(1.5 / step))
    return float(np.degrees(plant.state[0, [2, 6]]).max()), way


TRUTHS: dict[str, tuple[str, Callable[[float], float]]] = {
    "ball at rest on 0.5 deg, 4 s": ("um", lambda step: 1e6 * on_slope(step, 0.5, 4.0)),
    "ball rolls down 0.8 deg, 1.5 s": ("mm", lambda step: 1e3 * on_slope(step, 0.8, 1.5)),
    "slope at which a rested ball starts": ("deg", breakaway_deg),
    "resonance about phi": ("Hz", lambda step: ringing(step, "phi")[0]),
    "resonance about theta": ("Hz", lambda step: ringing(step, "theta")[0]),
    "its damping about phi": ("%", lambda step: 100 * ringing(step, "phi")[1]),
    "its damping about theta": ("%", lambda step: 100 * ringing(step, "theta")[1]),
    "resonance about phi at 9.5 deg": ("Hz", lambda step: ringing(step, "phi", 9.5)[0]),
    "resonance about theta at 9.5 deg": ("Hz", lambda step: ringing(step, "theta", 9.5)[0]),
    "angle at rest near the stop": ("deg", lambda step: at_stop(step)[0]),
    "way of the ball there in 0.15 s": ("mm", lambda step: 1e3 * at_stop(step)[1]),
    "least wheel force, 8 deg, 7 rad/s2": ("N", least_force),
    "largest torque on the way": ("N m", torque_peak),
}
