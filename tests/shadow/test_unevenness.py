"""What nobody knows of the friction acts along the ball's way, all else in any direction."""

from __future__ import annotations

import numpy as np
import pytest

from twin.shadow.friction_map import STRETCH, directed, turned, unforeseen

STEP = 0.004
COUNT = 250


def forces(heading, along=0.01, across=0.0):
    velocity = np.broadcast_to(np.reshape(heading, (1, 2, 1)), (COUNT + 1, 2, 1))
    return directed(velocity, STEP, along, across)


@pytest.mark.parametrize(("along", "across"), [(0.01, 0.0), (0.0, 0.002), (0.01, 0.002)])
def test_a_spread_is_that_of_balls_pushed_at_random(along, across):
    rng = np.random.default_rng(3)
    heading = np.array([0.6, -0.8])
    stretch = round(STRETCH / STEP)
    places = np.zeros((20_000, 2))
    for begin in range(0, COUNT, stretch):
        lasting = (min(begin + stretch, COUNT) - begin) * STEP
        left = (COUNT - begin) * STEP - lasting
        pushed = along * rng.standard_normal((len(places), 1)) * heading
        pushed = pushed + across * rng.standard_normal((len(places), 2))
        places += pushed * (lasting**2 / 2 + lasting * left)
    (predicted,) = unforeseen(forces(0.05 * heading, along, across), COUNT * STEP)
    assert predicted == pytest.approx(np.cov(places.T), abs=0.05 * np.trace(predicted))


def test_friction_that_nobody_knows_moves_no_ball_at_rest():
    assert not unforeseen(forces((0.0, 0.0)), 1.0).any()
    assert unforeseen(forces((0.0, 0.0), across=0.001), 1.0)[0, 0, 0] > 0


def test_columns_of_unit_accelerations_become_those_of_the_unknown_ones():
    there = forces((0.05, 0.0), 0.01, 0.002)
    columns = np.arange(2.0 * 2 * there.shape[1]).reshape(1, 2, -1)
    found = turned(columns, there)
    assert found[..., 0::2] == pytest.approx(np.hypot(0.01, 0.002) * columns[..., 0::2])
    assert found[..., 1::2] == pytest.approx(0.002 * columns[..., 1::2])
    assert turned(columns[0], there) == pytest.approx(found)
