"""`controllers`: Laws beyond the thesis, each against its own equations."""

import math
import sys

import daqp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are, solve_discrete_are
from scipy.optimize import minimize

from controllers.ballplate import TILT_SIGN, BallPlate
from controllers.design import sample
from controllers.interfaces import Feedback
from controllers.predictive import MAX_SOLVER_ITERATIONS, Predictive, Program
from controllers.references import Circle, Hold, Sine
from controllers.repetition import InternalModel, IterativeLearning
from controllers.stable_inversion import MotionPlan, StableInversion
from controllers.time_varying import GAIN_KNOT_S, GAINS_PER_SWEEP, TimeVaryingLQR, along

MODEL = BallPlate()


def feedback_of(t, x, path, plan):
    """All that a law may act on of an observer that knows the state and no more."""
    none, still = np.zeros((len(x), 0)), np.zeros((len(x), 2))
    return Feedback(t, x, x, none, still, still, path, none, plan)


def closed(law):
    """The linear plant (5.35) under the law, of plant and memory, shape (n, n)."""
    A, B, _ = MODEL.linear()
    rows = []
    for s in np.eye(8 + law.memory):
        x, q = s[:8], s[8:]
        u = law.control(0.0, x, Hold(), q)
        rows.append(np.concatenate((A @ x + B @ u, law.memory_rate(0.0, x, Hold(), q))))
    return np.array(rows).T


def last_error(law, path, force, omega):
    """Amplitude of the error in the steady state, of a path and a force that swing with omega.

    Args:
        law: The law.
        path: The reference.
        force: Of time in s, as acceleration of x and y.
        omega: In rad/s.
    """
    _, B, _ = MODEL.linear()
    zero, none = np.zeros(8), np.zeros(law.memory)

    def pushed(t):
        x = B @ law.control(t, zero, path, none)
        x[1::4] += force(t)
        return np.concatenate((x, law.memory_rate(t, zero, path, none)))

    def phasor(value):
        quarter = np.pi / 2 / omega if omega else 0.0
        return value(0.0) - 1j * value(quarter) * (omega > 0)

    A = closed(law)
    s = np.linalg.solve(1j * omega * np.eye(len(A)) - A, phasor(pushed))
    return np.abs(s[0:8:4] - phasor(lambda t: path(t)[0])).max()


def swinging(omega):
    return lambda t: np.array([0.05 * np.cos(omega * t + 0.3), 0.03 * np.sin(omega * t)])


def test_a_sinusoid_of_the_models_frequency_leaves_no_error_and_another_does():
    law = InternalModel(frequencies=(0.75,))
    path = Sine(amplitude=(0.15, 0.1), omega=0.75)
    assert last_error(law, path, swinging(0.75), 0.75) < 1e-12
    assert last_error(law, Hold(x=0.1), lambda t: np.array([0.03, -0.02]), 0.0) < 1e-12
    assert last_error(law, Hold(), swinging(1.5), 1.5) > 1e-4
    assert last_error(InternalModel(frequencies=(0.75, 1.5)), Hold(), swinging(1.5), 1.5) < 1e-12


@pytest.mark.parametrize("frequencies", [(), (0.5,), (0.75, 2.25), (2.0,)])
def test_all_that_is_wrong_dies_out_as_fast_as_is_asked(frequencies):
    law = InternalModel(frequencies=frequencies, decay=0.4)
    assert np.linalg.eigvals(closed(law)).real.max() < -0.4


TICK = 0.004
OMEGA = 2.0
LAP = round(2 * math.pi / OMEGA / TICK)
PATH = Sine(amplitude=(0.1, 0.12), omega=OMEGA, wave=("sin", "cos"))


def laps(law, path, count):
    """RMS errors lap by lap on the linear plant (5.35) with a force that repeats every lap."""
    A, B, _ = MODEL.linear()
    push = np.zeros((8, 2))
    push[1, 0] = push[5, 1] = 1
    Ad, Bd = sample(A, np.hstack((B, push)), TICK)
    r = path(0.0)
    x = np.zeros((1, 8))
    x[0, 0::4], x[0, 1::4] = r[0], r[1]
    plan, errors = law.start(x, path, TICK), []
    for tick in range(count * LAP):
        t = tick * TICK
        errors.append(x[0, 0::4] - path(t)[0])
        u = law.command(feedback_of(t, x, path, plan))
        turn = OMEGA * t
        force = 0.1 * np.array([[np.cos(turn) + 0.5 * np.sin(3 * turn), np.sin(2 * turn)]])
        x = x @ Ad.T + np.hstack((u, force)) @ Bd.T
    return np.sqrt(np.square(errors).reshape(count, LAP, 2).mean(axis=(1, 2))), plan


@pytest.mark.long
def test_the_error_of_every_second_lap_falls_by_what_is_learnt_of_it():
    error, _ = laps(IterativeLearning(omega=OMEGA, gain=0.7), PATH, 6)
    learnt = error[1::2]
    assert learnt[0] > 5e-4
    # the loop follows r + c with the transfer 1: |1 - gain| is left
    np.testing.assert_allclose(learnt[1:] / learnt[:-1], 0.3, rtol=0.1)


@pytest.mark.long
def test_a_path_that_does_not_repeat_teaches_nothing():
    _, plan = laps(IterativeLearning(omega=1.3), PATH, 5)
    assert not plan.table.any()


def test_the_plates_motion_for_a_correction_moves_the_ball_by_it():
    law = IterativeLearning(omega=OMEGA)
    plan = law.start(np.zeros((1, 8)), Hold(), TICK)
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


T = 0.002


def commands(law, path, x, ticks):
    plan = law.start(0 * x, path, T)
    return np.array([law.command(feedback_of(k * T, x, path, plan)) for k in range(ticks)])


@pytest.mark.parametrize("horizon", [0.1, 0.8])
def test_away_from_limits_the_program_has_the_regulators_answer(horizon):
    law = Predictive(horizon=horizon)
    # discrete Riccati equation of (eta, eta', a, a') under a held input, by hand
    h, k1 = law.step, MODEL.k1
    A = np.eye(4) + np.diag((h, k1 * h, h), 1) + np.diag((k1 * h**2 / 2, k1 * h**2 / 2), 2)
    A[0, 3] = k1 * h**3 / 6
    B = np.array([k1 * h**4 / 24, k1 * h**3 / 6, h**2 / 2, h])
    P = solve_discrete_are(A, B[:, None], np.diag(law.Q), np.eye(1))
    K = B @ P @ A / (1 + B @ P @ B)
    np.testing.assert_allclose(law.K, K, rtol=1e-6)
    program = Program(law)
    z = np.array([2e-3, -1e-3, 1e-3, 2e-3])
    none = np.zeros((3, law.steps))
    assert program.solve(z, none)[0] == pytest.approx(-K @ z, rel=1e-6)
    np.testing.assert_allclose(program.regulator[0, 0], -K, rtol=1e-6)


def test_where_limits_act_it_is_the_best_that_keeps_them():
    law = Predictive(horizon=0.2, rate_deg=5.0, Q=(20000.0, 2000.0, 100.0, 10.0))
    program, z = Program(law), np.array([0.02, 0.0, 0.0, 0.0])
    limits = law.limits
    found = program.solve(z, np.zeros((3, law.steps)))[0]
    assert abs(found - -law.K @ z) > 0.05

    def ahead(v):
        states = [z]
        for each in v:
            states.append(law.A @ states[-1] + law.B * each)
        return np.array(states)

    def cost(v):
        x = ahead(v)
        return (x[:-1] ** 2 @ law.Q).sum() + v @ v + x[-1] @ law.P @ x[-1]

    room = [
        {"type": "ineq", "fun": lambda v: limits[1] - np.abs(ahead(v)[1:, 3])},
        {"type": "ineq", "fun": lambda v: limits[2] - np.abs(ahead(v)[1:, 2])},
    ]
    best = minimize(
        cost,
        np.zeros(law.steps),
        bounds=[(-limits[0], limits[0])] * law.steps,
        constraints=room,
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 300},
    )
    assert best.success
    assert found == pytest.approx(best.x[0], abs=2e-3)


def test_a_raw_jump_asks_for_no_more_than_the_limits():
    law = Predictive()
    x = np.zeros((2, 8))
    x[0, 0::4], x[1, 0::4] = (0.15, -0.15), (1e-4, 0.0)
    u = commands(law, Hold(), x, 11)
    assert np.abs(u).max() == pytest.approx(law.acceleration, rel=1e-6)
    # the rig without need of a program has the regulator's answer, held for its step
    np.testing.assert_allclose(u[:10, 1, 0], -law.K[0] * 1e-4, rtol=1e-9)
    np.testing.assert_array_equal(u[:10], np.broadcast_to(u[0], (10, 2, 2)))
    alone = commands(law, Hold(), x[:1], 11)
    np.testing.assert_allclose(u[:, :1], alone, rtol=1e-9, atol=1e-12)


def test_a_program_that_is_not_solved_in_time_leaves_the_last_plan_in_force(monkeypatch):
    law, x = Predictive(), np.zeros((1, 8))
    x[0, 0::4] = 0.15, -0.1
    planned = Program(law).solve(np.array([0.15, 0, 0, 0]), np.zeros((3, law.steps)))
    count, solve = [], daqp.solve

    def soon_over(*args, iter_limit, **more):
        count.append(iter_limit)
        return solve(*args, iter_limit=iter_limit if len(count) <= 2 else 3, **more)

    monkeypatch.setattr(daqp, "solve", soon_over)
    ticks = round(law.step / T)
    u = commands(law, Hold(), x, 5 * ticks)[::ticks, 0, 0]
    assert len(count) == 10
    assert set(count) == {MAX_SOLVER_ITERATIONS}
    np.testing.assert_allclose(u, planned[:5], rtol=1e-6, atol=1e-9)
    assert np.ptp(planned[:5]) > 1  # so that holding the first would be another thing


def test_with_no_plan_and_no_answer_the_limits_are_kept(monkeypatch):
    law, x = Predictive(), np.full((1, 8), 0.2)
    solve = daqp.solve
    monkeypatch.setattr(daqp, "solve", lambda *a, iter_limit, **more: solve(*a, iter_limit=1))
    u = commands(law, Circle(amplitude=0.15, omega=6.0), x, 200)[:: round(law.step / T)]
    assert np.abs(u).max() <= law.acceleration * (1 + 1e-9)


def test_on_its_path_it_asks_for_the_motion_of_ball_and_plate():
    law, path = Predictive(), Circle(amplitude=0.1, omega=1.5)
    plan = law.start(np.zeros((1, 8)), path, T)
    fresh = MotionPlan(law, np.zeros((1, 8)), path, T)
    for tick in range(1500):
        wanted = fresh.at(tick * T)
        x = np.zeros((1, 8))
        x[:, 0::4], x[:, 1::4] = wanted.position, wanted.velocity
        x[:, 2::4], x[:, 3::4] = TILT_SIGN * wanted.slope.angle, TILT_SIGN * wanted.slope.rate
        u = law.command(feedback_of(tick * T, x, path, plan))
        np.testing.assert_allclose(u, TILT_SIGN * wanted.slope.acceleration, atol=2e-3)


def test_without_the_library_it_is_refused_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ValueError, match=r"pip install 'ballplate\[mpc\]'"):
        Predictive()


def gains(law, path, knots):
    plan = law.start(np.zeros(8), path, T)
    return np.array([plan.gain(k * GAIN_KNOT_S).copy() for k in range(knots)])


def test_on_a_level_plate_it_is_the_regulator_of_the_flat_output():
    law = TimeVaryingLQR()
    K = gains(law, Hold(), 2)[1]
    flat = StableInversion(Q=law.Q).K
    for axis, sign in enumerate(TILT_SIGN):
        # eta = x + c2 a and its rate, a, a' by the state of the axis
        by_state = flat @ (np.diag((1, 1, sign, sign)) + MODEL.c2 * sign * np.eye(4, k=2))
        own = slice(4 * axis, 4 * axis + 4)
        np.testing.assert_allclose(K[axis, own], sign * by_state, rtol=1e-7, atol=1e-7)


def test_the_gains_along_a_fast_path_are_those_of_the_differential_riccati_equation():
    law, path = TimeVaryingLQR(), Circle(amplitude=0.15, omega=4.0)
    first = 2 * GAINS_PER_SWEEP  # the third sweep, done tick by tick
    found = gains(law, path, first + GAINS_PER_SWEEP)[first:]
    end = (first + GAINS_PER_SWEEP) * GAIN_KNOT_S + law.horizon
    Q = law.weight()
    A0, B0, _ = MODEL.linear()
    level = gains(law, Hold(), 1)[0]
    assert np.abs(found - level).max() > 0.05 * np.abs(level).max()

    def rate(s, p):
        A, B = (each[0] for each in along(MODEL, path, np.array([end - s])))
        P = p.reshape(8, 8)
        return (A.T @ P + P @ A - P @ B @ B.T @ P + Q).ravel()

    begin = solve_continuous_are(A0, B0, Q, np.eye(2)).ravel()
    times = end - (first + np.arange(0, GAINS_PER_SWEEP, 8)) * GAIN_KNOT_S
    P = solve_ivp(rate, (0, times[0]), begin, t_eval=times[::-1], rtol=1e-8, atol=1e-8).y.T[::-1]
    for k, p in zip(range(0, GAINS_PER_SWEEP, 8), P, strict=True):
        B = along(MODEL, path, np.array([(first + k) * GAIN_KNOT_S]))[1][0]
        expected = B.T @ p.reshape(8, 8)
        np.testing.assert_allclose(found[k], expected, atol=2e-3 * np.abs(expected).max())


def test_rigs_with_paths_of_their_own_get_what_each_gets_alone():
    law = TimeVaryingLQR()
    paths = Circle(amplitude=0.15, omega=3.0), Hold(x=0.1)
    x = np.random.default_rng(1).normal(size=(2, 8)) * 0.05
    together = commands(law, lambda t: np.stack([path(t) for path in paths], axis=-2), x, 300)
    for rig, path in enumerate(paths):
        alone = commands(law, path, x[rig : rig + 1], 300)
        np.testing.assert_allclose(together[:, rig], alone[:, 0], rtol=1e-9, atol=1e-9)
