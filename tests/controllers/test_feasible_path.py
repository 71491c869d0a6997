"""Tests of `controllers.feasible_path` and `controllers.preview`."""

from itertools import accumulate

import daqp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import ballplate as bp
from controllers.feasible_path import PATH_SHAPING, FeasiblePath, PathShaping
from controllers.interfaces import Reference
from controllers.per_rig import PerRigReference
from controllers.preview import Preview
from controllers.references import Circle, Lissajous, Path, Sine, Transition
from controllers.setpoints import Setpoints
from controllers.stable_inversion import StableInversion
from twin.view.summary import describe_run

T = 0.002
LAW = StableInversion()
A, J = LAW.model.k1 * LAW.slope, LAW.model.k1 * LAW.slope_rate
STEP = Setpoints(points=((0.0, 0.0, 0.0), (2.0, 0.15, -0.1)), time_constant=0.02)
places = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.12, 0.12))


def laid(reference, start, seconds, limits=(A, J), now=None, **constants):
    """Position, velocity, acceleration, shape (3, K, ..., 2), of what ``now(t)`` is known at t."""
    begin = np.array(start, float)
    preview = Preview(reference, begin, T, LAW.preview, LAW.spread, limits, **constants)
    slices = []
    for number in range(round(seconds / T / preview.count)):
        if now is not None:
            preview.reference = now(number * preview.count * T)
        preview.sample()
        preview.advance()
        slices.append(preview.window[:, : preview.count])
    return np.concatenate(slices, axis=1)


def goals(least, most):
    """Two to five goals (t, x, y), one so many seconds after the other."""

    def one_after_the_other(steps):
        times = accumulate(step for step, _ in steps)
        return tuple((time, *place) for time, (_, place) in zip(times, steps, strict=True))

    steps = st.tuples(st.floats(least, most), places)
    return st.lists(steps, min_size=2, max_size=5).map(one_after_the_other)


@settings(max_examples=15)
@given(goals(0.2, 3), st.floats(0.01, 0.3))
def test_every_path_is_a_motion_that_keeps_to_the_limits(points, time_constant):
    path = Setpoints(points=points, time_constant=time_constant)
    keeps_to_the_limits(*laid(path, points[0][1:], 8.0))


def keeps_to_the_limits(p, v, a):
    assert np.abs(a).max() <= A * (1 + 1e-9)
    assert np.abs(np.diff(a, axis=0)).max() <= J * T * (1 + 1e-6)
    # by Simpson's rule and the trapezium, exact for a straight acceleration; a slice may end on its
    # reference by what BACK says
    assert np.abs(np.diff(v, axis=0) - T * (a[1:] + a[:-1]) / 2).max() < 1.1e-3
    assert np.abs(np.diff(p, axis=0) - T * (v[1:] + v[:-1]) / 2).max() < 1.1e-4


def test_a_path_that_the_plate_can_give_is_left_as_it_is():
    circle, start = Circle(amplitude=0.15, omega=0.75), (0.15, 0.0)
    np.testing.assert_array_equal(laid(circle, start, 6.0), laid(circle, start, 6.0, None))


FAST = {
    "sine": Sine(amplitude=(0.15, 0.0), omega=5.0),
    "slow sine": Sine(amplitude=(0.15, 0.0), omega=0.5),
    "cosine": Sine(amplitude=(0.05, 0.12), omega=(3.0, 8.0), wave=("cos", "sin")),
    "circle": Circle(amplitude=0.12, omega=-4.0, start=0.0),
    "figure": Lissajous(amplitude=(0.2, 0.12), omega=(2.0, 6.0), phase=0.7, start=0.0),
    "short ramp": Path(points=((0.0, 0.0), (0.1, 0.1), (0.1, -0.1)), duration=1.0, ramp=0.05),
    "leaves at once": Transition(end=(0.15, 0.1), duration=0.2),
}


@pytest.mark.short("*-place0")
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.1, -0.07)])
@pytest.mark.parametrize("path", FAST.values(), ids=FAST)
def test_a_path_that_is_under_way_at_the_start_is_joined_from_rest(path, place):
    # the ball rests where it is, and a period later has what limits of jerk and acceleration give
    p, v, a = laid(path, place, 3.0)
    rest = np.array((place, (0.0, 0.0), (0.0, 0.0)))[:, None]
    keeps_to_the_limits(*np.concatenate((rest, (p, v, a)), axis=1))
    if path is FAST["slow sine"]:  # which the plate can give, once the ball is on it
        times = T * np.arange(len(p))
        np.testing.assert_allclose(p[times > 1.5], path(times[times > 1.5])[0], atol=1e-3)


def test_a_ball_that_moves_at_the_start_is_led_on_from_there():
    x = np.zeros((1, 8))
    x[0, 0::4], x[0, 1::4], x[0, 2] = (0.05, -0.02), (0.2, -0.1), 0.03
    fresh = LAW.start(x, FAST["sine"], T)
    for plan, t in ((fresh, 0.0), (LAW.replanned(fresh, 4.0, x, FAST["sine"], T), 4.0)):
        found = plan.at(t)
        np.testing.assert_allclose([each.position for each in found], (0.05, -0.02), atol=1e-5)
        np.testing.assert_allclose([each.velocity for each in found], (0.2, -0.1), atol=A * T)
        later = plan.at(t + 0.1)
        moved = (0.05 + 0.02 + 0.005 * LAW.model.k1 * 0.03, -0.03)
        # by the jerk that it may have been given since
        np.testing.assert_allclose(
            [each.position for each in later], moved, atol=J * 0.1**3 / 6 + 1e-4
        )


def unforeseen(points, time_constant):
    """What is known of goals at a time, and the path that is laid while they come."""

    def now(t):
        known = [each for each in points if each[0] <= t]
        return Setpoints(points=known or points[:1], time_constant=time_constant)

    return laid(now(0.0), points[0][1:], points[-1][0] + 6.0, now=now)


@settings(max_examples=15)
@given(goals(0.05, 2), st.floats(0.01, 0.3))
@example(  # without ``restart`` the path leaps by 0.2 mm
    (
        *((0.94, 0.004, 0.028), (1.01, 0.02, 0.003)),
        *((1.88, -0.004, -0.002), (2.84, 0.018, -0.016)),
    ),
    0.0744,
)
def test_goals_that_nobody_knew_of_are_gone_to_within_the_limits(points, time_constant):
    path = unforeseen(points, time_constant)
    keeps_to_the_limits(*path)
    np.testing.assert_allclose(path[0, -1], points[-1][1:], atol=1e-3)
    early = round(points[1][0] / T)  # nothing is known of the second goal before it is given
    np.testing.assert_allclose(path[0, :early], points[0][1:] + 0 * path[0, :early], atol=1e-9)


def test_where_the_plate_can_give_it_the_path_is_that_of_goals_that_were_known():
    points = ((0.0, 0.0, 0.0), (0.53, 0.05, 0.02), (1.1, -0.03, 0.03), (4.0, 0.02, -0.02))
    path = unforeseen(points, 0.2)
    times = T * np.arange(path.shape[1])
    known = Setpoints(points=points, time_constant=0.2)(times)
    np.testing.assert_allclose(path[0], known[0], atol=1e-5)
    np.testing.assert_allclose(path[1], known[1], atol=1e-3)


def test_the_same_path_given_again_changes_no_bit():
    goals = ((0.0, 0.0, 0.0), (1.0, 0.05, 0.02))
    alone = laid(Setpoints(points=goals), (0.01, 0.0), 3.0)
    again = laid(Setpoints(points=goals), (0.01, 0.0), 3.0, now=lambda _: Setpoints(points=goals))
    np.testing.assert_array_equal(alone, again)


CALM = Circle(amplitude=0.05, omega=1.0)


class Later(Reference):
    """A small circle, and the step a second later besides."""

    def __call__(self, t):
        return CALM(t) + STEP(np.asarray(t) - 1.0)


@pytest.mark.short("step", "transition")
@pytest.mark.parametrize(
    "both",
    [
        (CALM, STEP),
        (CALM, Transition(end=(0.15, 0.0), duration=0.4)),
        (CALM, Circle(amplitude=0.15, omega=3.0)),
        (STEP, Later()),
    ],
    ids=["step", "transition", "circle", "later"],
)
def test_beside_others_it_has_the_bits_it_has_alone(both):
    off = (1e-3, 0.1)  # the second ball's way to its path is a jump, the first one's is none
    starts = [
        reference(0.0)[0] + np.array([way, 0.0]) for reference, way in zip(both, off, strict=True)
    ]
    together = laid(PerRigReference(both, T), starts, 7.0)
    for rig, (reference, start) in enumerate(zip(both, starts, strict=True)):
        np.testing.assert_array_equal(together[:, :, rig], laid(reference, start, 7.0))


def test_it_is_the_nearest_of_all_paths_of_pieces_of_constant_jerk():
    # by an active-set method that knows nothing of this one, its motion integrated anew
    feasible = FeasiblePath((A, J), T, 25, PathShaping(iterations=5000))
    path = STEP(1.5 + T * np.arange(1, 650))[:3]
    state = STEP(1.5)[:3]
    kept = feasible.within_each(np.concatenate((path[:, :1], path), axis=1))
    made = feasible.follow(state, path, kept)
    n, h = feasible.length, 25 * T / PATH_SHAPING.pieces_per_slice
    end = h * np.arange(1, n + 1)
    since = np.maximum(end[:, None] - h * np.arange(n + 1), 0.0)  # of each piece's begin
    cube = (since[:, :-1] ** 3 - since[:, 1:] ** 3) / 6
    tilt = since[:, :-1] - since[:, 1:]
    desired = STEP(1.5 + end)[0]
    for axis in (0, 1):
        upper = np.concatenate((np.full(n, J), np.full(n, A)))
        jerk, _, exit_flag, _ = daqp.solve(
            cube.T @ cube + 1e-9 * np.eye(n),
            -cube.T @ desired[:, axis],
            np.ascontiguousarray(tilt),
            upper,
            -upper,
            np.zeros(2 * n, np.int32),
        )
        assert exit_flag == 1
        begun = np.minimum(T * np.arange(1, 26), h)
        rest = T * np.arange(1, 26) - begun
        a = jerk[0] * begun + jerk[1] * rest
        np.testing.assert_allclose(made[2, :, axis], a, atol=2e-2 * A)
        assert np.abs(a).max() > 0.05 * A


@pytest.mark.long
def test_few_steps_of_the_method_lose_little():
    short = laid(STEP, (0.0, 0.0), 6.0)[0]
    exact = laid(STEP, (0.0, 0.0), 6.0, shaping=PathShaping(iterations=1000))[0]
    desired = STEP(T * np.arange(len(exact)))[0]
    far = [np.sqrt(((path - desired) ** 2).mean()) for path in (short, exact)]
    assert 5e-3 < far[1] <= far[0] < 1.05 * far[1]


def test_a_corner_without_acceleration_is_seen():
    feasible = FeasiblePath((A, J), T, 25)
    t = T * np.arange(100)
    corner = np.zeros((3, 100, 2))
    corner[0, :, 0], corner[1, :, 0] = 0.1 * np.maximum(t - 0.1, 0), 0.1 * (t > 0.1)
    assert not feasible.within(corner)
    assert feasible.within(corner[:, :50])


@pytest.mark.long
def test_the_cure_keeps_a_ball_whose_reference_is_under_way_at_the_start():
    fast = ['reference={kind="sine",amplitude=[0.15,0.0],omega=5.0}', "duration=1.2"]
    with pytest.warns(bp.BallplateWarning, match="up to 1[0-9][0-9] mm away"):
        run = bp.run("cure", ["baseline=false", "plant.kind=lagrange", *fast])
    assert run.outcome == "finished"
    assert np.abs(run.rows["true_x"]).max() < 0.15


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::ballplate.BallplateWarning")
def test_the_cure_keeps_a_ball_on_a_path_that_the_plate_cannot_give():
    cure = [
        "baseline=false",
        "plant.kind=lagrange",
        'reference={kind="setpoints",points=[[0,0.12,0.06],[2,-0.12,0.06],[4,0.1,-0.06]],'
        "time_constant=0.05}",
        "plant.start.x=0.12",
        "plant.start.y=0.06",
        "duration=6",
    ]
    kept, lost = (
        bp.run("cure", [*cure, f"controller.slope={slope}"]) for slope in (LAW.slope, 0.0)
    )
    assert kept.outcome == "finished"
    away = kept.motion.error
    assert np.sqrt((away**2).sum(axis=1).mean()) < 0.04
    assert lost.outcome != "finished"
    # and what was done is in the record, and said
    laid = np.stack((kept.rows["laid_x"], kept.rows["laid_y"]), axis=1)
    differs = np.isfinite(laid[:, 0])
    assert 0.1 < differs.mean() < 0.9
    ball = np.stack((kept.rows["true_x"], kept.rows["true_y"]), axis=1)
    assert np.hypot(*(ball - laid)[differs].T).max() < 0.02
    desired = kept.followed(kept.rows["time"])[0]
    far = np.hypot(*(laid - desired)[differs].T).max()
    assert f"up to {1e3 * far:.3g} mm" in describe_run(kept)
    assert "laid_x" not in lost.rows
