import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin.sim.plant.interface import ball_in_plate
from twin.sim.plant.mechanism import Mechanism

ANGLES = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))


def turned(phi, theta):
    """R = Rx(theta) Ry(phi) (4.5), by scipy."""
    return Rotation.from_euler("XY", [theta, phi])


@settings(max_examples=50)
@given(ANGLES, ANGLES)
def test_the_rate_of_a_ball_fixed_in_the_world_is_that_of_its_turning_coordinates(plate, rate):
    ball, h = np.array([0.1, -0.05, 0.14]), 1e-6
    before, after = (
        turned(*(np.array(plate) + sign * h * np.array(rate))).inv().apply(ball)
        for sign in (-0.5, 0.5)
    )
    columns = (np.array(vector)[:, None] for vector in (plate, rate, ball, np.zeros(3)))
    seen = ball_in_plate(*columns)[:, 0]
    assert seen[:3] == pytest.approx(turned(*plate).inv().apply(ball), abs=1e-12)
    assert seen[3:] == pytest.approx((after - before) / h, abs=1e-8)


def test_many_rigs_are_seen_as_the_engines_own_sensors_see_one():
    rate = np.array([0.9, -0.6])
    one, many = Mechanism(rigs=1), Mechanism(rigs=20)
    for plant in (one, many):
        plant.start(np.tile([0.1, 0.05, -0.05, 0.1], (plant.rigs, 1)))
        for _ in range(200):
            plant.advance(np.tile(rate, (plant.rigs, 1)), 2)
    assert many.state[7] == pytest.approx(one.state[0], abs=1e-12)
    assert many.on_plate.all()


def test_a_ball_that_rolls_over_the_edge_is_off_the_plate_for_one_rig_and_for_many():
    for rigs in (1, 20):
        plant = Mechanism(rigs=rigs)
        plant.start(np.tile([0.34, 0.5, 0.0, 0.0], (rigs, 1)))
        assert plant.on_plate.all()
        plant.advance(np.zeros((rigs, 2)), 40)
        assert not plant.on_plate.any()
