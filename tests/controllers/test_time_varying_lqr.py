import numpy as np
from scipy.integrate import solve_ivp

from controllers.advanced import KNOT, SLICE, TimeVaryingLQR, along
from controllers.ballplate import SIGN, BallPlate
from controllers.interfaces import Feedback
from controllers.references import Circle, Hold
from controllers.stable_inversion import StableInversion

MODEL = BallPlate()
T = 0.002


def gains(law, path, knots):
    plan = law.start(np.zeros(8), path, T)
    return np.array([plan.gain(k * KNOT).copy() for k in range(knots)])


def test_on_a_level_plate_it_is_the_regulator_of_the_flat_output():
    law = TimeVaryingLQR()
    K = gains(law, Hold(), 2)[1]
    flat = StableInversion(Q=law.Q).K
    for axis, sign in enumerate(SIGN):
        # eta = x + c2 a and its rate, a, a' by the state of the axis
        by_state = flat @ (np.diag((1, 1, sign, sign)) + MODEL.c2 * sign * np.eye(4, k=2))
        own = slice(4 * axis, 4 * axis + 4)
        np.testing.assert_allclose(K[axis, own], sign * by_state, rtol=1e-7, atol=1e-7)


def test_the_gains_along_a_fast_path_are_those_of_the_differential_riccati_equation():
    law, path = TimeVaryingLQR(), Circle(amplitude=0.15, omega=4.0)
    first = 2 * SLICE  # the third sweep, done tick by tick
    found = gains(law, path, first + SLICE)[first:]
    end = (first + SLICE) * KNOT + law.horizon
    Q = law.weight()
    A0, B0, _ = MODEL.linear()
    level = gains(law, Hold(), 1)[0]
    assert np.abs(found - level).max() > 0.05 * np.abs(level).max()

    def rate(s, p):
        A, B = (each[0] for each in along(MODEL, path, np.array([end - s])))
        P = p.reshape(8, 8)
        return (A.T @ P + P @ A - P @ B @ B.T @ P + Q).ravel()

    from scipy.linalg import solve_continuous_are

    begin = solve_continuous_are(A0, B0, Q, np.eye(2)).ravel()
    times = end - (first + np.arange(0, SLICE, 8)) * KNOT
    P = solve_ivp(rate, (0, times[0]), begin, t_eval=times[::-1], rtol=1e-8, atol=1e-8).y.T[::-1]
    for k, p in zip(range(0, SLICE, 8), P, strict=True):
        B = along(MODEL, path, np.array([(first + k) * KNOT])).B[0]
        expected = B.T @ p.reshape(8, 8)
        np.testing.assert_allclose(found[k], expected, atol=2e-3 * np.abs(expected).max())


def test_rigs_with_paths_of_their_own_get_what_each_gets_alone():
    law = TimeVaryingLQR()
    paths = Circle(amplitude=0.15, omega=3.0), Hold(x=0.1)

    class Both:
        def __call__(self, t):
            return np.stack([path(t) for path in paths], axis=-2)

    rng = np.random.default_rng(1)
    x = rng.normal(size=(2, 8)) * 0.05

    def commands(path, x):
        plan, found = law.start(0 * x, path, T), []
        still = np.zeros((*x.shape[:-1], 2))
        for tick in range(300):
            now = Feedback(tick * T, x, x, still[..., :0], still, still, path, still[..., :0], plan)
            found.append(law.command(now))
        return np.array(found)

    together = commands(Both(), x)
    for rig, path in enumerate(paths):
        alone = commands(path, x[rig])
        np.testing.assert_allclose(together[:, rig], alone, rtol=1e-9, atol=1e-9)
