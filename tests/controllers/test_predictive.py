import daqp
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from controllers.advanced import MOST, Predictive, Program
from controllers.ballplate import SIGN, BallPlate
from controllers.interfaces import Feedback
from controllers.references import Circle, Hold
from controllers.stable_inversion import MotionPlan

MODEL = BallPlate()
T = 0.002


def commands(law, path, x, ticks):
    plan = law.start(0 * x, path, T)
    none, still = np.zeros((len(x), 0)), np.zeros((len(x), 2))
    return np.array(
        [
            law.command(Feedback(k * T, x, x, none, still, still, path, none, plan))
            for k in range(ticks)
        ]
    )


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
    assert set(count) == {MOST}
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
    none, still = np.zeros((1, 0)), np.zeros((1, 2))
    for tick in range(1500):
        wanted = fresh.at(tick * T)
        x = np.zeros((1, 8))
        x[:, 0::4], x[:, 1::4] = wanted.position, wanted.velocity
        x[:, 2::4], x[:, 3::4] = SIGN * wanted.slope.angle, SIGN * wanted.slope.rate
        u = law.command(Feedback(tick * T, x, x, none, still, still, path, none, plan))
        np.testing.assert_allclose(u, SIGN * wanted.slope.acceleration, atol=2e-3)


def test_without_the_library_it_is_refused_in_one_line(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ValueError, match=r"pip install 'ballplate\[mpc\]'"):
        Predictive()
