"""`controllers.observers.friction`.

Observers of a rolling ball's friction, and of its map, on balls that obey what they assume."""

import copy

import numpy as np
import pytest
from observing import measured, normalised, within
from scipy.interpolate import RegularGridInterpolator

from controllers.ballplate import BallPlate
from controllers.interfaces import catalog_settings
from controllers.observers import FrictionKalman, FrictionMapKalman
from controllers.observers.friction import EstimateBounds, ImpactTest
from controllers.observers.plate_estimates import LagSearch

MODEL = BallPlate()
T = 0.002
PULSE, AMPLITUDE, BEGIN = 3.0, 0.1, 0.3
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
    """Balls that obey the exact model, a friction, a disturbance and an error of the tilt gain.

    The plates begin level and then swing so that the balls go round in circles; everything random
    is of the size that the observer takes it for, and so is, for one that learns a map, a field
    over the screen that is added to the friction: scipy's between its points.
    """

    def __init__(self, observer, rigs, seed=0):
        self.rng, self.observer, self.time = np.random.default_rng(seed), observer, 0.0
        d, F, kappa = observer.spread
        self.d, self.kappa = d * self.normal(rigs, 2), kappa * self.normal(rigs, 2)
        believed = MODEL.c1 * observer.believed_mm / 1000 / MODEL.radius * MODEL.gravity
        self.F = np.maximum(believed + F * self.normal(rigs), 0.01)
        self.x = np.zeros((rigs, 8))
        self.x[:, 0::4] = np.sqrt(observer.R) * self.normal(rigs, 2)
        self.fields = np.zeros((rigs, 0))
        self.read = lambda places: 0.0
        if isinstance(observer, FrictionMapKalman):
            self.draw_fields(observer, rigs)
        self.past = [(self.x, self.d, self.kappa, self.F)]
        observer.start(np.zeros((rigs, 8)))

    def normal(self, *shape):
        return self.rng.normal(size=shape)

    def draw_fields(self, observer, rigs):
        sides = [np.array([-side, side]) / 2 for side in observer.map_sides]
        counts = [1 + round(side / observer.map_pitch) for side in observer.map_sides]
        self.lines = [np.linspace(*ends, n) for ends, n in zip(sides, counts, strict=True)]
        points = np.stack(np.meshgrid(*self.lines, indexing="ij"), axis=-1).reshape(-1, 2)
        square = ((points[:, None] - points) ** 2).sum(axis=-1)
        prior = observer.map_spread**2 * np.exp(-square / (2 * observer.map_length**2))
        self.fields = self.rng.multivariate_normal(np.zeros(len(points)), prior, size=rigs)
        self.read = reader(self.lines, self.fields.reshape(rigs, *counts))

    @staticmethod
    def plate(t):
        """Angles and rates (phi, theta)."""
        turn, still = PULSE * t, np.exp(-((t / BEGIN) ** 2))
        way = np.array([np.cos(turn), -np.sin(turn)])
        on = PULSE * np.array([-np.sin(turn), -np.cos(turn)])
        growth = 2 * t / BEGIN**2 * still
        return AMPLITUDE * (1 - still) * way, AMPLITUDE * ((1 - still) * on + growth * way)

    def friction(self, x):
        return np.maximum(self.F + self.read(x[:, 0::4]), 0.0)

    def slope(self, x, u):
        out = MODEL.derivative(x, u)
        v = x[:, 1::4]
        tilt = np.stack((np.sin(x[:, 2]) * np.cos(x[:, 6]), -np.sin(x[:, 6])), axis=1)
        length = np.sqrt((v**2).sum(axis=1) + self.observer.smooth**2)
        drag = (self.friction(x) / length)[:, None] * v
        out[:, 1::4] += self.kappa * MODEL.k1 * tilt + self.d - drag
        return out

    def advance(self):
        """One control period, by the midpoint rule; the input that was applied, shape (N, 2)."""
        before, after = self.plate(self.time), self.plate(self.time + T)
        u = np.tile((after[1] - before[1]) / T, (len(self.x), 1))
        x = self.x + T * self.slope(self.x + T / 2 * self.slope(self.x, u), u)
        self.time += T
        x[:, 2::4], x[:, 3::4] = after
        walk = np.array(self.observer.walk) * np.sqrt(T)
        x[:, 1::4] += walk[0] * self.normal(len(x), 2)
        self.d = self.d + walk[1] * self.normal(*self.d.shape)
        self.F = np.maximum(self.F + walk[2] * self.normal(len(x)), 0.0)
        self.kappa = self.kappa + walk[3] * self.normal(*self.kappa.shape)
        self.x = x
        self.past.append((x, self.d, self.kappa, self.F))
        return u

    def then(self):
        """State, disturbance, tilt gain and friction at the time of the touch sample."""
        return self.past[max(len(self.past) - 1 - round(self.observer.delay / T), 0)]

    def measure(self):
        y = self.x[:, 0::2].copy()
        y[:, 0::2] = self.then()[0][:, 0::4]
        y[:, 0::2] += np.sqrt(self.observer.R) * self.normal(len(y), 2)
        return measured(y)

    def truth(self):
        """What the observer's own state should be, shape (N, 9 + points)."""
        x, d, kappa, F = self.then()
        lever = MODEL.c2 * np.array([1.0, -1.0])
        eta = x[:, 0::4] + lever * x[:, 2::4]
        speed = x[:, 1::4] + lever * x[:, 3::4]
        return np.concatenate((eta, speed, d, kappa, F[:, None], self.fields), axis=1)


def unsampled(observer, measurement):
    """What the observer would be after a measurement without its touch sample."""
    unseen = copy.deepcopy(observer)
    unseen.correct(measurement._replace(touched=np.zeros(len(measurement.y), bool)))
    return unseen


def innovations_squared(observer, world, measurement):
    """Of the sample that comes, over the variance that the filter expects of it, shape (N, 2)."""
    unseen = unsampled(observer, measurement)
    lever = MODEL.c2 * np.array([1.0, -1.0])
    expected = unseen.s[:, :2] - lever * world.then()[0][:, 2::4]
    variance = np.diagonal(unseen.P, axis1=1, axis2=2)[:, :2] + observer.R
    return (measurement.y[:, 0::2] - expected) ** 2 / variance


def name_quantities(observer):
    """What an observer knows beyond the state, by name."""
    names = [quantity.name for quantity in observer.knows]
    return dict(zip(names, observer.further.T, strict=True))


def estimates_of(observer, ys, *, touched=True):
    """Estimates of rigs that are shown measurements, shape (K, ..., 4), and told of no input."""
    found = []
    for y in ys:
        found.append(observer.correct(measured(y, touched)))
        observer.predict(np.zeros((*y.shape[:-1], 2)))
    return np.array(found)


def followed(observer, rigs, ticks):
    """Observer and world after so many ticks; of every 100th innovations, errors and states."""
    world, moments = World(observer, rigs), []
    for tick in range(ticks):
        if tick:
            observer.predict(world.advance())
        sample = world.measure()
        if tick % 100 < 99:
            observer.correct(sample)
            continue
        nis = innovations_squared(observer, world, sample)
        observer.correct(sample)
        error = normalised(observer.s - world.truth()[:, :9], observer.P[:, :9, :9])
        moments.append((nis, error, world.x))
    return observer, world, *map(np.array, zip(*moments, strict=True))


@pytest.fixture(scope="module")
def consistency():
    """Two hundred rigs after two seconds."""
    walk = (0.003, 0.02, 0.002, 0.0005)
    observer = FrictionKalman(delay=0.042, spread=(0.01, 0.015, 0.02), walk=walk)
    return followed(observer, rigs=200, ticks=1000)


@pytest.mark.long
def test_errors_and_innovations_are_as_large_as_the_filter_says(consistency):
    _, _, nis, errors, _ = consistency
    # from the end of the dead time on, rigs apart: samples of one rig are not independent
    for moment in errors[2:]:
        assert within(moment, 9)
    assert within(nis[2:, :, 0], 1)
    assert within(nis[2:, :, 1], 1)


@pytest.mark.long
def test_friction_and_tilt_gain_are_found_within_the_spread_stated(consistency):
    observer, world, *_ = consistency
    found, truth = name_quantities(observer), world.truth()
    for name, column in (("friction", 8), ("tilt_gain_x", 6), ("tilt_gain_y", 7)):
        apart = (found[name] - truth[:, column]) / found[f"{name}_spread"]
        assert within(apart**2, 1), name
    # and something was learnt
    assert found["friction_spread"].mean() < 0.5 * 0.015
    assert found["tilt_gain_x_spread"].mean() < 0.9 * 0.02


@pytest.mark.short("0.0405")
@pytest.mark.parametrize("delay", [0.0, 0.042, 0.0405])
def test_without_noise_the_estimate_is_the_state_of_now(delay):
    quiet = {"walk": (1e-4, 1e-5, 1e-5, 1e-5), "spread": (1e-9, 1e-9, 1e-9)}
    observer = FrictionKalman(delay=delay, **quiet)
    world = World(observer, rigs=2)
    world.x = np.zeros((2, 8))
    whole, share = int(delay / T + 1e-9), delay / T - int(delay / T + 1e-9)
    history = [world.x]
    for _ in range(400):
        newer, older = (history[max(len(history) - 1 - n, 0)] for n in (whole, whole + 1))
        y = world.x[:, 0::2].copy()
        y[:, 0::2] = ((1 - share) * newer + share * older)[:, 0::4]
        x = observer.correct(measured(y))
        observer.predict(world.advance())
        history.append(world.x)
    error = x - history[-2]
    assert np.abs(error[:, 0::4]).max() < 1e-4
    assert np.abs(error[:, 1::4]).max() < 2e-3


@pytest.mark.parametrize("observer", [FrictionKalman(), FrictionMapKalman(**COARSE)])
def test_friction_is_not_learnt_from_a_ball_that_lies_still(observer):
    observer.start(np.zeros((1, 8)))
    before = observer.further[0, 0], getattr(observer, "friction_map", 0)
    y = np.tile([0.0, np.radians(0.4), 0.0, 0.0], (600, 1, 1))
    y[..., 0::2] += 3e-4 * np.random.default_rng(2).normal(size=(600, 1, 2))
    estimates_of(observer, y)
    assert observer.further[0, 0] == before[0]
    assert np.array_equal(getattr(observer, "friction_map", 0), before[1])
    assert observer.further[0, 1] < -0.01  # what holds the ball is taken for a disturbance


def test_what_holds_a_ball_at_rest_is_found_sooner_and_no_motion_is_taken_for_rest():
    quick, slow = FrictionKalman(resting_walk=0.1, keep_at_rest=True), FrictionKalman()
    spreads, learnt = {}, {}
    for speed in (0.0, 0.1):
        for observer in (quick, slow):
            observer.start(np.tile([0.0, speed, 0, 0, 0, 0, 0, 0], (2, 1)))
            estimates_of(observer, np.zeros((100, 2, 4)), touched=False)  # the plate is felt
            spreads[speed, observer is quick] = observer.P[:, 4, 4]
            learnt[speed, observer is quick] = np.diagonal(observer.P, axis1=1, axis2=2)[:, 6:]
    walked = 100 * T * (0.1**2 - 0.02**2)
    assert spreads[0.0, True] - spreads[0.0, False] == pytest.approx(np.full(2, walked))
    assert np.all(spreads[0.1, True] - spreads[0.1, False] < 0.01 * walked)
    # tilt gain and friction, of which a ball at rest tells nothing, do not go on meanwhile
    begun, walks = np.square((0.02, 0.02, 0.03)), 100 * T * np.square((0.0005, 0.0005, 0.005))
    np.testing.assert_allclose(learnt[0.0, True], [begun] * 2, rtol=1e-9)
    np.testing.assert_allclose(learnt[0.1, True], [begun + walks] * 2, rtol=1e-3)
    np.testing.assert_allclose(learnt[0.0, False], [begun + walks] * 2, rtol=1e-9)


@pytest.mark.parametrize("forgets", [False, True])
def test_what_held_a_ball_at_rest_is_forgotten_once_it_comes_free(forgets):
    forget_rest = 0.05 if forgets else None
    observer = FrictionKalman(resting_walk=0.03, keep_at_rest=True, forget_rest=forget_rest)
    observer.start(np.zeros((1, 8)))
    push, believed = MODEL.k1 * np.sin(np.radians(1.0)), name_quantities(observer)["friction"][0]
    y = np.tile([0.0, np.radians(1.0), 0.0, 0.0], (1275, 1, 1))
    speed = T * (push - believed) * np.arange(1, 276)
    y[1000:, 0, 0] = T * np.cumsum(speed)  # its breakaway friction is behind it
    estimates_of(observer, y[:1000])
    assert observer.s[0, 4] == pytest.approx(-push, rel=0.2)
    estimates_of(observer, y[1000:])
    # the level is right: all that held it was friction; else that of motion is learnt wrongly
    assert (abs(observer.s[0, 4]) < 0.05 * push) == forgets
    assert (abs(observer.s[0, 8] / believed - 1) < 0.05) == forgets


def test_what_a_plate_turns_faster_than_it_was_told_is_known_of_each_axis():
    observer, rates = FrictionKalman(), np.array([0.01, -0.02])
    observer.start(np.zeros((1, 8)))
    y = np.zeros((500, 1, 4))
    y[:, 0, 1::2] = T * np.outer(range(500), rates)
    estimates_of(observer, y)
    found = name_quantities(observer)
    bias = [found["plate_bias_x"][0], found["plate_bias_y"][0]]
    np.testing.assert_allclose(bias, rates, rtol=1e-3)


def test_a_frame_is_taken_once_and_as_old_as_it_is():
    observer = FrictionKalman()
    observer.start(np.zeros((1, 8)))
    y = np.array([[0.05, 0.0, 0.0, 0.0]])
    taken = []
    for tick in range(20):
        sample = measured(y)._replace(age=np.full(1, (tick % 8) * T))
        unseen = unsampled(observer, sample)
        observer.correct(sample)
        taken.append(not np.array_equal(observer.P, unseen.P))
        observer.predict(np.zeros((1, 2)))
    assert [tick for tick, new in enumerate(taken) if new] == [0, 8, 16]


@pytest.mark.long
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


@pytest.fixture(scope="module")
def learnt():
    """Sixteen rigs with a map after two turns."""
    walk = (0.003, 0.003, 0.001, 0.0002)
    observer = FrictionMapKalman(spread=(0.005, 0.005, 0.005), walk=walk, **COARSE)
    return followed(observer, rigs=16, ticks=2100)


@pytest.mark.long
def test_states_and_map_are_known_as_well_as_the_filter_says(learnt):
    observer, world, nis, *_ = learnt
    more = observer.friction_map.reshape(len(world.x), -1) - observer.s[:, 8:]
    error = np.concatenate((observer.s, more), axis=1) - world.truth()
    for part in (slice(0, 9), slice(9, None), slice(0, None)):
        e = error[:, part]
        assert within(normalised(e, observer.P[:, part, part]), e.shape[1]), part
    assert within(nis[1:], 1)


@pytest.mark.long
def test_the_map_is_found_where_the_ball_has_been(learnt):
    observer, world, *_, states = learnt
    way = states[3:, :, 0::4]
    found = reader(world.lines, observer.friction_map)(way)
    truth = world.F + world.read(way)
    wrong = np.sqrt(((found - truth) ** 2).mean())
    # one friction for all is wrong by what differs
    assert wrong < 0.5 * np.sqrt(((truth - truth.mean(axis=0)) ** 2).mean())


@pytest.mark.long
def test_friction_and_its_spread_are_those_of_the_place(learnt):
    observer, world, *_ = learnt
    found = name_quantities(observer)
    apart = (found["friction"] - world.friction(world.x)) / found["friction_spread"]
    assert within(apart**2, 1)
    assert found["friction_spread"].mean() < 0.4 * observer.map_spread


@pytest.mark.long
def test_without_unevenness_it_is_the_filter_with_one_friction():
    plain, mapped = FrictionKalman(), FrictionMapKalman(map_spread=1e-9, **COARSE)
    world = World(FrictionMapKalman(**COARSE), rigs=2)
    for observer in (plain, mapped):
        observer.start(np.zeros((2, 8)))
    for _ in range(200):
        measurement = world.measure()
        for observer in (plain, mapped):
            observer.correct(measurement)
            observer.predict(np.zeros((2, 2)))
        world.advance()
    np.testing.assert_allclose(mapped.s, plain.s, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(mapped.further, plain.further, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(mapped.equivalent, plain.equivalent, rtol=1e-7, atol=1e-9)


class Cambered(World):
    """Balls on plates that are cambered."""

    def slope(self, x, u):
        out = super().slope(x, u)
        out[:, 1::4] += np.array([0.6, -0.4]) * x[:, 0::4]
        return out


@pytest.mark.long
def test_the_camber_of_a_plate_is_found_and_the_disturbance_is_that_of_the_place():
    walk = (0.003, 0.003, 0.001, 0.0002)
    # an error of the tilt gain looks like a camber at one speed: here it is known
    given = {"spread": (0.005, 0.005, 0.001), "walk": walk}
    observer = FrictionMapKalman(camber_spread=0.3, **given, **COARSE)
    world = Cambered(observer, rigs=2)
    for _ in range(2100):  # two turns
        observer.correct(world.measure())
        observer.predict(world.advance())
    np.testing.assert_allclose(observer.camber, np.tile((0.6, -0.4), (2, 1)), atol=0.1)
    found = name_quantities(observer)
    assert np.array_equal(found["camber_x"], observer.camber[:, 0])
    place = world.x[:, 0::4]
    local = world.d + (0.6, -0.4) * place
    seen_there = np.stack((found["disturbance_x"], found["disturbance_y"]), axis=1)
    far = np.abs((0.6, -0.4) * place).max()
    assert far > 0.02
    assert np.abs(seen_there - local).max() < 0.6 * far


def test_what_a_turned_screen_shows_is_turned_back():
    turn, straight, turned = np.radians(3.0), FrictionKalman(), FrictionKalman(screen_deg=3.0)
    R = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    y = np.zeros((300, 1, 4))
    t = T * np.arange(300)
    y[:, 0, 0], y[:, 0, 2] = 0.1 * np.sin(t), 0.05 * t
    on_screen = y.copy()
    on_screen[..., 0::2] = y[..., 0::2] @ R.T
    for observer in (straight, turned):
        observer.start(np.zeros((1, 8)))
    np.testing.assert_allclose(
        estimates_of(turned, on_screen), estimates_of(straight, y), atol=1e-9
    )


def test_a_plate_that_is_taken_for_flat_has_no_camber():
    for observer in (FrictionKalman(), FrictionMapKalman(**COARSE)):
        observer.start(np.zeros((2, 8)))
        assert not observer.camber.any()
        assert not name_quantities(observer)["camber_x"].any()


@pytest.mark.short("0.0")
@pytest.mark.parametrize("camber", [0.0, 0.3])
def test_the_covariance_is_that_of_the_whole_state_written_out(camber):
    observer = FrictionMapKalman(camber_spread=camber, **COARSE)
    world = World(FrictionMapKalman(**COARSE), rigs=2)
    observer.start(np.zeros(8))
    for _ in range(300):
        observer.correct(measured(world.measure().y[0]))
        world.advance()
    before, s, every = observer.P, observer.s, observer._m[0]
    m, c = (every[:-2], every[-2:]) if camber else (every, np.zeros(2))

    # no touch: the covariance is only carried on
    begin = observer._ball.then
    observer.correct(measured(world.measure().y[0], touched=False))
    place = np.array(observer._ball.position(s.tolist(), begin))
    unit = np.eye(len(m)).reshape(len(m), *(len(line) for line in world.lines))
    share = np.array([RegularGridInterpolator(world.lines, each)(place)[0] for each in unit])
    v = np.array(observer._ball.velocity(s.tolist(), begin))
    assert np.hypot(*v) > 0.05
    length = np.sqrt(v @ v + observer.smooth**2)
    h = v / length
    F = s[8] + share @ m
    A = np.eye(9 + len(every))
    A[0:2, 2:4] += T * np.eye(2)
    A[2:4, 4:6] += T * np.eye(2)
    A[2:4, 2:4] += T * F / length * (np.outer(h, h) - np.eye(2))
    A[2:4, 8] = -T * h
    A[2:4, 9 : 9 + len(m)] = -T * np.outer(h, share)
    if camber:
        assert c.any()
        A[2:4, -2:] = T * np.diag(place)
    # what the tilt gain does to the speed is the only part taken from the observer
    then = observer._ball.then
    A[2, 6], A[3, 7] = then.speed_x - begin.speed_x, then.speed_y - begin.speed_y
    Q = np.zeros(9 + len(every))
    Q[:9] = observer._Q
    np.testing.assert_allclose(observer.P, A @ before @ A.T + np.diag(Q), rtol=1e-7, atol=1e-16)


class Textbook:
    """The filter of one rig in full matrices: z = A z, P = A P A' + Q, K = P H' S^-1.

    What the plate does is read from the observer; all else is calculated here.
    """

    def __init__(self, observer, lines, rig):
        self.observer, self.lines, self.rig = observer, lines, rig
        self.P = observer.P[rig].copy()
        self.z = np.zeros(len(self.P))
        self.z[8] = self.believed = observer.s[rig, 8]
        self.points = observer.friction_map[rig].size

    def step(self, begin, then, seen):
        """A period, and where ``seen`` is one, a touch sample (x, y) after it."""
        observer, z = self.observer, self.z
        begin, then = ({name: value[self.rig] for name, value in t.items()} for t in (begin, then))
        lever = MODEL.c2 * np.array([-1.0, 1.0])
        place = z[0:2] + lever * (begin["phi"], begin["theta"])
        v = z[2:4] + lever * (begin["phi_rate"], begin["theta_rate"])
        # hats about the points of the grid
        hats = [
            np.maximum(1 - abs(np.clip(at, *line[[0, -1]]) - line) / (line[1] - line[0]), 0)
            for at, line in zip(place, self.lines, strict=True)
        ]
        share, map_part = np.outer(*hats).ravel(), slice(9, 9 + self.points)
        length = np.sqrt(v @ v + observer.smooth**2)
        h, F = v / length, max(z[8] + share @ z[map_part], 0.0)
        speed, way = (
            np.array([then[f"{name}_{axis}"] - begin[f"{name}_{axis}"] for axis in "xy"])
            for name in ("speed", "way")
        )
        way -= T * np.array([begin["speed_x"], begin["speed_y"]])
        force = z[4:6] - F * h
        A = np.eye(len(z))
        A[0:2, 2:4] = A[2:4, 4:6] = T * np.eye(2)
        A[2:4, 2:4] += T * F / length * (np.outer(h, h) - np.eye(2))
        A[2:4, 8], A[2:4, map_part] = -T * h, -T * np.outer(h, share)
        A[2:4, 6:8] = np.diag(speed)
        if len(z) > 9 + self.points:
            force += z[-2:] * place
            A[2:4, -2:] = T * np.diag(place)
        z[0:2] += T * z[2:4] + (1 + z[6:8]) * way + T**2 / 2 * force
        z[2:4] += (1 + z[6:8]) * speed + T * force
        velocity, disturbance, friction_walk, gain = observer.walk
        walks = [*np.repeat((0.0, velocity, disturbance, gain), 2), friction_walk]
        self.P = A @ self.P @ A.T + np.diag(np.pad(T * np.square(walks), (0, len(z) - 9)))
        if seen is None:
            return
        S = self.P[:2, :2] + np.diag(observer.R)
        K = self.P[:, :2] @ np.linalg.inv(S)
        v = z[2:4] + lever * (then["phi_rate"], then["theta_rate"])
        change = K @ (seen - z[0:2] - lever * (then["phi"], then["theta"]))
        fall = K @ S @ K.T
        if v @ v < observer.learning_speed**2:
            change[6:], fall[6:, 6:] = 0.0, 0.0
        self.z, self.P = z + change, self.P - fall
        bounds = observer.bounds.tilt_gain_error, observer.bounds.camber_per_s2
        for part, bound in zip((slice(6, 8), slice(9 + self.points, None)), bounds, strict=True):
            self.z[part] = np.clip(self.z[part], -bound, bound)
        self.z[8] = np.clip(self.z[8], 0.0, observer.most_friction * self.believed)


def alike(found, truth):
    """Within 1e-9 of the largest number there is."""
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-9 * np.abs(truth).max())


@pytest.mark.short("0.0-1-470")
@pytest.mark.parametrize(
    ("camber", "rigs", "ticks"),
    [
        (0.0, 1, 470),
        (0.3, 3, 470),
        *(
            pytest.param(camber, rigs, 600, marks=pytest.mark.long)
            for camber in (0.0, 0.3)
            for rigs in (1, 3)
        ),
    ],
)
def test_estimate_and_covariance_are_those_of_a_textbook_filter_in_full_matrices(
    camber, rigs, ticks
):
    observer = FrictionMapKalman(camber_spread=camber, **COARSE)
    world = World(FrictionMapKalman(**COARSE), rigs=rigs)
    observer.start(np.zeros((rigs, 8)))
    books = [Textbook(observer, world.lines, rig) for rig in range(rigs)]
    touching = np.random.default_rng(5).random((ticks, rigs)) > 0.2
    cells = set()
    for tick, touched in enumerate(touching):
        sample = world.measure()._replace(touched=touched)
        begin = plate_of(observer, rigs)
        observer.correct(sample)
        then = plate_of(observer, rigs)
        for book, y, here in zip(books, sample.y, touched, strict=True):
            book.step(begin, then, y[0::2] if here else None)
        observer.predict(world.advance())
        cells |= set(observer._near_points[:, 0].tolist())
        if tick % 50 == 49:
            P = observer.P
            assert np.array_equal(P[:, 9:, 9:], P[:, 9:, 9:].mT)
            for rig, book in enumerate(books):
                scale = np.sqrt(np.diagonal(book.P))
                alike(P[rig] / scale / scale[:, None], book.P / scale / scale[:, None])
                alike(observer.s[rig], book.z[:9])
                more = observer.friction_map[rig].ravel() - observer.s[rig, 8]
                alike(more, book.z[9 : 9 + more.size])
                alike(observer.camber[rig], [*book.z[9 + more.size :], 0.0, 0.0][:2])
    assert len(cells) > 2


def plate_of(observer, rigs):
    """The plate at the touch sample's time, each number by name, shape (N,)."""
    return {
        name: np.broadcast_to(value, rigs) for name, value in observer._ball.then._asdict().items()
    }


def test_a_ball_that_has_run_away_is_nowhere_and_the_others_go_on():
    together, alone = FrictionMapKalman(**COARSE), FrictionMapKalman(**COARSE)
    together.start(np.zeros((2, 8)))
    alone.start(np.zeros(8))
    y = np.tile([0.01, 0.0, 0.02, 0.0], (5, 2, 1))
    y[3:, 1, 0] = np.nan
    x = estimates_of(together, y)[-1]
    assert np.isfinite(x[0]).all()
    assert np.isnan(x[1, 0])
    assert np.isnan(estimates_of(alone, y[:, 1])[-1, 0])


NOISE = np.sqrt((7.2538e-7, 1.7721e-7))  # Table B.1
STRUCK = np.array([0.3, -0.2])


def velocities_after_jump(observer, jump):
    """Estimated velocities after each tick of a ball at rest whose place is changed from 0.5 s on.

    Args:
        observer: Who looks.
        jump: Metres by seconds since then.
    """
    observer.start(np.zeros((1, 8)))
    y = np.zeros((280, 1, 4))
    y[..., 0::2] = NOISE * np.random.default_rng(4).normal(size=(280, 1, 2))
    y[:, 0, 0::2] += [jump(tick * T - 0.5) * np.ones(2) for tick in range(280)]
    return estimates_of(observer, y)[:, 0, 1::4]


@pytest.mark.parametrize("kind", [FrictionKalman, FrictionMapKalman])
def test_a_ball_that_is_struck_has_its_new_velocity_within_hundredths_of_a_second(kind):
    def struck(since):
        return STRUCK * max(since, 0.0)

    after = 250 + 20  # 40 ms
    assert np.abs(velocities_after_jump(kind(), struck)[after] - STRUCK).max() < 0.05
    without = kind(impact_test=ImpactTest(velocity_std_m_s=0.0))
    assert np.abs(velocities_after_jump(without, struck)[after] - STRUCK).max() > 0.1


def test_two_samples_on_one_side_are_a_blow_and_neither_noise_nor_one_is():
    def wrong(samples, **constants):
        observer = FrictionKalman(**constants)
        return velocities_after_jump(
            observer, lambda since: 0.05 * (0 <= since < (samples - 0.5) * T)
        )

    one, two = wrong(1), wrong(2)
    without = {"impact_test": ImpactTest(velocity_std_m_s=0.0)}
    np.testing.assert_array_equal(one, wrong(1, **without))
    assert np.abs(two - wrong(2, **without)).max() > 0.01


def test_a_modelled_plate_follows_a_commanded_rate_as_the_lag_says_whatever_is_measured():
    lag, rate, ticks = 0.06, 0.2, 200
    observer = FrictionKalman(model=BallPlate(lag=lag), plate="modelled", period=T)
    observer.start(np.zeros((1, 8)))
    wrong = np.array([[0.0, 0.05, 0.0, -0.05]])
    for tick in range(ticks):
        x = observer.correct(measured(wrong))
        observer.predict(np.array([[rate / T if tick == 0 else 0.0, 0.0]]))
    passed = (ticks - 1) * T
    gone = np.exp(-passed / lag)
    # the angle is made of straight lines over periods
    assert x[0, 2] == pytest.approx(rate * (passed - lag * (1 - gone)), abs=rate * T)
    assert x[0, 3] == pytest.approx(rate * (1 - gone), rel=1e-9)
    assert not x[0, 6:].any()


def turned(observer, lags, play, own=0.0, seconds=2.5):
    """Lags in s that an observer found of drives with lag and play, one a rig, angles in rad.

    A plate that swings about both axes; its encoders count after the play, and it has a lag of its
    own after that.
    """
    lags, fine = np.array(lags), 4
    motor, rate, plate, seen = (np.zeros((len(lags), 2)) for _ in range(4))
    told, noise = np.zeros(2), np.random.default_rng(3)
    observer.start(np.zeros((len(lags), 8)))
    left = np.where(lags > 0, np.exp(-T / fine / np.maximum(lags, 1e-9)), 0.0)[:, None]
    for tick in range(round(seconds / T)):
        y = np.zeros((len(lags), 4))
        y[:, 1::2] = seen + 1e-5 * noise.normal(size=2)
        observer.correct(measured(y))
        t = tick * T
        turn = np.array([0.12 * np.cos(4 * t) + 0.1 * np.cos(11 * t), 0.15 * np.sin(6 * t)])
        observer.predict(np.tile((turn - told) / T, (len(lags), 1)))
        told = turn
        for _ in range(fine):
            rate = told + left * (rate - told)
            motor = motor + T / fine * rate
            plate = np.clip(plate, motor - play / 2, motor + play / 2)
            seen = seen + (plate - seen) * (1 if not own else -np.expm1(-T / fine / own))
    return observer.further[:, -1]


def swung(observer, frequency, amplitude, jump=0.0):
    """Estimated rates, (K, N), behind plates that swing beside what they are told, one rig each.

    Args:
        observer: Who looks.
        frequency: Of each, Hz.
        amplitude: Of each about x, rad.
        jump: By which each turns at once about y, rad.
    """
    rigs, rates = len(frequency), []
    observer.start(np.zeros((rigs, 8)))
    for tick in range(1200):
        y = np.zeros((rigs, 4))
        t = tick * T
        y[:, 1] = np.array(amplitude) * np.sin(2 * np.pi * np.array(frequency) * t)
        y[:, 3] = jump * (t > 0.5)
        rates.append(observer.correct(measured(y))[:, 3])
        observer.predict(np.zeros((rigs, 2)))
    return np.array(rates)


@pytest.mark.long
def test_a_plate_that_swings_on_its_drive_train_is_found_and_followed_more_slowly():
    frequency, amplitude = (5.0, 5.0, 12.0, 1.0, 13.0), (0.02, 0.0, 0.01, 0.02, 0.002)
    # neither a jump, nor the slow motion of one that is late, nor what a stiff one has
    swings = np.array((True, False, True, False, False))
    soft, hard = (
        swung(FrictionKalman(swinging_pole=pole), frequency, amplitude, jump=0.02)
        for pole in (5.0, 0.0)
    )
    np.testing.assert_array_equal(soft[:, ~swings], hard[:, ~swings])
    late = [np.sqrt((rates[-200:, swings] ** 2).mean(axis=0)) for rates in (soft, hard)]
    assert (late[0] < 0.2 * late[1]).all()  # less of the swing goes on to a law
    alone = swung(FrictionKalman(swinging_pole=5.0), [5.0], [0.02], jump=0.02)
    np.testing.assert_array_equal(alone[:, 0], soft[:, 0])


OWN = 0.0025
"""Lag in s that the plate of the rig has by itself."""


@pytest.mark.long
@pytest.mark.parametrize("play", [0.0, 0.15, 0.3])
def test_the_lag_of_the_drives_is_found_beside_their_play_and_none_where_there_is_none(play):
    lags = [0.0, 0.008, 0.014, 0.02]
    found = turned(FrictionKalman(), lags, np.deg2rad(play), own=OWN)
    assert found[0] == 0.0
    np.testing.assert_allclose(found[1:], lags[1:], atol=0.0025)
    alone = turned(FrictionKalman(), lags[1:2], np.deg2rad(play), own=OWN, seconds=0.5)
    beside = turned(FrictionKalman(), lags[1:2] * 2, np.deg2rad(play), own=OWN, seconds=0.5)
    np.testing.assert_array_equal(beside, [*alone, *alone])


@pytest.mark.long
@pytest.mark.parametrize("kind", [FrictionKalman, FrictionMapKalman])
def test_a_lag_that_is_found_is_in_the_estimate_for_a_law_alone_that_needs_it(kind):
    def estimated(*needed, **constants):
        observer = kind(needed=needed, **constants)
        return turned(observer, [0.02], 0.0, own=OWN).item(), observer.x

    (found, counted), (left_out, others) = estimated("plate_lag"), estimated("friction")
    assert left_out == found == pytest.approx(0.02, abs=0.0025)  # recorded all the same
    none, without = estimated("plate_lag", lag_search=LagSearch(max_lag_s=0.0))
    assert none == 0.0
    np.testing.assert_array_equal(others, without)
    assert (counted != without)[:, 3::4].all()


@pytest.mark.parametrize("how", [{"model": BallPlate(lag=0.01)}, {"plate": "modelled"}])
def test_a_lag_that_is_told_is_kept_and_none_is_found_without_encoders(how):
    observer = FrictionKalman(**how)
    assert turned(observer, [0.02], 0.0, seconds=0.5) == observer.model.lag


def test_constants_of_an_algorithm_are_arguments_and_no_settings_of_a_scenario():
    strict = LagSearch(max_lag_s=0.0)
    assert FrictionKalman(lag_search=strict).lag_search is strict
    constants = {"swing_test", "lag_search", "rest_test", "impact_test", "bounds"}
    names = {each.name for each in catalog_settings(FrictionMapKalman)}
    assert names.isdisjoint(constants | {"model", "period", "delay", "needed"})
    assert {"believed_mm", "plate", "camber_spread"} <= names


def test_bounds_are_those_that_are_passed_in():
    observer = FrictionKalman(bounds=EstimateBounds(tilt_gain_error=1e-6))
    world = World(observer, rigs=2)
    for _ in range(300):
        observer.correct(world.measure())
        observer.predict(world.advance())
    assert np.abs(observer.s[:, 6:8]).max() == 1e-6
