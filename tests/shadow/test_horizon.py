"""`twin.shadow.horizon`.

How far a replay strays: the state it begins in, and what forces nobody knows make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from twin.hal.interface import SCREEN_SIZE_M
from twin.identify.least_squares import fit_starts
from twin.identify.parameters import BALL_PARAMETERS
from twin.identify.prepare import prepare
from twin.identify.windows import FORCE_STRETCH_S, REPLAY_STEP_S, Spans, cut
from twin.scenario import load
from twin.shadow.belief import BALL_BELIEFS, Belief, belief_of, logs
from twin.shadow.horizon import (
    CHI_SQUARE_95,
    LEAD_S,
    MAP_FORGETTING_S,
    UNMAPPED_SHARE,
    FrictionMap,
    Replays,
    Smoothed,
    _sigma_points,
    braking,
    forces,
    replays,
    smooth,
    to_acceleration_columns,
    unforeseen,
)

NO_GAPS = np.zeros((0, 2))
QUICK = (
    *("plant.kind=lagrange", "plant.step=0.004", "rig.period=0.004"),
    *("seed=4", "reference.omega=1.0"),
)


def circled(*settings):
    """A ball that goes round and round: its log, and the twin."""
    chosen = load("circle", (*QUICK, *settings))
    (log,) = logs([(chosen, chosen)])
    return prepare(log), belief_of(log)


@pytest.fixture(scope="module")
def uneven():
    """The same on an uneven screen."""
    return circled("duration=9", "plant.surface.spread_percent=20")


@pytest.fixture(scope="module")
def replayed():
    """The same for as long as replays of both of its parts count."""
    return circled("duration=14", "plant.surface.spread_percent=20")


def on_screen(belief, **surface):
    """The same twin, which believes another screen."""
    plant = belief.scenario.plant
    new = plant.model_copy(update={"surface": plant.surface.model_copy(update=surface)})
    return replace(belief, scenario=belief.scenario.model_copy(update={"plant": new}))


def ways(screen, count, size=4, seed=1):
    """What ways over a screen drawn as believed say of the friction in their stretches."""
    rng = np.random.default_rng(seed)
    truth = np.linalg.cholesky(screen.covariance + 1e-12 * np.eye(len(screen.mean)))
    truth = truth @ rng.standard_normal(len(screen.mean))
    for _ in range(count):
        rows = screen.shares(rng.uniform(-0.5, 0.5, (size, 2)) * SCREEN_SIZE_M)
        J = rng.standard_normal((20, size)) * 40
        noise = J.T @ rng.standard_normal(20)
        yield (
            rows,
            J.T @ J,
            J.T @ J @ (rows @ truth + screen.left * rng.standard_normal(size)) + noise,
        )


def take_in(screen, rows, A, b, until):
    """Have a map learn what a likelihood exp(b'd - d'A d / 2) says of its stretches."""
    covariance = np.linalg.inv(np.linalg.inv(screen.known(rows)) + A)
    expected = rows @ screen.mean
    screen.learn(rows, expected + covariance @ (b - A @ expected), covariance, until)


@pytest.mark.long
def test_ways_one_by_one_say_of_the_map_what_they_say_at_once(uneven):
    screen = FrictionMap(uneven[1])
    information = np.linalg.inv(screen.covariance + 1e-10 * np.eye(len(screen.mean)))
    score = np.zeros(len(screen.mean))
    for number, (rows, A, b) in enumerate(ways(screen, 12)):
        # each stretch differs from the map by a number of its own
        blurred = np.eye(len(rows)) + screen.left**2 * A
        information += rows.T @ np.linalg.solve(blurred, A) @ rows
        score += rows.T @ np.linalg.solve(blurred, b)
        before = screen.mean
        take_in(screen, rows, A, b, 1e-3 * number)
        assert (screen.mean != before).any()  # of what is drawn as believed none is refused
    covariance = np.linalg.inv(information)
    assert screen.mean == pytest.approx(covariance @ score, abs=1e-4)
    assert screen.covariance == pytest.approx(covariance, abs=1e-5)
    assert np.abs(screen.mean).max() > 0.1


def test_a_way_that_no_screen_explains_is_not_believed(uneven):
    screen = FrictionMap(uneven[1])
    rows, A, _ = next(ways(screen, 1))
    take_in(screen, rows, A, A @ np.full(len(rows), 3.0), 0.0)  # somebody holds the ball back
    assert not screen.mean.any()
    assert screen.covariance == pytest.approx(FrictionMap(uneven[1]).covariance)


def test_between_its_points_a_map_is_straight(uneven):
    screen = FrictionMap(uneven[1])
    place = np.random.default_rng(2).uniform(-0.5, 0.5, (50, 2)) * SCREEN_SIZE_M
    grid = [np.linspace(-side / 2, side / 2, 1 + round(side / 0.045)) for side in SCREEN_SIZE_M]
    x, y = (each.ravel() for each in np.meshgrid(*grid, indexing="ij"))
    assert screen.shares(place) @ (2 * x - 3 * y) == pytest.approx(place @ [2, -3], abs=1e-12)


def test_what_a_map_of_large_meshes_does_not_show_is_left_unknown(uneven):
    large, small = (FrictionMap(on_screen(uneven[1], patch_mm=mm)) for mm in (100.0, 10.0))
    assert large.left == pytest.approx(0.2 * UNMAPPED_SHARE, rel=1e-3)
    assert small.left > 0.9 * 0.2
    assert small.covariance.max() < 0.1 * large.covariance.max()


def test_a_screen_long_not_seen_is_a_new_one(uneven):
    screen = FrictionMap(uneven[1])
    prior = screen.covariance
    for rows, A, b in ways(screen, 5):
        take_in(screen, rows, A, b, 5.0)
    mean, known = screen.mean, screen.covariance
    nothing = np.zeros((1, len(mean)))
    screen.learn(nothing, np.zeros(1), screen.known(nothing), 5.0 + MAP_FORGETTING_S / 2)
    assert screen.mean == pytest.approx(np.exp(-0.5) * mean)
    assert prior - screen.covariance == pytest.approx(np.exp(-1.0) * (prior - known), abs=1e-12)


@pytest.mark.long
def test_what_two_ways_share_is_learnt_once(uneven, monkeypatch):
    log, belief = uneven
    learnt, learn = [], FrictionMap.learn
    monkeypatch.setattr(
        FrictionMap, "learn", lambda *said: (learnt.append(said[-1]), learn(*said))[1]
    )
    found = replays(log, belief, NO_GAPS, every=0.25)
    assert (np.diff(found.time) < 0.3).all()
    assert np.diff(learnt) == pytest.approx(np.ones(len(learnt) - 1))


@pytest.mark.long
def test_the_second_time_round_the_twin_foresees_the_ball():
    log, belief = circled("duration=20", "plant.surface.spread_percent=20")
    learnt = replays(log, belief, NO_GAPS)
    blind = replays(log, on_screen(belief, spread_percent=0.0), NO_GAPS)
    again = learnt.counted & (learnt.time > 7.5)
    assert again.sum() > 10
    error, without = (np.median(each.distance[again]) for each in (learnt, blind))
    assert error < 0.5 * without


SIZES = {  # of what is believed, before anything is seen
    "rolling": 0.18e-3 * np.hypot(0.005, 0.003),
    "breakaway": np.hypot(0.03, 0.03),
    "delay": np.hypot(2e-4, 1e-4),
    "level_phi": np.hypot(2e-5, 1e-5),
    "level_theta": np.hypot(2e-5, 1e-5),
    "gain": np.hypot(0.002, 0.0015),
}


@pytest.mark.long
def test_a_smoothed_state_is_the_posterior_of_parameters_and_start(monkeypatch):
    log, belief = circled("duration=5.5", "plant.friction.breakaway_ratio=1.2")

    def spans(segment, begin, end, longest):
        begins = np.arange(begin + 2, end - longest, 2.0)  # the ball rolls
        return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))

    some = cut(log, belief.lag, LEAD_S, spans)
    for name in ("UNKNOWN_ACCELERATION_STD", "MIN_UNEVENNESS"):
        monkeypatch.setattr(f"twin.shadow.horizon.{name}", 1e-9)
    mean, covariance, end, *_ = smooth(some, belief, FrictionMap(belief), np.ones(len(some), bool))
    problem, theta = belief.problem(some), belief.theta
    starts = fit_starts(problem, theta, problem.initial_starts(), 6)
    line = problem.linearise(theta, starts)
    prior = np.array([*SIZES.values(), 0.02, 0.02, 0.3, 0.3])
    for w in range(len(mean)):
        J = np.hstack((line.by_parameter[0, w, :, :6], line.by_start[0, w])) * prior
        rows = np.vstack((J, np.eye(10)))
        best = np.linalg.lstsq(rows, np.append(-line.r[0, w], np.zeros(10)), rcond=None)[0]
        assert mean[w, :6] / prior[:6] == pytest.approx(best[:6], abs=1e-6)
        spread = np.linalg.inv(rows.T @ rows)[:6, :6]
        assert covariance[w, :6, :6] / np.outer(prior, prior)[:6, :6] == pytest.approx(spread)
        # the state at the end is that of a replay with the most probable parameters and start
        moved, begun = theta.copy(), starts.copy()
        moved[0, :6] += best[:6] * prior[:6]
        begun[:, 0, w] += best[6:] * prior[6:]
        place, speed = (
            each[round(LEAD_S / REPLAY_STEP_S), :, 0, w] for each in problem.replay(moved, begun)
        )
        assert end[:, w] + mean[w, 6:] == pytest.approx([*place, *speed], abs=2e-5)


@pytest.mark.long
def test_of_a_plate_with_camber_that_is_known_replays_are_as_near_as_of_a_flat_one():
    camber = "plant.camber=[0.4,-0.5]"
    far = []
    for more in ("plant.camber=[0,0]", camber):
        log, belief = circled("duration=8", "seed=3", more)
        far.append(np.median(np.abs(replays(log, belief, NO_GAPS).error[:, :2])))
    assert far[1] == pytest.approx(far[0], rel=0.5)
    flat = load("circle", (*QUICK, "plant.camber=[0,0]"))
    unknown = replays(log, Belief.of(flat, belief), NO_GAPS)
    assert np.median(np.abs(unknown.error[:, :2])) > 10 * far[1]


@pytest.mark.long
def test_on_an_uneven_screen_replays_stray_as_far_as_predicted(replayed):
    log, belief = replayed
    run = replays(log, belief, NO_GAPS)
    inside = run.square[run.counted] <= CHI_SQUARE_95
    assert len(inside) > 10
    assert inside.sum() >= stats.binom.ppf(1e-3, len(inside), 0.95)
    even = replays(log, on_screen(belief, spread_percent=0.0), NO_GAPS)
    assert (even.square[even.counted] <= CHI_SQUARE_95).mean() < 0.5


@pytest.mark.long
def test_replays_in_parts_are_those_in_one_go(replayed):
    log, belief = replayed
    whole = replays(log, belief, NO_GAPS)
    screen = FrictionMap(belief)
    first = replays(log, belief, NO_GAPS, until=8.5, screen=screen)
    rest = replays(log, belief, NO_GAPS, since=float(first.time[-1]) + 1.0, screen=screen)
    assert 8.5 - 2.0 < first.time[-1] + 1.0 <= 8.5
    together = Replays.join([first, rest])
    assert together.time == pytest.approx(whole.time)
    assert together.error == pytest.approx(whole.error, abs=1e-6, nan_ok=True)
    assert together.spread == pytest.approx(whole.spread, rel=1e-3)


def test_over_a_gap_nothing_is_told_or_learnt(uneven):
    log, belief = uneven
    screen = FrictionMap(belief)
    found = replays(log, belief, np.array([[0.0, 40.0]]), screen=screen)
    assert not found.counted.any()
    assert not screen.mean.any()


COUNT = 250


@pytest.mark.parametrize(("slope_deg", "brakes"), [(0.0, 1.0), (0.1, 0.0), (0.1, 1.0)])
def test_a_spread_is_that_of_balls_pushed_at_random(uneven, slope_deg, brakes):
    belief = replace(uneven[1], sloped=uneven[1].model.k1 * np.radians(slope_deg))
    along = brakes * belief.model.k1 * belief.values["rolling"] / belief.model.radius
    across = np.hypot(belief.sloped, 4e-4)
    rng = np.random.default_rng(3)
    heading = np.array([0.6, -0.8])
    stretch = round(FORCE_STRETCH_S / REPLAY_STEP_S)
    places = np.zeros((20_000, 2))
    for begin in range(0, COUNT, stretch):
        lasting = (min(begin + stretch, COUNT) - begin) * REPLAY_STEP_S
        left = (COUNT - begin) * REPLAY_STEP_S - lasting
        pushed = along * rng.standard_normal((len(places), 1)) * heading
        pushed = pushed + across * rng.standard_normal((len(places), 2))
        places += pushed * (lasting**2 / 2 + lasting * left)
    going = np.broadcast_to(0.05 * heading.reshape(1, 2, 1), (COUNT + 1, 2, 1))
    kinds = (forces(belief, going), brakes * braking(belief, going))
    ((predicted,), (braked,)) = (unforeseen(each, COUNT * REPLAY_STEP_S) for each in kinds)
    predicted = predicted + braked
    assert predicted == pytest.approx(np.cov(places.T), abs=0.05 * np.trace(predicted))


def test_friction_that_nobody_knows_moves_no_ball_at_rest(uneven):
    assert not braking(uneven[1], np.zeros((COUNT + 1, 2, 1))).any()


def test_columns_of_unit_accelerations_become_those_of_the_unknown_ones(uneven):
    going = np.broadcast_to([[[0.03], [0.04]]], (COUNT + 1, 2, 1))
    there = braking(uneven[1], going)
    columns = np.arange(2.0 * 2 * there.shape[1]).reshape(1, 2, -1)
    found = to_acceleration_columns(columns, there)
    size = np.hypot(*there[0, 0, :, 0])
    assert found == pytest.approx(-size * (0.6 * columns[..., 0::2] + 0.8 * columns[..., 1::2]))
    assert to_acceleration_columns(columns[0], there) == pytest.approx(found)


def test_parameters_that_may_be_are_within_their_bounds_however_little_is_known(uneven):
    _, belief = uneven
    count = len(BALL_BELIEFS) + 4
    before = Smoothed(
        np.zeros((2, count)), 1e6 * np.tile(np.eye(count), (2, 1, 1)), np.zeros((4, 2)), None, None
    )
    (parameters, _), weights = _sigma_points(before, belief)
    assert weights.sum() == pytest.approx(1)
    for k, name in enumerate(BALL_BELIEFS):
        about = BALL_PARAMETERS[name]
        assert parameters[..., k].min() == pytest.approx(about.least)
        assert parameters[..., k].max() == pytest.approx(about.most)
