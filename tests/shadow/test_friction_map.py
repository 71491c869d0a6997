"""The twin learns the friction of every place of the screen, and foresees the ball the better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.hal.interface import SCREEN
from twin.identify.prepare import prepare
from twin.identify.windows import Spans, cut
from twin.scenario import load
from twin.shadow.belief import ROUGH, believed
from twin.shadow.friction_map import (
    ANEW,
    EACH,
    FORGOTTEN,
    REST,
    STRETCH,
    FrictionMap,
    Known,
    Ways,
    directed,
    foreseen,
    resolved,
    turned,
    unforeseen,
    unresolved,
)
from twin.shadow.horizon import BAND, LEAD, Lead, Replays, replays, smoothed
from twin.shadow.simulated import logs

NO_GAPS = np.zeros((0, 2))
UNEVEN = (
    *("plant.kind=lagrange", "plant.step=0.002", "duration=15", "seed=4"),
    *("reference.omega=1.0", "plant.surface.spread_percent=20"),
)


@pytest.fixture(scope="module")
def circled():
    """A ball that goes round and round on an uneven screen: its log, and the twin."""
    chosen = load("circle", UNEVEN)
    (log,) = logs([(chosen, chosen)])
    return prepare(log), believed(log)


@pytest.fixture
def belief(circled):
    return circled[1]


def windows(screen, count, size=6, seed=1):
    """What windows show of the map: rows, information and score of a drawn screen."""
    rng = np.random.default_rng(seed)
    truth = np.linalg.cholesky(screen.covariance + 1e-12 * np.eye(len(screen.mean)))
    truth = truth @ rng.standard_normal(len(screen.mean))
    for _ in range(count):
        rows = screen.rows(rng.uniform(-0.5, 0.5, (size, 2)) * SCREEN)
        J = rng.standard_normal((20, size)) * 40
        A = J.T @ J
        yield rows, A, A @ (rows @ truth) + J.T @ rng.standard_normal(20)


def test_windows_one_by_one_say_what_they_say_at_once(belief):
    screen = FrictionMap(belief)
    prior = np.linalg.inv(screen.covariance + 1e-10 * np.eye(len(screen.mean)))
    information, score = prior.copy(), np.zeros(len(screen.mean))
    for rows, A, b in windows(screen, 12):
        information += rows.T @ A @ rows
        score += rows.T @ b
        screen.learn(rows, A, b)
    covariance = np.linalg.inv(information)
    assert screen.mean == pytest.approx(covariance @ score, abs=1e-5)
    assert screen.covariance == pytest.approx(covariance, abs=1e-6)
    assert np.abs(screen.mean).max() > 0.1


def test_a_window_that_no_screen_explains_is_not_believed(belief):
    screen = FrictionMap(belief)
    for rows, A, b in windows(screen, 30):
        before = screen.mean
        screen.learn(rows, A, b)
        assert (screen.mean != before).any()  # of what is drawn as believed none is refused
    mean, covariance = screen.mean, screen.covariance
    rows, A, _ = next(windows(screen, 1))
    screen.learn(rows, A, A @ (rows @ mean + 3.0))
    assert screen.mean is mean
    assert screen.covariance is covariance


def test_between_its_points_a_map_is_straight(belief):
    screen = FrictionMap(belief)
    place = np.random.default_rng(2).uniform(-0.5, 0.5, (50, 2)) * SCREEN
    corner = np.array(SCREEN) / 2
    own = screen.rows(np.array([[0.0, 0.0], 3 * corner, corner]))
    assert own.sum(axis=1) == pytest.approx(1.0)
    assert own[1] == pytest.approx(own[2])
    # a function linear in both axes is shown exactly
    points = np.linalg.lstsq(screen.rows(place), np.ones(50), rcond=None)[0]
    assert screen.rows(place) @ points == pytest.approx(1.0)
    assert (np.count_nonzero(screen.rows(place), axis=1) <= 4).all()
    grid = [np.linspace(-side / 2, side / 2, 1 + round(side / 0.045)) for side in SCREEN]
    x, y = (each.ravel() for each in np.meshgrid(*grid, indexing="ij"))
    assert screen.rows(place) @ (2 * x - 3 * y) == pytest.approx(place @ [2, -3], abs=1e-12)


def test_what_a_map_of_large_meshes_leaves_out_is_left_unknown(belief):
    large, small = replace(belief, patch=0.1), replace(belief, patch=0.01)
    assert resolved(large) == 1.0
    assert unresolved(large) == pytest.approx(REST * belief.patchy)
    assert unresolved(small) > 0.9 * belief.patchy
    assert FrictionMap(small).covariance.max() < 0.1 * FrictionMap(large).covariance.max()


def test_a_screen_long_not_seen_is_a_new_one(belief):
    screen = FrictionMap(belief)
    prior = screen.covariance
    screen.age(5.0)
    assert not screen.mean.any()
    assert screen.covariance == pytest.approx(prior)
    for rows, A, b in windows(screen, 5):
        screen.learn(rows, A, b)
    mean, known = screen.mean, screen.covariance
    screen.age(5.0 + FORGOTTEN / 2)
    assert screen.mean == pytest.approx(np.exp(-0.5) * mean)
    left = prior - screen.covariance
    assert left == pytest.approx(np.exp(-1.0) * (prior - known), abs=1e-15)
    screen.age(5.0 + 20 * FORGOTTEN)
    assert screen.covariance == pytest.approx(prior, abs=1e-12)


def test_a_screen_believed_even_teaches_nothing(belief):
    screen = FrictionMap(replace(belief, patchy=0.0))
    for rows, A, b in windows(FrictionMap(belief), 3):
        screen.learn(rows, A, b)
    assert not screen.mean.any()


def test_a_window_is_foreseen_before_it_is_learnt_and_learnt_once(belief):
    screen = FrictionMap(belief)
    (_, A, _), size = next(windows(screen, 1)), 6
    way = np.broadcast_to([0.1, 0.05], (EACH * size, 2))
    start = np.array([5.0, 5.0 + ANEW / 2, 5.0 + ANEW, 5.0 + 2 * ANEW])
    many = len(start)
    ways = Ways(
        start,
        np.broadcast_to(way, (many, *way.shape)),
        np.broadcast_to(A, (many, *A.shape)),
        np.broadcast_to(A @ np.full(size, 0.1), (many, size)),
        np.broadcast_to(way, (many, *way.shape)),
    )
    counted = np.array([True, True, True, False])
    known = foreseen(ways, counted, screen)
    before, ahead = known.mean[:, 0], known.ahead[:, 0]
    assert before[0] == 0.0
    assert ahead[0] > 0.01
    assert before[1] == pytest.approx(ahead[0])
    assert ahead[1] == ahead[0]  # too soon after the first
    assert ahead[2] > ahead[1]
    assert ahead[3] == ahead[2]  # not to be counted
    assert (np.diff(known.unsure[:, 0, 0]) <= 0).all()
    assert screen.until == 5.0 + ANEW


@pytest.fixture(scope="module")
def some(circled):
    """Some windows of ``LEAD``."""
    log, belief = circled

    def spans(segment, begin, end, longest):
        begins = np.arange(begin, end - longest, 2.8)
        return Spans(begins, np.full(len(begins), longest), np.zeros(len(begins), bool))

    return cut(log, belief.lag, LEAD, spans)


SIZES = {  # without unevenness: that is the map's
    "rolling": 0.18e-3 * np.hypot(0.005, 0.003),
    "breakaway": np.hypot(0.03, 0.03),
    "delay": np.hypot(2e-4, 1e-4),
    "level_phi": np.hypot(2e-5, 1e-5),
    "level_theta": np.hypot(2e-5, 1e-5),
    "gain": np.hypot(0.002, 0.0015),
}


def test_a_smoothed_state_is_the_posterior_of_all_unknowns(some, belief):
    lead = Lead.of(some, belief)
    S, K = lead.stretches, lead.information.shape[-1]
    rng = np.random.default_rng(3)
    known = Known(
        0.1 * rng.standard_normal((len(some), S)),
        np.tile(0.03 * np.exp(-((np.arange(S)[:, None] - np.arange(S)) ** 2) / 4), (5, 1, 1)),
        np.zeros((5, 1)),
        np.zeros((5, 1, 1)),
    )
    mean, covariance = smoothed(lead, belief, known)
    A_alone, b_alone = lead.of_friction(belief)
    others = np.array([*SIZES.values(), 0.02, 0.02, 0.3, 0.3, *np.ones(K - S - 10)])
    for w in range(len(mean)):
        A, b = lead.information[w], lead.score[w]
        prior, m = np.diag(np.append(others, np.ones(S)) ** 2), np.zeros(K)
        prior[-S:, -S:], m[-S:] = known.covariance[w] + 1e-10 * np.eye(S), known.mean[w]
        posterior = np.linalg.inv(A + np.linalg.inv(prior))
        best = posterior @ (b + np.linalg.solve(prior, m))
        onto = np.concatenate((np.eye(6, K), lead.onto[w]))
        spread = onto @ posterior @ onto.T
        scale = np.sqrt(np.diag(spread))
        assert mean[w] / scale == pytest.approx(onto @ best / scale, abs=1e-3)
        assert covariance[w] / np.outer(scale, scale) == pytest.approx(
            spread / np.outer(scale, scale), abs=1e-4
        )
        # with all else unknown, only the friction's own prior being added, it is the same again
        own = np.linalg.inv(A_alone[w] + np.linalg.inv(prior[-S:, -S:]))
        assert own == pytest.approx(posterior[-S:, -S:], rel=1e-3, abs=1e-6)
        at = own @ (b_alone[w] + np.linalg.solve(prior[-S:, -S:], known.mean[w]))
        assert at == pytest.approx(best[-S:], abs=1e-4)


def test_the_second_time_round_the_twin_foresees_the_ball(circled):
    log, belief = circled
    with_map = replays(log, belief, NO_GAPS, 1.0, 1.0)
    even = replace(belief, patchy=0.0, rough=belief.braking * ROUGH)
    without = replays(log, even, NO_GAPS, 1.0, 1.0)
    again = with_map.counted & (with_map.time > 7.5)
    assert again.sum() > 4
    error, blind = (np.median(each.distance[again]) for each in (with_map, without))
    assert error < 0.5 * blind
    assert (with_map.square[with_map.counted] <= BAND).mean() > 0.85


def test_replays_in_parts_are_those_in_one_go(circled):
    log, belief = circled
    whole = replays(log, belief, NO_GAPS, 1.0, 1.0)
    screen = FrictionMap(belief)
    first = replays(log, belief, NO_GAPS, 1.0, 1.0, until=8.5, screen=screen)
    since = float(first.time[-1]) + 1.0
    rest = replays(log, belief, NO_GAPS, 1.0, 1.0, since, screen=screen)
    assert 8.5 - 2.0 < first.time[-1] + 1.0 <= 8.5
    together = Replays.join([first, rest])
    assert together.time == pytest.approx(whole.time)
    assert together.error == pytest.approx(whole.error, abs=1e-6, nan_ok=True)
    assert together.spread == pytest.approx(whole.spread, rel=1e-3)


def test_over_a_gap_nothing_is_learnt(circled):
    log, belief = circled
    screen = FrictionMap(belief)
    found = replays(log, belief, np.array([[0.0, 40.0]]), 1.0, 1.0, screen=screen)
    assert not found.counted.any()
    assert not screen.mean.any()


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
