"""`twin.sim.plant.friction`.

The friction object and the surface map, against their own definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from twin.base.errors import ModelError
from twin.sim.plant.friction import SCREEN_SIZE_M, Friction, SurfaceMap, resist

MODEL = BallPlate()
FRICTION = Friction(rolling=2e-4, breakaway_ratio=1.5, stribeck_speed=0.01, dwell_time=0.3)

speeds = st.floats(0, 1)
shares = st.floats(0, 1)


@settings(max_examples=25)
@given(speed=speeds, age=shares, time=st.floats(1e-3, 3))
def test_the_age_of_a_contact_solves_its_differential_equation(speed, age, time):
    def rate(_t, a):
        return (1 - a * (1 + (speed / 0.01) ** 2)) / 0.3

    exact = solve_ivp(rate, (0, time), [age], method="LSODA", rtol=1e-8, atol=1e-10).y[0, -1]
    assert FRICTION.aged(np.array(age), np.array(speed), time) == pytest.approx(exact, abs=1e-6)


@given(speed=speeds, age=shares)
def test_without_dwell_the_age_is_the_settled_one_at_once(speed, age):
    friction = Friction(rolling=2e-4, breakaway_ratio=1.5)
    aged = friction.aged(np.array(age), np.array(speed), 1e-3)
    assert aged == friction.settled(np.array(speed))


def test_the_arm_falls_from_breakaway_through_half_its_surplus_to_rolling():
    place = np.zeros((3, 2))
    arm = FRICTION.arm(np.array([0.0, 0.01, 1e3]), place)
    assert arm == pytest.approx([3e-4, 2.5e-4, 2e-4])


def test_the_viscous_arm_grows_with_speed():
    friction = Friction(rolling=1e-4, viscous=2e-3)
    arm = friction.arm(np.array([0.0, 0.1]), np.zeros((2, 2)))
    assert arm == pytest.approx([1e-4, 3e-4])


@given(pull=st.floats(0, 1), heading=st.floats(-np.pi, np.pi))
def test_a_resting_ball_is_held_by_at_most_the_breakaway_resistance(pull, heading):
    x = np.zeros(8)
    free = pull * np.cos(heading), pull * np.sin(heading)
    limit = MODEL.c1 * MODEL.gravity * 3e-4 / MODEL.radius
    left = np.hypot(*resist(FRICTION.deceleration(MODEL, x), (x[1], x[5]), free))
    assert left == pytest.approx(max(0.0, pull - limit), abs=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rolling": -1e-4},
        {"rolling": np.nan},
        {"breakaway_ratio": 0.9},
        {"stribeck_speed": 0.0},
        {"dwell_time": -1.0},
        {"viscous": np.array([0.0, np.inf])},
    ],
)
def test_an_impossible_number_is_refused_in_one_line_that_names_it(wrong):
    with pytest.raises(ModelError) as caught:
        Friction(**wrong)
    assert next(iter(wrong)) in str(caught.value)
    assert "\n" not in str(caught.value)


@given(
    x=st.floats(-SCREEN_SIZE_M[0] / 2, SCREEN_SIZE_M[0] / 2),
    y=st.floats(-SCREEN_SIZE_M[1] / 2, SCREEN_SIZE_M[1] / 2),
    lines=st.tuples(st.integers(2, 6), st.integers(2, 6)),
)
def test_a_map_of_a_bilinear_function_is_that_function_everywhere(x, y, lines):
    def friction_at(a, b):
        return 1 + 0.5 * a - 0.7 * b + 2 * a * b

    along, across = (
        np.linspace(-side / 2, side / 2, n) for side, n in zip(SCREEN_SIZE_M, lines, strict=True)
    )
    surface = SurfaceMap(relative=friction_at(along[:, None], across))
    assert surface(np.array([[x, y]]))[0] == pytest.approx(friction_at(x, y))


def test_an_inclined_plane_slopes_the_same_everywhere():
    x, y = (np.linspace(-side / 2, side / 2, 5) for side in SCREEN_SIZE_M)
    surface = SurfaceMap(height=0.01 * x[:, None] - 0.02 * y)
    places = np.random.default_rng(0).uniform(-0.19, 0.19, (20, 2))
    assert surface(places)[1] == pytest.approx(np.tile([0.01, -0.02], (20, 1)))


def test_a_screen_drawn_at_random_has_the_spread_and_slope_it_was_asked_for():
    places = np.random.default_rng(1).uniform(-0.5, 0.5, (4000, 2)) * SCREEN_SIZE_M
    relative, slope = (
        SurfaceMap.random(seed=3, patch=0.01, spread=0.2, slope=1e-3).grids[0, ..., 0],
        SurfaceMap.random(seed=3, patch=0.01, spread=0.2, slope=1e-3)(places)[1],
    )
    assert np.std(np.log(relative)) == pytest.approx(0.2, rel=0.05)
    assert relative.mean() == pytest.approx(1, abs=0.02)
    # between grid points the slope is straight, so its mean square is a little less
    assert 0.6e-3 < np.sqrt((slope**2).mean()) < 1.01e-3


@pytest.mark.parametrize(
    "grids",
    [
        {},
        {"relative": np.ones((1, 4))},
        {"relative": np.ones((2, 3)), "height": np.ones((3, 2))},
        {"relative": -np.ones((2, 2))},
        {"height": np.full((2, 2), np.nan)},
    ],
)
def test_a_grid_that_is_no_map_is_refused(grids):
    with pytest.raises(ModelError, match=r"map|relative"):
        SurfaceMap(**grids)
