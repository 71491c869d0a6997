"""Tests of `controllers.stable_inversion`."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize

from controllers.arrays import NUMBER_ARITHMETIC
from controllers.ballplate import TILT_SIGN, BallPlate
from controllers.feasible_path import PATH_SHAPING
from controllers.interfaces import Feedback, Reference, catalog_settings
from controllers.preview import SLICING, Slicing
from controllers.references import Circle, Hold, Sine, Step, Transition
from controllers.stable_inversion import InversePlan, PushResponse, StableInversion
from controllers.two_sided import TwoSided

MODEL = BallPlate()
T = 0.002
Z = math.sqrt(MODEL.k1 / MODEL.c2)


def laid(w, ticks, horizon=700, slice_=25):
    """a and three derivatives over so many samples of a function of time."""
    inverse = TwoSided(Z, T, slice_, horizon + 1)
    found = [
        np.array([*inverse.plan(w((first + np.arange(horizon + 1)) * T)[:, None]), inverse.jerk])
        for first in range(0, ticks, slice_)
    ]
    return np.concatenate(found, axis=1)[..., 0]


@pytest.mark.parametrize("omega", [0.5, 3.0, 10.0])
def test_inverse_of_an_oscillation_is_the_closed_form(omega):
    a, rate, acceleration, jerk = laid(lambda t: np.sin(omega * t), 2000)
    t = np.arange(2000) * T
    gain = 1 / (1 + (omega / Z) ** 2)
    steady = t > 1.5  # the past before the start is not known
    for found, wanted in (
        (a, gain * np.sin(omega * t)),
        (rate, gain * omega * np.cos(omega * t)),
        (acceleration, -gain * omega**2 * np.sin(omega * t)),
    ):
        np.testing.assert_allclose(found[steady], wanted[steady], atol=2e-4 * (1 + omega**2))
    third = -gain * omega**3 * np.cos(omega * t)
    np.testing.assert_allclose(jerk[steady], third[steady], atol=Z**2 * T * (1 + omega**2))


def test_inverse_of_a_step_begins_before_it_by_the_exponential_of_the_zero():
    at = 2.0
    a, *_ = laid(lambda t: (t >= at - 1e-9).astype(float), 2000)
    t = np.arange(2000) * T
    before, after = t < at - 0.01, t > at + 0.01
    np.testing.assert_allclose(a[before], np.exp(Z * (t - at))[before] / 2, atol=5e-3)
    np.testing.assert_allclose(a[after], 1 - np.exp(-Z * (t - at))[after] / 2, atol=5e-3)


def test_the_planned_slope_makes_the_ball_follow_the_path_itself():
    # x'' = k1 a - c2 a'' of the linear model (5.35), integrated on its own
    path = Transition(start=(0.0, 0.0), end=(0.15, -0.1), time=1.0, duration=2.0)
    plan = InversePlan(StableInversion(), np.zeros(8), path, T)
    x = v = np.zeros(2)
    last, error = np.zeros(2), []
    for tick in range(2000):
        wanted = plan.at(tick * T)
        acceleration = np.array(
            [MODEL.k1 * each.free.angle - MODEL.c2 * each.free.acceleration for each in wanted]
        )
        v = v + T / 2 * (last + acceleration) * (tick > 0)
        x = x + T * v
        last = acceleration
        error.append(x - path(tick * T)[0])
    assert np.abs(error).max() < 5e-4
    # the slope of the flat model, which leaves the plate's acceleration out, does not
    assert MODEL.c2 * np.abs(path(2.0 - 0.6)[2]).max() / MODEL.k1 > 1e-3


LAG = 0.06
X = np.array([[0.01, 0.02, 0.003, 0.04, -0.02, 0.0, 0.01, 0.05]])


def commanded(law, path, t, x=X, **known):
    """What a law asks for at a time, its plan laid anew from level rest."""
    plan = law.start(0 * x, path, T)
    return law.command(feedback(t, x, path, plan, **known))


def follows(law, lag, path, seconds=4.0, found=0.0):
    """Farthest that a ball under a law comes off its path after 2 s, m, along x: linear plate.

    Slope a and its rate r under the commanded rate w, r' = (w - r) / lag, and x'' = k1 a - c2 a'',
    integrated by steps of a tenth of a period. A law that knows of no lag is told w for r; one that
    is not told may be given the lag that an observer found.
    """
    plan = law.start(np.zeros((1, 8)), path, T)
    a = r = w = 0.0
    eta, speed = float(path(0.0)[0, 0]), float(path(0.0)[1, 0])
    off = []
    for tick in range(round(seconds / T)):
        x = np.zeros((1, 8))
        x[0, :4] = eta - MODEL.c2 * a, speed - MODEL.c2 * r, a, r if law.model.lag or found else w
        now = feedback(tick * T, x, path, plan, (0.0, 0.0, 0.0, 0.0, 0.0, found), rate=(w, 0.0))
        u = law.command(now)[0, 0]
        for _ in range(10):
            eta, speed = eta + T / 10 * speed, speed + T / 10 * MODEL.k1 * a
            a, r, w = a + T / 10 * r, r + T / 10 * (w - r) / lag, w + T / 10 * u
        off.append(abs(x[0, 0] - path(tick * T)[0, 0]))
    return max(off[round(2.0 / T) :])


@pytest.mark.long
def test_behind_drives_with_a_lag_that_is_told_the_ball_follows_as_on_drives_without():
    path = Circle(amplitude=0.06, omega=2.0)
    told = StableInversion(model=BallPlate(lag=LAG), slope=0.0)
    assert follows(told, LAG, path) < 3e-5  # 8e-5 without the third derivative
    assert follows(StableInversion(slope=0.0), LAG, path) > 1e-3


@pytest.mark.long
@pytest.mark.parametrize("lag", [0.003, 0.011, 0.028])
def test_a_lag_that_is_found_counts_as_one_that_is_told_while_the_ball_moves(lag):
    path = Circle(amplitude=0.06, omega=2.0)
    law, told = StableInversion(slope=0.0), StableInversion(model=BallPlate(lag=lag), slope=0.0)
    np.testing.assert_allclose(law._gains_for(lag, 1.0, NUMBER_ARITHMETIC), told.K, rtol=0.01)
    off = follows(law, lag, path, found=lag)
    assert off == pytest.approx(follows(told, lag, path), abs=2e-6)
    assert off < 0.3 * follows(law, lag, path)


def test_where_the_ball_is_to_rest_a_lag_that_is_found_is_left_out():
    for path, counts in ((Hold(), False), (Circle(), True)):
        without, found = (
            commanded(StableInversion(), path, 3.0, known=(0.05, 0.01, 0.0, 0.0, 0.0, lag))
            for lag in (0.0, 0.02)
        )
        if counts:
            assert (np.abs(without - found) > 0.01).all()
        else:
            np.testing.assert_array_equal(without, found)


@pytest.mark.parametrize(
    "path", [Circle(amplitude=0.15, omega=2.0), Sine(amplitude=(0.15, 0.0), omega=1.0)]
)
def test_a_plate_that_turns_faster_than_told_counts_as_told_so_while_the_ball_goes_on(path):
    rate, bias = np.array([0.05, -0.03]), np.array([0.01, 0.02])
    known = (0.05, 0.01, 0.0, 0.0, 0.0, 0.02)
    plain, faster, told = (
        commanded(
            StableInversion(rate_bias=counts, Q_slow=(3e5, 3e4, 1e4, 300.0)),
            path, 2 * math.pi, known=known, bias=bias, rate=each,
        )
        for counts, each in ((False, rate), (False, rate + bias), (True, rate))
    )  # fmt: skip
    goes_on = isinstance(path, Circle)  # a line turns back within the preview
    assert (np.abs(faster - plain) > 0.1).all()
    np.testing.assert_allclose(told, faster if goes_on else plain, rtol=1e-2)


@pytest.mark.parametrize(
    ("told", "found"),
    [(0.0, 0.02), *(pytest.param(lag, 0.0, marks=pytest.mark.long) for lag in (0.0, LAG))],
)
def test_a_ball_that_goes_on_has_the_weights_of_the_law_and_any_other_those_of_a_slow_one(
    told, found
):
    soft, stiff = (3e5, 3e4, 1e4, 8000.0), (3e5, 3e4, 1e4, 300.0)
    both, fast, slow = (
        StableInversion(model=BallPlate(lag=told), Q=Q, Q_slow=more)
        for Q, more in ((soft, stiff), (soft, None), (stiff, None))
    )
    known = (0.0, 0.0, 0.0, 0.0, 0.0, found)
    line, middle = Sine(amplitude=(0.15, 0.0), omega=1.0), 2 * math.pi
    begin, horizon = 6.25, 1.4 - 0.008  # of the slice there, and of a preview that begins early
    left = (0.15 * math.cos(begin + horizon) / 0.05) ** 4  # of 3 times the speed they change about
    go_on = Circle(amplitude=0.15, omega=1.0)
    quick = Circle(amplitude=0.15, omega=2.0)  # 6 times
    for path, t, share in (
        (Hold(), 3.0, 0.0),
        (line, middle + 0.7, 0.0),  # turns back within the preview
        (line, middle, left / (1 + left)),
        (go_on, middle, 81 / 82),
    ):
        stiffly, softly, mixed = (
            commanded(law, path, t, known=known) for law in (slow, fast, both)
        )
        expected = stiffly + share * (softly - stiffly)
        assert (np.abs(stiffly - softly) > 0.05).all()
        np.testing.assert_allclose(mixed, expected, atol=1e-3)
    softly, mixed = (commanded(law, quick, 3.0, known=known) for law in (fast, both))
    np.testing.assert_allclose(mixed, softly, rtol=0.01)


def test_a_lag_is_each_rigs_own():
    law = StableInversion(Q_slow=(3e5, 3e4, 1e4, 50.0))
    path, known = Circle(), (0.05, 0.01, 0.0, 0.0, 0.0)
    lags, x = (0.0, 0.004, 0.02), np.zeros((3, 8))
    x[:, :4] = 0.01, 0.02, 0.003, 0.04
    plan = law.start(0 * x, path, T)
    rows = [feedback(3.0, x[:1], path, plan, known=(*known, lag)).needed[0] for lag in lags]
    beside = law.command(feedback(3.0, x, path, plan)._replace(needed=np.array(rows)))
    for lag, row in zip(lags, beside, strict=True):
        alone = commanded(law, path, 3.0, x[:1], known=(*known, lag))
        np.testing.assert_array_equal(alone[0], row)
    assert len(np.unique(beside, axis=0)) == 3


@pytest.mark.parametrize("lag", [0.001, 0.04, 0.11])
def test_the_gain_for_drives_with_a_lag_makes_their_loop_stable(lag):
    law, k1 = StableInversion(model=BallPlate(lag=lag)), MODEL.k1
    A, B = np.zeros((5, 5)), np.array([0, 0, 0, 0, 1.0])
    A[0, 1] = A[2, 3] = 1
    A[1, 2], A[3, 3], A[3, 4] = k1, -1 / lag, 1 / lag
    assert np.linalg.eigvals(A - np.outer(B, law.K)).real.max() < -0.5
    if lag == 0.001:  # as good as none: rate and commanded rate are the same
        np.testing.assert_allclose(law.K[:3], StableInversion().K[:3], rtol=0.03)
        np.testing.assert_allclose(law.K[3] + law.K[4], StableInversion().K[3], rtol=0.03)


class Withheld(Reference):
    """A path that another one follows from some time on; remembers how far ahead it was asked."""

    here, there = Circle(amplitude=0.1, omega=1.0), Circle(amplitude=0.12, omega=2.0)

    def __init__(self, other_from=math.inf):
        self.other_from, self.now, self.farthest = other_from, 0.0, 0.0

    def __call__(self, t):
        t = np.asarray(t, float)
        self.farthest = max(self.farthest, float(t.max()) - self.now)
        return np.where((t > self.other_from)[..., None], self.there(t), self.here(t))


@pytest.mark.long
@pytest.mark.parametrize("slope", [0.0, 0.12])
@pytest.mark.parametrize("preview", [0.0, 0.02, 0.5, 1.4])
def test_the_future_beyond_the_preview_has_no_influence(preview, slope):
    law = StableInversion(preview=preview, slope=slope)
    shaped = slope and preview > 0.1
    further = PATH_SHAPING.horizon_s + SLICING.periods * T if shaped else 0.0
    parting, ticks = 1.8, 1000
    commands = []
    for path in (Withheld(), Withheld(other_from=parting)):
        plan = law.start(np.zeros((1, 8)), path, T)
        found = []
        for tick in range(ticks):
            path.now = tick * T
            now = feedback(tick * T, np.zeros((1, 8)), path, plan)
            found.append(law.command(now))
        assert path.farthest <= preview + further + 1e-9
        commands.append(np.array(found))
    same = (commands[0] == commands[1]).all(axis=(1, 2))
    first = int(np.argmin(same)) * T
    assert parting - preview - further - 1e-9 <= first <= parting + 2 * T


def feedback(t, x, path, plan, known=(0.05, 0, 0, 0, 0, 0), bias=(0.0, 0.0), rate=(0.0, 0.0)):
    """With what is known of friction, disturbance, tilt gain and lag, at a commanded rate."""
    still, rate = np.zeros((len(x), 2)), np.tile(rate, (len(x), 1))
    F, *disturbance_and_gain, lag = known
    needed = np.tile((F, lag, *disturbance_and_gain, *bias), (len(x), 1))
    return Feedback(t, x, x, needed, rate, still, path, np.zeros((len(x), 0)), plan)


def test_a_ball_at_rest_has_friction_fed_forward_along_its_own_heading():
    law, known = StableInversion(), (0.05, 0.0, 0.0, 0.0, 0.0, 0.0)
    x = np.zeros((1, 8))
    x[0, 1] = 0.01
    for path, own in ((Hold(), True), (Circle(amplitude=0.15, omega=1.0), False)):
        plan = law.start(np.zeros((1, 8)), path, T)
        t = 6.0
        x[0, 0::4] = [each.position for each in plan.at(t)]
        with_, without = (
            law.command(feedback(t, x, path, plan, (F, *known[1:])))[0] for F in (0.05, 0.0)
        )
        angle, rate, acceleration = np.transpose([each.drag for each in plan.at(t)])
        planned = acceleration + law.K[2] * angle + law.K[3] * rate
        planned = planned + MODEL.c2 * (law.K[0] * angle + law.K[1] * rate)
        heading = np.array([0.01 / math.hypot(0.01, law.smooth), 0.0]) / MODEL.k1
        expected = (law.K[2] + MODEL.c2 * law.K[0]) * heading if own else planned
        np.testing.assert_allclose(with_ - without, 0.05 * TILT_SIGN * expected, atol=2e-3)


@pytest.mark.parametrize("preview", [0.0, 1.4])
def test_a_jump_is_spread_and_ends_where_it_should(preview):
    path = Step(start=(0.0, 0.0), end=(0.15, 0.0), time=0.5)
    plan = InversePlan(StableInversion(preview=preview), np.zeros((1, 8)), path, T)
    wanted = [plan.at(tick * T)[0] for tick in range(1200)]
    x = np.array([each.position for each in wanted])
    v = np.array([each.velocity for each in wanted])
    np.testing.assert_allclose(np.gradient(x, T)[1:-1], v[1:-1], atol=2e-3)
    assert np.abs(np.diff(x)).max() < 1e-3
    assert x[250] == 0.0
    assert x[250 + 700 :] == pytest.approx(0.15, abs=1e-9)


def test_a_ball_that_starts_beside_its_path_is_led_to_it():
    x = np.zeros((1, 8))
    x[0, 0::4] = 0.1, -0.05
    plan = InversePlan(StableInversion(), x, Hold(), T)
    for t, place in ((0.0, [0.1, -0.05]), (1.5, [0.0, 0.0])):
        found = [each.position for each in plan.at(t)]
        np.testing.assert_allclose(found, place, atol=1e-6 if t == 0.0 else 1e-9)


ANGLE, RATE, ACCELERATION = math.radians(10), math.radians(35), 7.0


def pushed(law, speed, ticks=1000):
    """Position along y of a ball at rest that gets a speed, on a plate with limits; (5.35)."""
    plan, x, rate, found = law.start(np.zeros((1, 8)), Hold(), T), np.zeros(8), 0.0, []
    eta, eta_rate, slope = 0.0, speed, 0.0
    for k in range(ticks):
        x[4], x[5] = eta - MODEL.c2 * slope, eta_rate - MODEL.c2 * rate
        x[6], x[7] = -slope, -rate
        found.append(x[4])
        u = -law.command(feedback(k * T, x[None], Hold(), plan, (0.0,) * 6))[0, 1]
        before = rate
        desired = rate + T * u
        left = max(ANGLE - slope * np.sign(desired), 0.0)
        most = min(RATE, math.sqrt(2 * ACCELERATION * left))
        desired = min(max(desired, -most), most)
        rate += min(max(desired - rate, -ACCELERATION * T), ACCELERATION * T)
        eta, eta_rate = eta + T * eta_rate, eta_rate + T * MODEL.k1 * slope
        slope += T * (before + rate) / 2
    return np.array(found)


def furthest_at_best(speed, step=0.01, steps=120):
    """The least that the largest x can be, by linear programming."""
    rate = step * np.tri(steps)
    slope = step * np.tri(steps) @ (rate - step / 2 * np.eye(steps))
    back = step * step * np.tri(steps, k=-1) @ np.tri(steps) @ slope * MODEL.k1 - MODEL.c2 * slope
    one = np.ones((steps, 1))
    A = np.block([[back, -one], *([s * m, 0 * one] for m in (rate, slope) for s in (1, -1))])
    free = speed * step * np.arange(1, steps + 1)
    b = np.concatenate((-free, np.full(2 * steps, RATE), np.full(2 * steps, ANGLE)))
    bounds = [(-ACCELERATION, ACCELERATION)] * steps + [(None, None)]
    return scipy.optimize.linprog([*[0] * steps, 1], A, b, bounds=bounds).fun


@pytest.mark.parametrize("speed", [0.2, 0.3])
def test_a_pushed_ball_is_stopped_almost_as_soon_as_can_be_and_comes_back_without_passing(speed):
    x = pushed(StableInversion(Q=(8e5, 7e4, 3e4, 300.0)), speed)
    assert x.max() < furthest_at_best(speed) + 0.006
    assert x.min() > -0.001
    assert x[-1] < 0.01


def test_constants_of_the_algorithm_are_arguments_and_no_settings_of_a_scenario():
    names = {each.name for each in catalog_settings(StableInversion)}
    assert names.isdisjoint({"slicing", "jumps", "shaping", "push_response", "model"})
    assert {"preview", "spread", "Q_slow"} <= names
    law = StableInversion(push_response=PushResponse(max_growing_error_m=0.0, max_error_m=0.0))
    pushed = np.zeros((1, 8))
    pushed[0, 0] = 0.03
    path, none = Hold(), np.zeros((1, 0))
    assert law.control(0.0, pushed, path, none)[0, 0] == 0.0  # no error is fed back
    assert StableInversion().control(0.0, pushed, path, none)[0, 0] < 0.0
    short = replace(law, slicing=Slicing(periods=10)).ahead(pushed, path, T)
    assert (short.count, law.ahead(pushed, path, T).count) == (10, 25)


def slopes_of(law, x, ticks, time=0.0):
    """Slope and three derivatives of each tick along both axes, (ticks, 2, 4, ...)."""
    plan = InversePlan(law, x, Circle(amplitude=0.1, omega=1.0), T, time)
    times = time + T * np.arange(ticks)
    return np.array([[[*axis.free, axis.jerk[0]] for axis in plan.at(t)] for t in times])


def test_a_dither_adds_a_circle_of_the_tilt_and_its_derivatives_to_the_motion():
    law, ticks, begin = StableInversion(), 130, 0.5  # over five slices, from a later start
    shaken = replace(law, dither_deg=0.3, dither_hz=7.0)
    x = np.zeros(8)
    added = slopes_of(shaken, x, ticks, begin) - slopes_of(law, x, ticks, begin)
    angle = math.radians(0.3) * np.exp(1j * 2 * math.pi * 7.0 * (begin + T * np.arange(ticks)))
    for order in range(4):
        derivative = angle * (2j * math.pi * 7.0) ** order
        tolerance = 1e-12 * (2 * math.pi * 7.0) ** order
        np.testing.assert_allclose(added[:, 0, order], derivative.imag, rtol=0, atol=tolerance)
        np.testing.assert_allclose(added[:, 1, order], derivative.real, rtol=0, atol=tolerance)


def test_each_rig_has_the_same_dither_to_the_last_bit():
    law = StableInversion(dither_deg=0.3)
    several = slopes_of(law, np.zeros((3, 8)), 60)
    np.testing.assert_array_equal(several[..., 1], slopes_of(law, np.zeros(8), 60))


@pytest.mark.long
def test_a_dither_crosses_the_play_of_the_drives_so_that_the_mean_tilt_is_the_commanded_one():
    play = math.radians(0.3)

    def worst_mean(dither):
        """Largest error in rad of the plate's tilt, as the mean of a round, over a slow path."""
        law, ticks, turn = StableInversion(dither_deg=dither), 3000, 100
        tilt, plate = slopes_of(law, np.zeros(8), ticks)[:, 0, 0], 0.0
        still = slopes_of(StableInversion(), np.zeros(8), ticks)[:, 0, 0]
        errors = []
        for wanted, slow in zip(tilt, still, strict=True):
            plate = min(max(plate, wanted - play / 2), wanted + play / 2)
            errors.append(plate - slow)
        means = np.convolve(errors[turn:], np.ones(turn) / turn, "valid")
        return np.abs(means).max()

    assert worst_mean(0.0) == pytest.approx(math.radians(0.15), rel=0.01)
    assert worst_mean(0.3) < math.radians(0.03)


@pytest.mark.parametrize("key", [{"dither_deg": 2.1}, {"dither_deg": -0.1}, {"dither_hz": 21.0}])
def test_a_dither_out_of_range_is_refused(key):
    with pytest.raises(ValueError, match=f"{next(iter(key))} must be a finite number"):
        StableInversion(**key)
