import math

import numpy as np

from controllers.advanced import IterativeLearning
from controllers.ballplate import BallPlate
from controllers.design import sample
from controllers.interfaces import Feedback
from controllers.references import Hold, Sine

MODEL = BallPlate()
T = 0.004
OMEGA = 2.0
LAP = round(2 * math.pi / OMEGA / T)
PATH = Sine(amplitude=(0.1, 0.12), omega=OMEGA, wave=("sin", "cos"))


def laps(law, path, count):
    """RMS errors lap by lap on the linear plant (5.35) with a force that repeats every lap."""
    A, B, _ = MODEL.linear()
    push = np.zeros((8, 2))
    push[1, 0] = push[5, 1] = 1
    Ad, Bd = sample(A, np.hstack((B, push)), T)
    r = path(0.0)
    x = np.zeros((1, 8))
    x[0, 0::4], x[0, 1::4] = r[0], r[1]
    plan, none = law.start(x, path, T), np.zeros((1, 0))
    still, errors = np.zeros((1, 2)), []
    for tick in range(count * LAP):
        t = tick * T
        errors.append(x[0, 0::4] - path(t)[0])
        u = law.command(Feedback(t, x, x, none, still, still, path, none, plan))
        turn = OMEGA * t
        force = 0.1 * np.array([[np.cos(turn) + 0.5 * np.sin(3 * turn), np.sin(2 * turn)]])
        x = x @ Ad.T + np.hstack((u, force)) @ Bd.T
    return np.sqrt(np.square(errors).reshape(count, LAP, 2).mean(axis=(1, 2))), plan


def test_the_error_of_every_second_lap_falls_by_what_is_learnt_of_it():
    error, _ = laps(IterativeLearning(omega=OMEGA, gain=0.7), PATH, 6)
    learnt = error[1::2]
    assert learnt[0] > 5e-4
    # the loop follows r + c with the transfer 1: |1 - gain| is left
    np.testing.assert_allclose(learnt[1:] / learnt[:-1], 0.3, rtol=0.1)


def test_a_path_that_does_not_repeat_teaches_nothing():
    _, plan = laps(IterativeLearning(omega=1.3), PATH, 5)
    assert not plan.table.any()


def test_the_plates_motion_for_a_correction_moves_the_ball_by_it():
    law = IterativeLearning(omega=OMEGA)
    plan = law.start(np.zeros((1, 8)), Hold(), T)
    rng = np.random.default_rng(2)
    plan.table = plan._before = (rng.normal(size=(9, 1, 2)) + 1j * rng.normal(size=(9, 1, 2))) / 100
    times = 1.0 + np.arange(200) * 1e-3
    wanted = [plan.at(t, np.zeros((1, 8))) for t in times]
    position, velocity = (np.array([w[i] for w in wanted]) for i in (0, 1))
    angle, rate, acceleration = (np.array([w.slope[i] for w in wanted]) for i in range(3))
    for value, derivative in ((position, velocity), (angle, rate), (rate, acceleration)):
        slope = np.gradient(value, times, axis=0)[1:-1]
        assert np.abs(slope - derivative[1:-1]).max() < 2e-3 * np.abs(derivative).max()
    # (5.35): x'' = k1 a - c2 a''
    ball = np.gradient(velocity, times, axis=0)[1:-1]
    expected = (MODEL.k1 * angle - MODEL.c2 * acceleration)[1:-1]
    assert np.abs(ball - expected).max() < 2e-3 * np.abs(expected).max()
