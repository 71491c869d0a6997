import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import chi2

from controllers.ballplate import BallPlate
from controllers.interfaces import Measurement
from controllers.observers import FrictionKalman, FrictionMapKalman

MODEL = BallPlate()
T = 0.002
TURN, TILT, BEGIN = 3.0, 0.1, 0.3
COARSE = {"map_pitch": 0.1, "map_length": 0.08}


def reader(lines, fields):
    """Reads N fields, shape (N, n, m), at N places each in its own, shape (..., N, 2)."""
    rigs = np.arange(len(fields), dtype=float)
    read = RegularGridInterpolator((rigs, *lines), fields)
    edge = np.array([line[-1] for line in lines])

    def at(places):
        places = np.clip(places, -edge, edge)
        numbers = np.broadcast_to(rigs, places.shape[:-1])[..., None]
        return read(np.concatenate((numbers, places), axis=-1))

    return at


class World:
    """Balls that go round on screens whose friction is a field as the observer takes it for.

    Written down apart from the observer: the field is scipy's between its points, balls move in
    small steps of Euler's kind, the touch sample is that of now.
    """

    def __init__(self, observer, rigs, seed=0):
        self.observer, self.rng = observer, np.random.default_rng(seed)
        (w, h), pitch = observer.map_sides, observer.map_pitch
        self.lines = [np.linspace(-side / 2, side / 2, 1 + round(side / pitch)) for side in (w, h)]
        points = np.stack(np.meshgrid(*self.lines, indexing="ij"), axis=-1)
        flat = points.reshape(-1, 2)
        square = ((flat[:, None] - flat) ** 2).sum(axis=-1)
        prior = observer.map_spread**2 * np.exp(-square / (2 * observer.map_length**2))
        fields = self.rng.multivariate_normal(np.zeros(len(flat)), prior, size=rigs)
        self.fields = fields.reshape(rigs, *points.shape[:2])
        self.read = reader(self.lines, self.fields)
        d, F, kappa = observer.spread
        self.d = d * self.rng.normal(size=(rigs, 2))
        self.kappa = kappa * self.rng.normal(size=(rigs, 2))
        self.F = MODEL.c1 * observer.believed_mm / 1000 / MODEL.radius * MODEL.gravity
        self.F = self.F + F * self.rng.normal(size=rigs)
        self.x = np.sqrt(observer.R) * self.rng.normal(size=(rigs, 2))
        self.v = np.zeros((rigs, 2))
        self.time = 0.0
        observer.start(np.zeros((rigs, 8)))

    def plate(self, t):
        """Slopes (phi, -theta), their rates and accelerations, which turn ever more."""
        steps = np.array([t - 1e-4, t, t + 1e-4])
        share = 1 - np.exp(-((steps / BEGIN) ** 2))
        slope = TILT * share[:, None] * np.stack((np.cos(TURN * steps), np.sin(TURN * steps)), -1)
        rate = (slope[2] - slope[0]) / 2e-4
        return slope[1], rate, (slope[2] - 2 * slope[1] + slope[0]) / 1e-8

    def friction(self):
        return self.F + self.read(self.x)

    def advance(self, parts=4):
        """One control period."""
        observer, dt = self.observer, T / parts
        for _ in range(parts):
            slope, rate, bend = self.plate(self.time + dt / 2)
            x8 = self.states(slope, rate)
            u = np.tile(bend * (1, -1), (len(self.x), 1))
            a = MODEL.derivative(x8, u)[:, 1::4]
            tilt = np.stack((np.sin(x8[:, 2]) * np.cos(x8[:, 6]), -np.sin(x8[:, 6])), axis=1)
            speed = np.sqrt((self.v**2).sum(axis=1) + observer.smooth**2)
            drag = (np.maximum(self.friction(), 0) / speed)[:, None] * self.v
            a = a + self.kappa * MODEL.k1 * tilt + self.d - drag
            self.v = self.v + dt * a
            self.x = self.x + dt * self.v
            self.time += dt
        walk = np.array(observer.walk) * np.sqrt(T)
        shape = self.x.shape
        self.v = self.v + walk[0] * self.rng.normal(size=shape)
        self.d = self.d + walk[1] * self.rng.normal(size=shape)
        self.F = self.F + walk[2] * self.rng.normal(size=len(self.F))
        self.kappa = self.kappa + walk[3] * self.rng.normal(size=shape)

    def states(self, slope, rate):
        x8 = np.zeros((len(self.x), 8))
        x8[:, 0::4], x8[:, 1::4] = self.x, self.v
        x8[:, 2], x8[:, 3], x8[:, 6], x8[:, 7] = slope[0], rate[0], -slope[1], -rate[1]
        return x8

    def measurement(self, noise=True):
        slope, rate, _ = self.plate(self.time)
        y = self.states(slope, rate)[:, 0::2].copy()
        if noise:
            y[:, 0::2] += np.sqrt(self.observer.R) * self.rng.normal(size=self.x.shape)
        return Measurement(self.time, y, np.zeros(len(y)), np.ones(len(y), bool))

    def truth(self):
        """What the observer estimates, shape (N, 9 + points)."""
        slope, rate, _ = self.plate(self.time)
        eta, speed = self.x + MODEL.c2 * slope, self.v + MODEL.c2 * rate
        own = np.concatenate((eta, speed, self.d, self.kappa, self.F[:, None]), axis=1)
        return np.concatenate((own, self.fields.reshape(len(own), -1)), axis=1)


def within(values, freedom, chance=1e-4):
    """Whether the mean of values of a chi-square of such freedom is one of so many."""
    low, high = chi2.ppf([chance / 2, 1 - chance / 2], freedom * values.size) / values.size
    return low < values.mean() < high


@pytest.fixture(scope="module")
def learnt():
    """Sixty rigs after two turns."""
    observer = FrictionMapKalman(
        spread=(0.005, 0.005, 0.005), walk=(0.003, 0.003, 0.001, 0.0002), **COARSE
    )
    world = World(observer, rigs=60)
    nis, way = [], []
    for tick in range(2100):
        observer.correct(world.measurement())
        if tick % 100 == 99:
            nis.append(observer.innovation**2 / observer.innovation_variance)
            way.append(world.x)
        u = (world.plate(world.time + T)[1] - world.plate(world.time)[1]) / T
        if tick < 2099:
            world.advance()
            observer.predict(np.tile(u * (1, -1), (60, 1)))
    return observer, world, np.array(nis), np.array(way)


def test_states_and_map_are_known_as_well_as_the_filter_says(learnt):
    observer, world, nis, _ = learnt
    estimate = np.concatenate((observer.s, observer._m), axis=1)
    error = estimate - world.truth()
    P = observer.P
    for part in (slice(0, 9), slice(9, None), slice(0, None)):
        e = error[:, part]
        nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(P[:, part, part]), e)
        assert within(nees, e.shape[1]), part
    assert within(nis[1:], 1)


def test_the_map_is_found_where_the_ball_has_been(learnt):
    observer, world, _, way = learnt
    way = way[3:]
    found = reader(world.lines, observer.friction_map)(way)
    truth = world.F + world.read(way)
    wrong = np.sqrt(((found - truth) ** 2).mean())
    # one friction for all is wrong by what differs
    assert wrong < 0.5 * np.sqrt(((truth - truth.mean(axis=0)) ** 2).mean())


def test_friction_and_its_spread_are_those_of_the_place(learnt):
    observer, world, *_ = learnt
    names = [quantity.name for quantity in observer.knows]
    found = dict(zip(names, observer.further.T, strict=True))
    apart = (found["friction"] - world.friction()) / found["friction_spread"]
    assert within(apart**2, 1)
    assert found["friction_spread"].mean() < 0.4 * observer.map_spread


def test_without_unevenness_it_is_the_filter_with_one_friction():
    plain, mapped = FrictionKalman(), FrictionMapKalman(map_spread=1e-9, **COARSE)
    world = World(FrictionMapKalman(**COARSE), rigs=2)
    for observer in (plain, mapped):
        observer.start(np.zeros((2, 8)))
    for _ in range(400):
        measurement = world.measurement()
        for observer in (plain, mapped):
            observer.correct(measurement)
            observer.predict(np.zeros((2, 2)))
        world.advance(parts=1)
    np.testing.assert_allclose(mapped.s, plain.s, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(mapped.further, plain.further, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(mapped.equivalent, plain.equivalent, rtol=1e-7, atol=1e-9)


def test_rigs_together_are_as_alone():
    def make():
        return FrictionMapKalman(delay=0.042, **COARSE)

    world = World(make(), rigs=3)
    together, alone = make(), [make() for _ in range(3)]
    together.start(np.zeros((3, 8)))
    for observer in alone:
        observer.start(np.zeros(8))
    for tick in range(120):
        t, y = world.measurement()[:2]
        # frames come at their own time in one of them, another is not touched for a while
        age = np.array([0.0, (tick % 8) * T, 0.0])
        touched = np.array([True, True, tick % 50 < 40])
        x = together.correct(Measurement(t, y, age, touched))
        together.predict(np.zeros((3, 2)))
        for rig, observer in enumerate(alone):
            single = observer.correct(Measurement(t, y[rig], age[rig], touched[rig]))
            observer.predict(np.zeros(2))
            np.testing.assert_allclose(single, x[rig], rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(observer.further, together.further[rig], rtol=1e-7)
        world.advance(parts=1)


def test_the_covariance_is_that_of_the_whole_state_written_out():
    observer = FrictionMapKalman(**COARSE)
    world = World(FrictionMapKalman(**COARSE), rigs=2)
    observer.start(np.zeros(8))
    for _ in range(300):
        t, y = world.measurement()[:2]
        observer.correct(Measurement(t, y[0], np.zeros(()), np.ones((), bool)))
        world.advance(parts=1)
    before, s, m = observer.P, observer.s, observer._m[0]

    # no touch: the covariance is only carried on
    t, y = world.measurement()[:2]
    begin = observer._ball._then
    observer.correct(Measurement(t, y[0], np.zeros(()), np.zeros((), bool)))
    place = np.array(observer._ball.position(s.tolist(), begin))
    unit = np.eye(len(m)).reshape(len(m), *(len(line) for line in world.lines))
    share = np.array([RegularGridInterpolator(world.lines, each)(place)[0] for each in unit])
    v = np.array(observer._ball.velocity(s.tolist(), begin))
    assert np.hypot(*v) > 0.05
    length = np.sqrt(v @ v + observer.smooth**2)
    h = v / length
    F = s[8] + share @ m
    A = np.eye(9 + len(m))
    A[0:2, 2:4] += T * np.eye(2)
    A[2:4, 4:6] += T * np.eye(2)
    A[2:4, 2:4] += T * F / length * (np.outer(h, h) - np.eye(2))
    A[2:4, 8] = -T * h
    A[2:4, 9:] = -T * np.outer(h, share)
    # what the tilt gain does to the speed is the only part taken from the observer
    then = observer._ball._then
    A[2, 6], A[3, 7] = then.speed_x - begin.speed_x, then.speed_y - begin.speed_y
    Q = np.zeros(9 + len(m))
    Q[:9] = observer._Q
    np.testing.assert_allclose(observer.P, A @ before @ A.T + np.diag(Q), rtol=1e-7, atol=1e-16)


def test_nothing_is_learnt_from_a_ball_that_lies_still():
    observer = FrictionMapKalman(**COARSE)
    observer.start(np.zeros((1, 8)))
    rng = np.random.default_rng(2)
    before = observer.friction_map
    for _ in range(600):
        y = np.array([[0.0, np.radians(0.4), 0.0, 0.0]])
        y[:, 0::2] += 3e-4 * rng.normal(size=(1, 2))
        observer.correct(Measurement(0.0, y, np.zeros(1), np.ones(1, bool)))
        observer.predict(np.zeros((1, 2)))
    assert np.array_equal(observer.friction_map, before)


def test_a_ball_that_has_run_away_is_nowhere_and_the_others_go_on():
    together, alone = FrictionMapKalman(**COARSE), FrictionMapKalman(**COARSE)
    together.start(np.zeros((2, 8)))
    alone.start(np.zeros(8))
    for tick in range(5):
        y = np.array([[0.01, 0.0, 0.02, 0.0], [np.nan if tick > 2 else 0.01, 0.0, 0.02, 0.0]])
        x = together.correct(Measurement(0.0, y, np.zeros(2), np.ones(2, bool)))
        single = alone.correct(Measurement(0.0, y[1], np.zeros(()), np.ones((), bool)))
        together.predict(np.zeros((2, 2)))
        alone.predict(np.zeros(2))
    assert np.isfinite(x[0]).all()
    assert np.isnan(x[1, 0])
    assert np.isnan(single[0])
