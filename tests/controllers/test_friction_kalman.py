import numpy as np
import pytest
from scipy.stats import chi2

from controllers.ballplate import BallPlate
from controllers.interfaces import Measurement
from controllers.observers import FrictionKalman

MODEL = BallPlate()
T = 0.002
PULSE, AMPLITUDE, BEGIN = 3.0, 0.1, 0.3


class World:
    """Balls that obey the exact model, a friction, a disturbance and an error of the tilt gain.

    The plates begin level and then swing so that the balls go round in circles; everything random
    is a random walk of the size that the observer takes it for.
    """

    def __init__(self, observer, rigs, seed=0):
        self.rng = np.random.default_rng(seed)
        self.observer, self.delay = observer, observer.delay
        variance = np.diagonal(observer._begin)
        drawn = self.rng.normal(size=(rigs, 9)) * np.sqrt(variance)
        self.d, self.kappa = drawn[:, 4:6], drawn[:, 6:8]
        self.F = np.maximum(observer._F + drawn[:, 8], 0.01)
        self.time = 0.0
        x = np.zeros((rigs, 8))
        x[:, 0::4] = drawn[:, 0:2]
        self.x = x
        self.past = [self.x]
        observer.start(np.zeros((rigs, 8)))

    @staticmethod
    def plate(t):
        """Angles and rates (phi, theta)."""
        turn, still = PULSE * t, np.exp(-((t / BEGIN) ** 2))
        way = np.array([np.cos(turn), -np.sin(turn)])
        on = PULSE * np.array([-np.sin(turn), -np.cos(turn)])
        growth = 2 * t / BEGIN**2 * still
        return AMPLITUDE * (1 - still) * way, AMPLITUDE * ((1 - still) * on + growth * way)

    def slope(self, x, u):
        out = MODEL.derivative(x, u)
        v = x[:, 1::4]
        tilt = np.stack((np.sin(x[:, 2]) * np.cos(x[:, 6]), -np.sin(x[:, 6])), axis=1)
        length = np.sqrt((v**2).sum(axis=1) + self.observer.smooth**2)
        drag = (self.F / length)[:, None] * v
        out[:, 1::4] += self.kappa * MODEL.k1 * tilt + self.d - drag
        return out

    def advance(self):
        """One control period: the input that was applied, shape (N, 2)."""
        before, after = self.plate(self.time), self.plate(self.time + T)
        u = np.tile((after[1] - before[1]) / T, (len(self.x), 1))
        x = self.x
        k1 = self.slope(x, u)
        k2 = self.slope(x + T / 2 * k1, u)
        k3 = self.slope(x + T / 2 * k2, u)
        k4 = self.slope(x + T * k3, u)
        x = x + T / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        self.time += T
        x[:, 2::4], x[:, 3::4] = after
        walk = np.array(self.observer.walk) * np.sqrt(T)
        x[:, 1::4] += walk[0] * self.rng.normal(size=(len(x), 2))
        self.d = self.d + walk[1] * self.rng.normal(size=self.d.shape)
        self.F = np.maximum(self.F + walk[2] * self.rng.normal(size=self.F.shape), 0.0)
        self.kappa = self.kappa + walk[3] * self.rng.normal(size=self.kappa.shape)
        self.x = x
        self.past.append((x, self.d, self.kappa, self.F))
        return u

    def measure(self, noise=True):
        late = self.then()[0]
        y = self.x[:, 0::2].copy()
        y[:, 0::2] = late[:, 0::4]
        if noise:
            y[:, 0::2] += np.sqrt(self.observer.R) * self.rng.normal(size=(len(y), 2))
        return Measurement(self.time, y, np.zeros(len(y)), np.ones(len(y), bool))

    def then(self):
        """State, disturbance, tilt gain and friction at the time of the touch sample."""
        back = round(self.delay / T)
        found = self.past[max(len(self.past) - 1 - back, 0)]
        return found if isinstance(found, tuple) else (found, self.d, self.kappa, self.F)

    def truth(self):
        """What the observer's own state should be, shape (N, 9)."""
        x, d, kappa, F = self.then()
        lever = MODEL.c2 * np.array([1.0, -1.0])
        eta = x[:, 0::4] + lever * x[:, 2::4]
        speed = x[:, 1::4] + lever * x[:, 3::4]
        return np.concatenate((eta, speed, d, kappa, F[:, None]), axis=1)


@pytest.fixture(scope="module")
def consistency():
    """Normalised squares of errors and innovations over 200 rigs, and the last estimates."""
    walk = (0.003, 0.02, 0.002, 0.0005)
    observer = FrictionKalman(delay=0.042, spread=(0.01, 0.015, 0.02), walk=walk)
    world = World(observer, rigs=200)
    nees, nis, carried = [], [], []
    for tick in range(1000):
        x = observer.correct(world.measure())
        if tick % 100 == 99:
            error = observer.s - world.truth()
            nees.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(observer.P), error))
            nis.append(observer.innovation**2 / observer.innovation_variance)
            carried.append(x[:, 0::4] - world.x[:, 0::4])
        observer.predict(world.advance())
    return observer, world, np.array(nees), np.array(nis), np.array(carried)


def within(values, freedom, chance=1e-4):
    """Whether the mean of values of a chi-square of such freedom is one of so many."""
    low, high = chi2.ppf([chance / 2, 1 - chance / 2], freedom * values.size) / values.size
    return low < values.mean() < high


@pytest.mark.long
def test_errors_are_as_large_as_the_filter_says_where_its_model_holds(consistency):
    _, _, nees, _, _ = consistency
    # from the end of the dead time on, rigs apart: samples of one rig are not independent
    for moment in nees[2:]:
        assert within(moment, 9)


@pytest.mark.long
def test_innovations_are_as_large_as_the_filter_says(consistency):
    _, _, _, nis, _ = consistency
    assert within(nis[2:, :, 0], 1)
    assert within(nis[2:, :, 1], 1)


def test_friction_and_tilt_gain_are_found_within_the_spread_stated(consistency):
    observer, world, *_ = consistency
    names = [quantity.name for quantity in observer.knows]
    found = dict(zip(names, observer.further.T, strict=True))
    truth = world.truth()
    for name, column in (("friction", 8), ("tilt_gain_x", 6), ("tilt_gain_y", 7)):
        apart = (found[name] - truth[:, column]) / found[f"{name}_spread"]
        assert within(apart**2, 1), name
    # and something was learnt
    assert found["friction_spread"].mean() < 0.5 * 0.015
    assert found["tilt_gain_x_spread"].mean() < 0.9 * 0.02


def test_the_dead_time_is_gone_without_a_predictor(consistency):
    *_, carried = consistency
    assert np.sqrt((carried[5:] ** 2).mean()) < 5e-4
    speed = MODEL.k1 * AMPLITUDE / PULSE
    assert speed * 0.042 > 5e-3


@pytest.mark.parametrize("delay", [0.0, 0.042, 0.0405])
def test_without_noise_the_estimate_is_the_state_of_now(delay):
    observer = FrictionKalman(delay=delay, walk=(1e-4, 1e-5, 1e-5, 1e-5))
    world = World(observer, rigs=2)
    world.x = world.past[0] = np.zeros((2, 8))
    world.d, world.kappa = np.zeros((2, 2)), np.zeros((2, 2))
    world.F = np.full(2, observer._F)
    history = [world.x]
    for _ in range(400):
        back = delay / T
        i = len(history) - 1 - int(back + 1e-9)
        share = back - int(back + 1e-9)
        late = (1 - share) * history[max(i, 0)] + share * history[max(i - 1, 0)]
        y = world.x[:, 0::2].copy()
        y[:, 0::2] = late[:, 0::4]
        x = observer.correct(Measurement(world.time, y, np.zeros(2), np.ones(2, bool)))
        observer.predict(world.advance())
        history.append(world.x)
    error = x - history[-2]
    assert np.abs(error[:, 0::4]).max() < 1e-4
    assert np.abs(error[:, 1::4]).max() < 2e-3


def test_friction_is_not_learnt_from_a_ball_that_lies_still():
    observer = FrictionKalman()
    observer.start(np.zeros((1, 8)))
    rng = np.random.default_rng(2)
    tilted = np.radians(0.4)
    before = observer.further[0, 0]
    for _ in range(1500):
        y = np.array([[0.0, tilted, 0.0, 0.0]])
        y[:, 0::2] += 3e-4 * rng.normal(size=(1, 2))
        observer.correct(Measurement(0.0, y, np.zeros(1), np.ones(1, bool)))
        observer.predict(np.zeros((1, 2)))
    assert observer.further[0, 0] == before
    assert observer.further[0, 1] < -0.01  # what holds the ball is taken for a disturbance


def test_what_holds_a_ball_at_rest_is_found_sooner_and_no_motion_is_taken_for_rest():
    quick, slow = FrictionKalman(resting_walk=0.1), FrictionKalman()
    spreads = {}
    for speed in (0.0, 0.1):
        for observer in (quick, slow):
            x = np.array([[0.0, speed, 0, 0, 0, 0, 0, 0]])
            observer.start(np.tile(x, (2, 1)))
            for _ in range(100):  # the plate is felt, the ball is not
                observer.correct(Measurement(0.0, np.zeros((2, 4)), np.zeros(2), np.zeros(2, bool)))
                observer.predict(np.zeros((2, 2)))
            spreads[speed, observer is quick] = observer.P[:, 4, 4]
    walked = 100 * T * (0.1**2 - 0.02**2)
    assert spreads[0.0, True] - spreads[0.0, False] == pytest.approx(np.full(2, walked))
    assert np.all(spreads[0.1, True] - spreads[0.1, False] < 0.01 * walked)


def test_a_frame_is_taken_once_and_as_old_as_it_is():
    observer = FrictionKalman()
    observer.start(np.zeros((1, 8)))
    y = np.array([[0.05, 0.0, 0.0, 0.0]])
    taken = []
    for tick in range(20):
        age = np.full(1, (tick % 8) * T)
        observer.correct(Measurement(tick * T, y, age, np.ones(1, bool)))
        taken.append(bool(np.isfinite(observer.innovation).all()))
        observer.predict(np.zeros((1, 2)))
    assert [tick for tick, new in enumerate(taken) if new] == [0, 8, 16]


def test_the_equivalent_angle_moves_a_ball_without_friction_alike():
    observer = FrictionKalman(delay=0.042)
    world = World(observer, rigs=3)
    for _ in range(600):
        observer.correct(world.measure())
        observer.predict(world.advance())
    s, x = observer.s, observer.equivalent
    flat = MODEL.flat(x, np.zeros((3, 2)))[:, 1::4]
    v = observer.x[:, 1::4]
    drag = s[:, 8:] * v / np.sqrt((v**2).sum(axis=1, keepdims=True) + observer.smooth**2)
    tilt = MODEL.k * np.sin(observer.x[:, 2::4])
    np.testing.assert_allclose(flat, (1 + s[:, 6:8]) * tilt + s[:, 4:6] - drag, atol=3e-3)
