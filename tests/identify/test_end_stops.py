"""`twin.identify.end_stops`: walls that a ball touches, in logs of a simulation of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from docs.identify_errors import STEP_S, TUBE, Rig, simulate_log
from twin.identify import end_stops
from twin.identify.any_rig import identify_axes
from twin.identify.axis_logs import AnyLog, AxisLog, EndStops
from twin.identify.axis_problem import AxisProblem
from twin.identify.command_model import TiltHistory
from twin.identify.end_stops import describe_stops, find_end_stops, find_ends
from twin.identify.first_look import look_first
from twin.identify.logs import of_columns
from twin.identify.verdicts import IDENTIFIED_VERDICT
from twin.identify.windows import axis_windows, spans, usual_free_time
from twin.sim.plant.rim import NO_ENDS


def axis_of(seed, rig):
    time, sampled, ball, command, _ = simulate_log(seed, rig)
    return AxisLog(time, command, True, sampled, ball)


@pytest.fixture(scope="module")
def tube():
    return axis_of(1, TUBE)


def between(log):
    """The log with its end stops, as they are found."""
    return replace(log, stops=find_end_stops(log, look_first(log)))


@pytest.mark.long
def test_walls_restitution_and_touches_of_a_tube_are_found(tube):
    log = between(tube)
    assert log.stops.low == pytest.approx(-TUBE.stop, abs=1e-3)
    assert log.stops.high == pytest.approx(TUBE.stop, abs=1e-3)
    assert log.stops.restitution == pytest.approx(TUBE.restitution, abs=0.1)
    at_wall = np.abs(np.abs(log.ball) - TUBE.stop) < 1e-3
    assert log.touching[at_wall].mean() > 0.99
    assert np.abs(log.ball[log.touching]).min() > 0.02
    assert 0.25 < log.touching.mean() < 0.5
    (note,) = describe_stops("x", log)
    assert "an end stop at -40.0 and 40.0 mm" in note
    assert f"{100 * (1 - log.touching.mean()):.0f} % was used" in note


def test_a_log_of_known_columns_shows_the_walls_of_each_axis():
    """A plate with a rim along x; along y the ball turns before it meets anything."""
    rim = replace(TUBE, seconds=40.0, stop=0.05, nervous=False)
    x, y = simulate_log(3, rim), simulate_log(4, replace(rim, stop=np.inf))
    rows = np.minimum(np.rint(x[0] / STEP_S).astype(int), len(x[4]) - 1)
    columns = {"time": x[0], "measured_x": x[2], "measured_phi": x[4][rows]}
    columns |= {"measured_y": y[2], "measured_theta": y[4][rows]}
    (low, high), across = find_ends(of_columns(columns, {}, "rows"))
    assert low == pytest.approx(-0.05, abs=2e-3)
    assert high == pytest.approx(0.05, abs=2e-3)
    assert across == NO_ENDS


@pytest.mark.parametrize(
    ("touched", "ends"),
    [((4, 4), (-0.08, 0.08)), ((1, 4), (-0.08, 0.08)), ((0, 4), (-np.inf, 0.08)), ((1, 3), None)],
)
def test_one_touch_shows_a_wall_where_the_other_end_has_one(monkeypatch, tube, touched, ends):
    visit = end_stops._Visit(
        begin=1.0, end=1.1, towards=0.2, away=0.1, impulse=0.3, explained=0.1, place=0.08
    )
    turned = replace(visit, impulse=0.05)
    visits = dict(zip((-1.0, 1.0), touched, strict=True))
    monkeypatch.setattr(
        end_stops, "_find_visits", lambda _, __, side, ___: [visit] * visits[side] or [turned]
    )
    found = find_end_stops(tube, look_first(tube))
    assert (found and (found.low, found.high)) == ends


@pytest.mark.parametrize("rate", [30.0, 60.0])
def test_walls_at_which_a_ball_only_bounces_are_found(rate):
    log = between(axis_of(8, Rig(stop=0.058, rate=rate, restitution=0.6)))
    assert log.stops.high == pytest.approx(0.058, abs=1.5e-3)
    assert log.touching.mean() < 0.15


@pytest.mark.short("rig1")
@pytest.mark.parametrize("rig", [Rig(), Rig(rate=30.0), Rig(friction=0.1), Rig(presliding=1e-3)])
def test_a_ball_that_turns_without_a_wall_touches_none(rig):
    log = between(axis_of(7, rig))
    assert log.stops is None
    assert not log.touching.any()
    assert describe_stops("x", log) == []


def test_no_window_touches_a_wall(tube):
    log = between(tube)

    def touching(begin, end):
        rows = ((log.sampled >= a) & (log.sampled < b) for a, b in zip(begin, end, strict=True))
        return np.concatenate([log.touching[each] for each in rows])

    assert len(spans(log, 0.4)[0]) > 30
    assert not touching(*spans(log, 0.4)).any()
    assert touching(*spans(tube, 0.4)).any()
    assert usual_free_time(log) < usual_free_time(tube) / 10


def test_a_log_that_begins_and_ends_at_a_wall_touches_it_there(tube):
    begin, end = between(tube).stops.touches
    middles = ((begin + end) / 2)[end - begin > 0.6]
    log = between(tube.between(middles[0], middles[-1]))
    assert np.abs(log.ball[[0, 1, -2, -1]]).min() > TUBE.stop - 3e-3
    assert log.touching[log.sampled < middles[0] + 0.25].all()
    assert log.touching[log.sampled > middles[-1] - 0.25].all()


def test_a_simulated_ball_bounces_between_walls_and_rests_at_one():
    time = np.arange(0.0, 4.0, 0.01)
    log = AxisLog(time, np.where(time < 1.0, 0.05, 0.1), True, time, 0 * time)
    stops = EndStops(-0.04, 0.04, 0.33, np.zeros((2, 0)))
    windows = axis_windows(log, np.zeros(1), np.full(1, 4.0))
    problem = AxisProblem(
        windows, ("gain", "dead_time"), TiltHistory(log, 1.0), 4.0, (0.0, 0.5), stops=stops
    )
    places = problem.simulate(np.array([[6.0, 0.0]]), np.zeros((2, 1, 1)))[:, 0, 0]
    assert places.max() <= stops.high
    at = np.arange(len(places)) * problem.step
    first = float(at[places >= stops.high - 1e-9][0])
    assert first == pytest.approx(np.sqrt(2 * stops.high / 0.3), abs=2 * problem.step)
    away = stops.high - places[at > first + problem.step].min()
    speed = 0.3 * first * stops.restitution
    assert away == pytest.approx(speed**2 / (2 * 0.3), rel=0.15)
    assert places[-1] == pytest.approx(stops.high, abs=1e-4)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_tube_gives_gain_and_dead_time_though_the_ball_is_at_its_ends(seed):
    log = axis_of(seed, replace(TUBE, lag=0.02, dead_time=0.02) if seed == 3 else TUBE)
    found = identify_axes([AnyLog("tube.csv", {"x": log}, {"x": "rad"}, ())], 0.33)
    told = {each.name: each for each in found.verdicts}
    gain, delay = told["gain_x"], told["delay_x"]
    assert gain.word == IDENTIFIED_VERDICT
    assert gain.low <= TUBE.gain <= gain.high
    assert delay.word == IDENTIFIED_VERDICT
    assert delay.low <= TUBE.dead_time <= delay.high
    (score,) = found.scores
    assert score.median["model"][1] < 0.1 * score.median["stays"][1]
    assert any("% was used" in note for note in found.notes)
