"""`twin.shadow.alarms`.

The twin beside a log: calibrated on healthy rigs, alarmed by changed ones, honest otherwise."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from twin.base.errors import LogError, TwinError
from twin.cli.understand import shadow as command
from twin.identify.logs import MECHANISM_LAG, of_columns, read
from twin.run.finished import run, save
from twin.scenario import load
from twin.shadow.alarms import CHANGE_TEST, Before
from twin.shadow.belief import WATCHED_PARAMETERS, Belief, belief_of, check_commands, logs
from twin.shadow.causes import weigh
from twin.shadow.evidence import NO_EVIDENCE, Evidence, log_evidence, posterior
from twin.shadow.follow import LEARNING_S, shadow
from twin.shadow.plate import PLAY_WIDTHS_RAD, whiten
from twin.shadow.report import page

ROLLING = '"plant.friction.rolling_mm"=0.234'
CHANGES = {
    "rolling friction": ROLLING,
    "level": '"plant.level_deg"=[0.1, 0.0]',
}
"""What happens to rigs beside each other on the exact equations, by the cause that is right,"""
MECHANICAL = {
    "servo lag": '"plant.servo.bandwidth_hz"=8.0',
    "lost motion": '"plant.servo.backlash_deg"=0.1',
    "sensor noise": '"sensors.touch.variance"=[1.632e-6, 3.987e-7]',
    "another ball": '"plant.ball.mass"=0.263, "plant.ball.inertia"=4.208e-5, '
    '"plant.friction.rolling_mm"=0.05',
}
"""and on the mechanism."""


def load_pair(change, at, *more):
    """What is believed of a rig, and the rig to which something happens at a time in s."""
    changes = f"change=[{{at={at}, set={{{change}}}}}]" if change else "change=[]"
    return load("excite", ("seed=5", *more)), load("excite", ("seed=5", *more, changes))


def beside(changes, *of):
    """Logs of a healthy rig and others by what happened to them."""
    changes = {"healthy": "", **changes}
    return dict(
        zip(changes, logs([load_pair(each, *of) for each in changes.values()]), strict=True)
    )


def test_the_twin_of_a_csv_log_has_the_ball_that_is_stated_for_it():
    rows = np.zeros(3)
    names = ("measured_x", "measured_phi", "measured_y", "measured_theta")
    log = of_columns({"time": 0.002 * np.arange(3), **dict.fromkeys(names, rows)}, {}, "a.csv")
    ball = belief_of(log, (), 5 / 7).scenario.plant.ball
    assert ball.inertia == pytest.approx(2 / 5 * ball.mass * ball.radius**2)
    assert belief_of(log).scenario.plant.ball.inertia == pytest.approx(6.4e-6)
    with pytest.raises(LogError, match="--ball: not allowed; a run states its ball"):
        belief_of(replace(log, scenario=load("circle").model_dump(mode="json")), (), 5 / 7)


@pytest.fixture(scope="module")
def recorded():
    """Logs of the rigs on the exact equations by what happened to them."""
    return beside(CHANGES, 7.0, "plant.kind=lagrange", "duration=15")


@pytest.fixture(scope="module")
def found(recorded):
    """What is said of every rig, by what happened to it."""
    return {name: shadow(log, belief_of(log)) for name, log in recorded.items()}


@pytest.fixture(scope="module")
def mechanisms():
    """What is said of every rig on the mechanism, by what happened to it."""
    logs = beside(MECHANICAL, 10.0, "duration=28")
    return {name: shadow(log, belief_of(log)) for name, log in logs.items()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder of a mechanism whose friction has risen."""
    path = tmp_path_factory.mktemp("run") / "drifted"
    done = run(load_pair(ROLLING, 10.0, "duration=40")[1])
    save(done, path, {"run": done.motion})
    return path


@pytest.mark.long
def test_a_healthy_rig_is_called_so_and_strays_as_far_as_predicted(found):
    healthy = found["healthy"]
    assert healthy.verdict == "healthy"
    assert 0.5 < healthy.score_median < 1.5
    assert healthy.inside_band > 80
    assert healthy.error_1s < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("cause", [*CHANGES, *MECHANICAL])
def test_a_change_is_an_alarm_in_time_with_the_right_cause_before_all_others(request, cause):
    exact = cause in CHANGES
    alarm = request.getfixturevalue("found" if exact else "mechanisms")[cause].alarms[0]
    assert (7 if exact else 10) < alarm.time < (14 if exact else 20)
    assert alarm.causes[0].name == cause
    assert sum(each.probability for each in alarm.causes) == pytest.approx(1)


@pytest.mark.long
def test_the_mechanism_is_healthy_beside_the_exact_twin(mechanisms):
    assert mechanisms["healthy"].verdict == "healthy"
    assert mechanisms["healthy"].error_1s < 1e-3


@pytest.mark.long
def test_a_score_rises_when_friction_does(found):
    run = found["rolling friction"].replays
    before = run.counted & (run.time + 1 < 7)
    after = run.counted & (run.time > 7)
    assert np.median(run.score[after]) > 3 * np.median(run.score[before])


@pytest.mark.long
def test_a_ball_at_rest_is_no_sign_of_health():
    log = logs([(each := load("hold", ("plant.kind=lagrange", "duration=8")), each)])[0]
    said = shadow(log, belief_of(log))
    assert said.verdict == "cannot tell"
    assert said.moved_s < 5


def test_log_evidence_is_the_integral_over_the_prior():
    A, b, V, m = 7.0, 3.0, 0.4, -0.3
    d = np.linspace(-8, 8, 400_001)
    weight = np.exp(-((d - m) ** 2) / (2 * V)) / math.sqrt(2 * math.pi * V)
    exact = math.log(np.trapezoid(np.exp(b * d - A * d**2 / 2) * weight, d))
    one = np.ones((1, 1))
    args = (A * one, b * one[0], V * one, m * one[0])
    assert log_evidence(*args) == pytest.approx(exact, rel=1e-9)
    mean, covariance = posterior(*args)
    assert mean[0] == pytest.approx((b + m / V) / (A + 1 / V))
    assert covariance[0, 0] == pytest.approx(1 / (A + 1 / V))


def test_innovations_of_a_disturbed_angle_seen_by_encoders_are_white_with_variance_one():
    rng = np.random.default_rng(1)
    period, disturbance, encoder = 0.002, 1e-4, 1e-8
    kick = math.sqrt(disturbance) * rng.standard_normal(40_000)
    rate = period * np.cumsum(kick)
    angle = period * np.cumsum(rate) + math.sqrt(encoder) * rng.standard_normal(40_000)
    e = whiten(angle, period, disturbance, encoder)[2000:]
    assert e.std() == pytest.approx(1, abs=0.03)
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.03


@pytest.mark.parametrize(("believed_play", "named"), [(0.2, True), (0.0, False)])
def test_lost_motion_may_have_gone_where_there_was_some(believed_play, named):
    log = SimpleNamespace(own_lag=MECHANISM_LAG, grips=(0.0,))
    belief = Belief.of(load("excite", [f"plant.servo.backlash_deg={believed_play}"]), log)
    spans = np.stack((np.arange(10.0), np.arange(1.0, 11.0)), axis=-1)
    seen, less = np.array(PLAY_WIDTHS_RAD), np.radians(-0.1)
    A, b = np.tile(3e7 * np.outer(seen, seen), (10, 1, 1)), np.tile(3e7 * less * seen, (10, 1))
    windows = Evidence.of(("narrow_play", "wide_play"), spans, A, b)
    before = Before(
        np.zeros(len(WATCHED_PARAMETERS)), belief.uncertainty + np.diag(belief.drift**2)
    )
    causes = {each.name: each for each in weigh(NO_EVIDENCE, None, windows, before, belief)}
    assert (causes["lost motion"].probability > 0.5) == named
    assert causes["lost motion"].change.startswith("-0.")


@pytest.mark.long
def test_a_log_without_commands_is_refused_by_one_line(recorded):
    log = replace(recorded["healthy"], command=None)
    with pytest.raises(LogError, match="no columns applied_phi_acc"):
        check_commands(log)


@pytest.mark.long
def test_a_log_that_is_too_short_is_refused_by_one_line(recorded):
    log = recorded["healthy"].rows(slice(0, 700))
    with pytest.raises(LogError, match=r"no stretch of 2\.5 s"):
        shadow(log, belief_of(log))


@pytest.mark.long
def test_a_gap_is_shown_and_never_bridged(recorded):
    log = recorded["healthy"].rows(np.r_[0:3000, 3400:7000])
    said = shadow(log, belief_of(log))
    assert said.gaps == pytest.approx(np.array([[5.998, 6.8]]))
    run = said.replays
    assert (run.time < 6).any()
    assert (run.time > 6.8).any()
    assert not ((run.time < 6.8) & (run.time + 1 > 6)).any()
    assert "1 gap of 0.80 s" in page(said)


@pytest.mark.long
def test_a_scenario_of_another_version_is_refused_by_one_line(recorded):
    log = recorded["healthy"]
    strange = {**log.scenario, "plant": {**log.scenario["plant"], "of_tomorrow": 1}}
    with pytest.raises(TwinError, match="of_tomorrow: unknown key"):
        belief_of(replace(log, scenario=strange))


@pytest.mark.long
def test_every_parameter_has_an_uncertainty(recorded):
    belief = belief_of(recorded["healthy"])
    assert belief.constant.shape == (len(WATCHED_PARAMETERS),)
    assert (belief.constant > 0).all()
    assert (belief.changing > 0).all()


@pytest.mark.long
def test_a_healthy_rig_with_play_under_the_cure_raises_no_alarm():
    chosen = load("cure", ("plant.servo.backlash_deg=0.2", "plant.step=0.002"))
    (log,) = logs([(chosen, chosen)])
    said = shadow(log, belief_of(log))
    assert said.verdict == "healthy"
    assert said.tests.ratio.max() < CHANGE_TEST.threshold_llr / 3


@pytest.mark.long
def test_the_command_says_when_and_why(folder):
    done = CliRunner().invoke(command, [str(folder), "--json"])
    numbers = json.loads(done.stdout[done.stdout.index("{") :])
    assert done.exit_code == 0  # click's own; the value returned is the exit code of ballplate
    assert numbers["alarms"][0]["causes"][0]["name"] == "rolling friction"
    assert numbers.keys() >= {"score_median", "inside_band_percent", "replay_error_1s_mm"}
    assert "rolling friction" in (folder / "shadow.html").read_text(encoding="utf-8")


WRONG = ("plant.friction.rolling_mm=0.2", "plant.level_deg=[0.1,-0.05]")


@pytest.mark.long
def test_a_twin_that_was_identified_learns_what_is_open_before_it_judges():
    """Friction 11 % and level 0.1 deg off: an alarm at once, none of a twin that may learn."""
    (log,) = logs([load_pair("", 0.0, "plant.kind=lagrange", "duration=50")])
    wrong = belief_of(log, WRONG)
    assert shadow(log, wrong).alarms[0].time < 15
    said = shadow(log, wrong, learning=True)
    assert said.verdict == "healthy"
    assert "rolling friction -1" in said.taught
    assert said.score_median < 2
    assert said.replays.time.min() >= LEARNING_S


@pytest.mark.long
@pytest.mark.parametrize("cause", CHANGES)
def test_a_change_after_it_has_learned_is_told_with_its_cause(cause):
    (log,) = logs([load_pair(CHANGES[cause], 30.0, "plant.kind=lagrange", "duration=55")])
    said = shadow(log, belief_of(log, WRONG), learning=True)
    assert 30 < said.alarms[0].time < 50
    assert said.alarms[0].causes[0].name == cause


@pytest.mark.long
def test_a_twin_that_knows_of_the_change_raises_no_alarm_after_it(folder):
    log = read(folder)
    known = shadow(log, belief_of(log, ("plant.friction.rolling_mm=0.234",)))
    late = [alarm for alarm in known.alarms if alarm.since > 14]
    assert not late
    after = known.replays.counted & (known.replays.time > 10)
    assert np.median(known.replays.score[after]) < 2
