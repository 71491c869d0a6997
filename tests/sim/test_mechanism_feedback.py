"""Why a law must not be fed the true plate rate: the plate's resonance answers."""

from __future__ import annotations

import numpy as np

from controllers.ballplate import BallPlate
from twin.hal.cams import CamTable
from twin.paths import model_path
from twin.sim.plant.mechanism import Mechanism

PERIOD = 0.002
GAINS = (72.0, 150.0, 70.0, 20.0)
"""Of position, speed, plate angle and plate rate; stable by the ball-and-plate model alone."""


def ringing(true_rate):
    """Largest plate rate in rad/s in the last second of six under a full state feedback."""
    plant = Mechanism()
    plant.start(np.array([[0.05, 0.0, -0.05, 0.0]]))
    table = CamTable.from_file(model_path("cams.json"))
    angle = rate = np.zeros((1, 2))
    motor = table.motor(angle)
    k1, sign = BallPlate().k1, np.array([1, -1])
    position, speed, tilt, damping = GAINS
    last = []
    for _ in range(round(6 / PERIOD)):
        x = plant.state
        ball = (position * x[:, [0, 4]] + speed * x[:, [1, 5]]) / k1 * sign
        plate_rate = x[:, [3, 7]] if true_rate else rate
        u = np.clip(-ball - tilt * x[:, [2, 6]] - damping * plate_rate, -7, 7)
        rate = rate + PERIOD * u
        angle = np.clip(angle + PERIOD * rate, -0.17, 0.17)
        after = table.motor(angle)
        plant.advance((after - motor) / PERIOD, 2)
        motor = after
        last.append(np.abs(plant.state[0, [3, 7]]).max())
    return max(last[-round(1 / PERIOD) :])


def test_the_gains_are_stable_by_the_model_without_a_mechanism():
    position, speed, tilt, damping = GAINS
    poles = np.roots([1, damping, tilt, speed, position])
    assert poles.real.max() < 0


def test_feedback_of_the_true_plate_rate_excites_the_resonance():
    assert ringing(true_rate=True) > 0.1


def test_feedback_of_the_commanded_plate_rate_leaves_the_plate_quiet():
    assert ringing(true_rate=False) < 0.02
