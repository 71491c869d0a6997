import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction

MODEL = BallPlate()


def tilted(plant, angle):
    """The plant with its plates tilted about y and the ball at rest on the centre."""
    plant.start(np.zeros((plant.rigs, 4)))
    plant._x[:, 2] = angle
    return plant


def test_a_driven_plate_matches_an_adaptive_integration_of_the_same_equations():
    plant = ExactPlant(step=0.001)
    plant.start(np.array([[0.1, 0.05, -0.08, 0.1]]))
    rates = 0.3 * np.sin(np.arange(500) * 0.01)
    state, expected = plant.state[0], plant.state[0].copy()
    for rate in rates:
        command = np.array([[rate, -0.7 * rate]])
        u = (command[0] - expected[3::4]) / 0.002
        expected = solve_ivp(
            lambda t, x, u=u: MODEL.derivative(x, u), (0, 0.002), expected, rtol=1e-10, atol=1e-12
        ).y[:, -1]
        plant.advance(command, 2)
    state = plant.state[0]
    assert state == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("slope_deg", [0.3, 0.5])
def test_a_ball_below_its_breakaway_slope_does_not_creep(slope_deg):
    plant = tilted(ExactPlant(friction=Friction(rolling=2e-4)), np.radians(slope_deg))
    plant.advance(np.zeros((1, 2)), 2000)
    assert plant.state[0, 0] == 0.0


@pytest.mark.parametrize("slope_deg", [0.8, 2.0])
def test_a_ball_above_it_rolls_as_coulomb_says(slope_deg):
    slope, arm = np.radians(slope_deg), 2e-4
    plant = tilted(ExactPlant(friction=Friction(rolling=arm)), slope)
    plant.advance(np.zeros((1, 2)), 2000)
    pull = MODEL.c1 * 9.81 * (np.sin(slope) - arm / MODEL.radius * np.cos(slope))
    assert plant.state[0, 0] == pytest.approx(pull * 2.0**2 / 2, rel=1e-6)


def test_a_rolling_ball_stops_after_the_distance_coulomb_says_and_stays():
    arm, speed = 2e-4, 0.1
    plant = ExactPlant(friction=Friction(rolling=arm))
    plant.start(np.array([[0.0, speed * 0.6, 0.0, speed * 0.8]]))
    plant.advance(np.zeros((1, 2)), 5000)
    pull = MODEL.c1 * 9.81 * arm / MODEL.radius
    assert np.hypot(*plant.state[0, 0::4]) == pytest.approx(speed**2 / (2 * pull), rel=1e-3)
    assert plant.state[0, 1::4].tolist() == [0.0, 0.0]


def test_rigs_of_one_plant_may_have_different_friction():
    arms = np.array([0.0, 1e-4, 3e-4])
    plant = ExactPlant(rigs=3, friction=Friction(rolling=arms))
    plant.start(np.tile([0.0, 0.1, 0.0, 0.0], (3, 1)))
    plant.advance(np.zeros((3, 2)), 100)
    lost = 0.1 - plant.state[:, 1]
    assert lost == pytest.approx(MODEL.c1 * 9.81 * arms / MODEL.radius * 0.1, abs=1e-9)


def test_a_ball_that_left_the_screen_has_fallen_for_good():
    plant = ExactPlant()
    plant.start(np.array([[0.349, 1.0, 0.0, 0.0]]))
    plant.advance(np.zeros((1, 2)), 2)
    assert not plant.on_plate[0]
    plant._x[:, 0] = 0.0
    plant.advance(np.zeros((1, 2)), 2)
    assert not plant.on_plate[0]
