"""`twin.identify.fallback`: a plain model where the full one shows no gain."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from docs import identify_coverage
from docs.five_numbers import fit_five_numbers_by_scipy, predict_five_numbers
from docs.identify_errors import TUBE, Rig, simulate_log
from twin.identify import fallback, first_look
from twin.identify.any_rig import identify_axes, join_logs
from twin.identify.axis_identification import AxisIdentification
from twin.identify.axis_logs import AnyLog, AxisLog, EndStops
from twin.identify.axis_verdicts import describe_lags
from twin.identify.end_stops import find_end_stops
from twin.identify.fallback import PLAIN_WHY, ROLLING_WHY, assess_plainly
from twin.identify.first_look import (
    TriedLinkages,
    find_misfits,
    join_looks,
    look_at_any_motion,
    look_at_moving,
    look_at_rolling,
    look_at_rolling_in_several_ways,
    look_first,
    look_plainly,
    look_with_linkages,
)
from twin.identify.parameters import plain_parameter
from twin.identify.report import sentences
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    IDENTIFIED_VERDICT,
    NOT_IDENTIFIABLE,
    PLAIN_VERDICT,
    ParameterVerdict,
)
from twin.identify.weak_form import WEAK_FORM, WeakWindows, make_grids


def verdict(name, word, value=None, low=None, high=None):
    about = plain_parameter(name.rpartition("_")[0], "rad")
    return ParameterVerdict(about=about, name=name, value=value, low=low, high=high, word=word)


@pytest.fixture(scope="module")
def log():
    rig = Rig(seconds=30.0, viscous=0.8, friction=0.0)
    time, sampled, ball, command, _ = simulate_log(1, rig)
    return AxisLog(time, command, True, sampled, ball)


def test_a_gain_that_is_identified_needs_no_look(log, monkeypatch):
    def refuse(*_):
        raise AssertionError("a look that nothing needs")

    monkeypatch.setattr(fallback, "look_at_any_motion", refuse)
    monkeypatch.setattr(fallback, "look_at_rolling_in_several_ways", refuse)
    before = [verdict("gain_x", IDENTIFIED_VERDICT, 7.0, 6.9, 7.1)]
    assert assess_plainly(log, "x", "rad", before) == (before, [])


@pytest.mark.parametrize(
    ("name", "held", "least"),
    [
        ("friction_x", True, 0.0),
        ("viscous_x", True, 0.0),
        ("delay_x", True, 0.0),
        ("delay_x", False, -0.1),
        ("level_x", True, -0.5),
        ("gain_x", False, -0.5),
    ],
)
@pytest.mark.parametrize("low", [-0.5, 0.01])
def test_an_interval_of_a_plain_model_ends_where_its_quantity_does(
    name, held, least, low, log, monkeypatch
):
    names = ("gain", "delay", "level", "damping", "friction")
    look = SimpleNamespace(
        **dict.fromkeys(names, 0.05), terms=names[3:], plain=True, explained=0.9, windows=40
    )
    look.interval = lambda _: (low, 0.6)
    monkeypatch.setattr(fallback, "look_at_any_motion", lambda *_: [look])
    monkeypatch.setattr(fallback, "join_looks", lambda looks: looks[0])
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    found, _ = assess_plainly(replace(log, held=held), "x", "rad", before)
    (told,) = (each for each in found if each.name == name)
    # what is inside stays
    assert (told.value, told.low, told.high) == (0.05, max(low, least), 0.6)


def test_the_plain_model_gives_its_numbers_with_intervals(log):
    before = [
        verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0),
        verdict("friction_x", BOUNDED_VERDICT, 0.3, 0.0, 0.6),
    ]
    found, (note,) = assess_plainly(log, "x", "rad", before)
    told = {each.name: each for each in found}
    for name, truth in (("gain_x", 7.007), ("delay_x", 0.1), ("level_x", 0.0), ("viscous_x", 0.8)):
        assert told[name].low <= truth <= told[name].high
        assert told[name].why == PLAIN_WHY
    assert told["gain_x"].word == IDENTIFIED_VERDICT
    for each in (each for each in found if each.word == IDENTIFIED_VERDICT):
        assert "full" not in each.why
    assert "leaves the gain of this log open" in note
    friction = told["friction_x"]
    assert "the model that shows it has none of this" in friction.why
    assert friction.word == NOT_IDENTIFIABLE
    assert (friction.value, friction.low, friction.high) == (None, None, None)
    assert "friction from damping" in note


def test_a_first_look_at_any_motion_answers_and_is_not_repeated(log, monkeypatch):
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    looks = look_at_any_motion(log, TriedLinkages())
    monkeypatch.setattr(fallback, "look_at_any_motion", lambda *_: looks)
    expected = assess_plainly(log, "x", "rad", before)

    def refuse(*_):
        raise AssertionError("a look again")

    monkeypatch.setattr(fallback, "look_at_any_motion", refuse)
    monkeypatch.setattr(fallback, "look_at_rolling_in_several_ways", lambda *_: [])
    look = join_looks(looks)
    assert assess_plainly(log, "x", "rad", before, look=look) == expected
    stops = EndStops(-0.1, 0.1, 0.3, np.array([[3.0], [3.1]]))
    for other, seen in ((log, replace(look, plain=False)), (replace(log, stops=stops), look)):
        with pytest.raises(AssertionError, match="a look again"):
            assess_plainly(other, "x", "rad", before, look=seen)


@pytest.mark.long
def test_between_end_stops_a_rolling_ball_shows_friction_and_camber():
    time, sampled, ball, command, _ = simulate_log(1, TUBE)
    log = AxisLog(time, command, True, sampled, ball)
    log = replace(log, stops=find_end_stops(log, look_first(log)))
    before = [
        verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0),
        verdict("friction_x", BOUNDED_VERDICT, 0.3, 0.0, 0.6),
        verdict("viscous_x", BOUNDED_VERDICT, 0.3, 0.0, 0.6),
    ]
    found, (note,) = assess_plainly(log, "x", "rad", before)
    by_name = {each.name: each for each in found}
    for name, truth in (
        ("gain_x", TUBE.gain),
        ("delay_x", TUBE.dead_time),
        ("level_x", 0.0),
        ("friction_x", TUBE.friction),
        ("camber_x", 0.0),
    ):
        assert by_name[name].low <= truth <= by_name[name].high
        assert by_name[name].why == ROLLING_WHY
    assert by_name["viscous_x"].high is None
    assert "friction and camber" in note
    assert "linear" not in note


def test_friction_that_may_as_well_be_damping_is_not_identified_however_narrow(monkeypatch):
    time, sampled, ball, command, _ = simulate_log(1, replace(TUBE, seconds=24.0))
    log = AxisLog(time, command, True, sampled, ball)
    look = look_first(log)
    sure = replace(look, gain_std=1e-3, friction_std=1e-4)
    monkeypatch.setattr(fallback, "look_at_rolling_in_several_ways", lambda *_: [sure])
    log = replace(log, stops=find_end_stops(log, look))
    found, _ = assess_plainly(log, "x", "rad", [verdict("gain_x", NOT_IDENTIFIABLE)])
    words = {each.name: each.word for each in found}
    assert words["gain_x"] == IDENTIFIED_VERDICT
    assert words["friction_x"] == PLAIN_VERDICT


@pytest.mark.long
def test_the_gain_of_a_plain_model_holds_on_rigs_with_friction_camber_and_lever():
    """Rigs that nothing was chosen on; four of 24 outside have a chance of 3 % at 95 %."""
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    held = 0
    for seed in range(400, 424):
        rig = identify_coverage.drawn(seed)
        time, ball, command = identify_coverage.log_of(seed, rig)
        log = AxisLog(time, command, True, time, ball)
        told = {each.name: each for each in assess_plainly(log, "x", "rad", before)[0]}
        assert {"friction_x", "camber_x"} <= told.keys()
        assert told["gain_x"].value == pytest.approx(rig["gain"], rel=0.1)
        held += told["gain_x"].low <= rig["gain"] <= told["gain_x"].high
    assert held >= 21


def test_a_lever_is_part_of_what_the_plain_model_leaves_open(axis_log):
    """By a quick controller; half as much again of the motion is by the plate's acceleration."""
    for lever in (-0.08, 0.155):
        rig = {"gain": 6.0, "dead_time": 0.05, "lag": 0.06, "level": 0.05, "camber": 0.2}
        time, ball, angle = axis_log(
            5, rate=60.0, seconds=40, lever=lever, angles=True, stiff=3.0, damped=1.4, **rig
        )
        log = AxisLog(time, angle, False, time, ball)
        windows = WeakWindows.of(make_grids(log, (0.9,))[0], rolling=False)
        looks = look_with_linkages(windows, TriedLinkages((-0.08, 0.0, 0.155)))
        assert looks[0].gain == pytest.approx(6.0, rel=0.06)
        without = look_plainly(log, 0.9, terms=("friction", "camber"))
        assert abs(without.gain - 6.0) > 0.15 * 6.0
        misfits = find_misfits((without, looks[0]))
        assert misfits[0] > misfits[1] + 100
        before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
        gain = assess_plainly(log, "x", "rad", before)[0][0]
        assert gain.low < 6.0 < gain.high


@pytest.mark.long
def test_a_lever_is_part_of_what_a_rolling_ball_leaves_open(axis_log):
    rig = {"gain": 6.0, "dead_time": 0.05, "lag": 0.06, "level": 0.05, "camber": 0.2}
    time, ball, angle = axis_log(
        6, rate=60.0, seconds=40, lever=0.155, angles=True, stiff=3.0, damped=1.4, **rig
    )
    log = AxisLog(time, angle, False, time, ball)
    without = look_at_rolling(log)
    assert abs(without.gain - 6.0) > 0.15 * 6.0
    looks = look_at_rolling_in_several_ways(log, TriedLinkages((-0.08, 0.0, 0.155)))
    assert without in looks
    assert looks[0].gain == pytest.approx(6.0, rel=0.06)
    ways = {("friction", "camber"), ("friction",), ("friction", "damping")}
    assert {each.terms for each in looks} == ways


def drawn_tube(seed):
    """A tube or a beam with end stops that nothing was chosen on, and its log.

    Its sensor of distance bows by up to a millimetre, and the ball is damped; the model of a
    rolling ball has neither.
    """
    rng = np.random.default_rng(seed)
    rig = replace(
        TUBE,
        seconds=40.0,
        rate=float(rng.choice([33.0, 50.0, 100.0])),
        gain=float(rng.uniform(3.0, 7.0)),
        dead_time=float(rng.uniform(0.03, 0.08)),
        lag=float(rng.uniform(0.02, 0.08)),
        viscous=float(rng.uniform(0.0, 0.4)),
        friction=float(rng.uniform(0.02, 0.08)),
        noise=float(rng.uniform(3e-4, 1.5e-3)),
        pixel=float(rng.choice([0.0, 1e-3])),
        stop=float(rng.uniform(0.04, 0.15)),
    )
    time, sampled, ball, command, _ = simulate_log(seed, rig)
    ball = ball + rng.uniform(0.0, 1e-3) * np.sin(2 * np.pi * ball / 0.09 + rng.uniform(0.0, 6.0))
    return rig, AxisLog(time, command, True, sampled, ball)


@pytest.mark.long
def test_the_gain_of_a_rolling_ball_holds_on_tubes():
    """A gain outside an interval that is called identified is a wrong answer."""
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    held = told = 0
    for seed in range(700, 712):
        rig, log = drawn_tube(seed)
        if not (look := look_first(log)) or not (stops := find_end_stops(log, look)):
            continue
        gain = assess_plainly(replace(log, stops=stops), "x", "rad", before)[0][0]
        told += gain.why == ROLLING_WHY
        held += gain.low <= rig.gain <= gain.high
    assert told >= 8
    assert held == told


@pytest.mark.short("821")
@pytest.mark.parametrize("seed", [821, 822])
def test_windows_without_a_ball_at_rest_show_the_gain_of_a_sticky_rig(seed):
    """At rest friction balances the tilt, so that all windows together give a small gain."""
    rig = Rig(seconds=40.0, friction=0.12, rate=50.0)
    time, sampled, ball, command, _ = simulate_log(seed, rig)
    log = AxisLog(time, command, True, sampled, ball)
    every = look_plainly(log, 0.9, terms=("friction", "camber"))
    looks = look_at_moving(make_grids(log, WEAK_FORM.plain_windows_s), TriedLinkages())
    assert abs(every.gain - rig.gain) > abs(looks[0].gain - rig.gain)
    assert looks[0].gain == pytest.approx(rig.gain, rel=0.06)
    assert looks[0].windows < every.windows
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    gain = assess_plainly(log, "x", "rad", before)[0][0]
    assert gain.low < rig.gain < gain.high


def drawn_sticking(seed):
    """A log of a rig on which the ball rests for more than half of the time; nothing was chosen."""
    rng = np.random.default_rng([seed, 77])
    while True:
        gain = float(rng.uniform(4.0, 8.0))
        rig = Rig(
            seconds=60.0,
            rate=float(rng.uniform(30.0, 100.0)),
            gain=gain,
            dead_time=float(rng.uniform(0.02, 0.1)),
            lag=float(rng.uniform(0.02, 0.1)),
            level=float(rng.uniform(-0.05, 0.05)),
            noise=float(rng.uniform(2e-4, 6e-4)),
            friction=0.028 * gain * float(rng.uniform(0.7, 1.6)),
        )
        time, sampled, ball, command, _ = simulate_log(int(rng.integers(1e6)), rig)
        smooth = np.convolve(ball, np.full(5, 0.2), "same")
        if 0.5 < np.mean(np.abs(np.gradient(smooth, sampled)) < 0.01) < 0.95:
            return rig, AxisLog(time, command, True, sampled, ball)


@pytest.mark.long
def test_the_gain_holds_on_rigs_on_which_the_ball_rests_most_of_the_time():
    """Windows with a ball at rest show a third of the gain; where others are few, none is shown."""
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    held, errors = [], []
    for seed in range(8000, 8020):
        rig, log = drawn_sticking(seed)
        gain = assess_plainly(log, "x", "rad", before)[0][0]
        if gain.why == PLAIN_WHY:
            held.append(gain.low <= rig.gain <= gain.high)
            errors.append(abs(gain.value / rig.gain - 1))
    assert len(held) >= 12
    assert sum(held) >= 0.9 * len(held)
    assert np.median(errors) < 0.15


def test_the_interval_holds_what_windows_without_a_ball_at_rest_give(log, monkeypatch):
    far = replace(look_plainly(log, 0.9), gain=14.0, gain_std=0.5)
    monkeypatch.setattr(first_look, "look_at_moving", lambda *_: [far])
    before = [verdict("gain_x", NOT_IDENTIFIABLE, 3.0, -9.0, 20.0)]
    gain = assess_plainly(log, "x", "rad", before)[0][0]
    assert (gain.high, gain.word) == (15.0, PLAIN_VERDICT)
    assert gain.value == pytest.approx(7.007, rel=0.02)


def test_a_log_that_shows_nothing_keeps_its_verdicts(log):
    still = AxisLog(log.time, 0 * log.tilt, True, log.sampled, log.ball)
    before = [verdict("gain_x", NOT_IDENTIFIABLE)]
    assert assess_plainly(still, "x", "rad", before) == (before, [])


def test_delays_that_no_scenario_has_are_told():
    lag = verdict("lag_x", IDENTIFIED_VERDICT, 0.05, 0.04, 0.06)
    x = verdict("delay_x", IDENTIFIED_VERDICT, 0.10, 0.09, 0.11)
    near = verdict("delay_y", IDENTIFIED_VERDICT, 0.105, 0.095, 0.115)
    far = verdict("delay_y", IDENTIFIED_VERDICT, 0.15, 0.14, 0.16)
    assert describe_lags([verdict("lag_x", NOT_IDENTIFIABLE)]) == []
    (note,) = describe_lags([lag])
    assert "a filter of the positions" in note
    assert len(describe_lags([x, near])) == 1
    assert "0.1 s) and y (0.15 s)" in describe_lags([x, far])[1]


def test_the_report_names_numbers_of_the_plain_model(log):
    found = AxisIdentification(
        source="a", seconds=1.0, verdicts=(verdict("gain_x", PLAIN_VERDICT, 7.0, 5.0, 9.0),),
        scores=(), predictions={}, notes=(), extent="", remarks=(), factor=0.6, ball=None,
    )  # fmt: skip
    assert any("Of a plain model" in each and "gain" in each for each in sentences(found))


@pytest.mark.long
def test_five_numbers_are_found_by_scipy_on_a_linear_rig(log):
    found = fit_five_numbers_by_scipy(log.time, log.tilt, log.sampled, log.ball)
    assert found.gain == pytest.approx(7.007, rel=0.02)
    assert found.damping == pytest.approx(0.8, abs=0.06)
    assert found.dead_time == pytest.approx(0.1, abs=0.01)
    assert found.friction < 0.01
    begin = np.arange(1.0, 25.0)
    off = predict_five_numbers(found, log.time, log.tilt, log.sampled, log.ball, begin)
    assert np.nanmedian(np.abs(off)) < 2e-3


@pytest.mark.long
@pytest.mark.parametrize(
    "rig", [Rig(), TUBE, Rig(play=0.014), Rig(viscous=0.8), Rig(presliding=2e-3, friction=0.08)]
)
def test_another_run_is_predicted_at_least_as_well_as_by_five_numbers(rig):
    logs = []
    for seed in (11, 12):
        time, sampled, ball, command, _ = simulate_log(seed, rig)
        axis = AxisLog(time, command, True, sampled, ball)
        logs.append(AnyLog(f"{seed}.csv", {"x": axis}, {"x": "rad"}, ()))
    found = identify_axes(logs[:1], logs[1:]).predictions["x"]
    known, held = (join_logs([each.axes["x"]]) for each in logs)
    plain = fit_five_numbers_by_scipy(known.time, known.tilt, known.sampled, known.ball)
    other = predict_five_numbers(plain, held.time, held.tilt, held.sampled, held.ball, found.begin)
    medians = [np.nanmedian(np.abs(e[found.moves])) for e in (found.errors("model", 1.0), other)]
    assert medians[0] <= medians[1]
