"""`twin.shadow.learning`: What the beginning of a log teaches, and how a reference differs."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from twin.identify.logs import of_columns
from twin.run.logs import NEEDED_COLUMNS
from twin.scenario.load import load
from twin.shadow import learning
from twin.shadow.alarms import SequentialTests
from twin.shadow.belief import WATCHED_PARAMETERS, Belief
from twin.shadow.follow import Shadow
from twin.shadow.learning import (
    COMPARED_PARAMETERS,
    HEALTHY_CHANGE_STDS,
    MAX_CHANCE_STDS,
    MAX_REFERENCE_SCORE,
    SAME_MOTION_SHARE,
    TRACK_STEP_S,
    Difference,
    HealthyTwin,
    ball_track,
    compare_with_reference,
    motion_distance,
    shift_parameters,
)
from twin.shadow.report import sentences

LOG = of_columns(dict.fromkeys(NEEDED_COLUMNS, np.zeros(0)), {}, "log")


def believed(*settings):
    return Belief.of(load("circle", list(settings)), LOG)


def shift(**by):
    return np.array([by.get(name, 0.0) for name in WATCHED_PARAMETERS])


def circle(seconds, since=0.0, radius=0.1):
    """The track of a ball on a circle, noisy, m."""
    time = since + np.arange(0, seconds, TRACK_STEP_S)
    place = radius * np.stack((np.cos(time), np.sin(time)), axis=-1)
    return place + 0.001 * np.random.default_rng(round(since) + 9).standard_normal(place.shape)


def compared(monkeypatch, belief, track=None, **by):
    """What is said of a log to which the fit moves the twin by so much.

    The reference is a circle, and so is the log unless a track is given.
    """

    def fitted(_log, given, _gaps):
        return replace(shift_parameters(given, shift(**by)), constant=np.full(11, 1e-6)), 0.0

    monkeypatch.setattr(learning, "fit_belief", fitted)
    own = circle(20.0, 5.0) if track is None else track
    monkeypatch.setattr(learning, "ball_track", lambda _: own)
    return compare_with_reference(None, HealthyTwin(belief, circle(30.0)), None)


@pytest.mark.parametrize(
    ("name", "by", "said"),
    [
        ("rolling", 1.8e-4, "rolling friction 0.180 -> 0.360 mm (+100 %)"),
        ("delay", 0.03, "dead time +30.0 ms"),
        ("level_phi", np.radians(0.5), "level phi 0.100 -> 0.600 deg"),
        ("level_theta", np.radians(-0.5), "level theta -0.200 -> -0.700 deg"),
        ("gain", -0.15, "tilt gain -15.0 %"),
        ("breakaway", 0.5, "breakaway ratio +0.50"),
        ("lag", 0.02, "drive lag +20.0 ms"),
        ("transmission", 0.1, "plate angle over command +10.0 %"),
        ("noise", np.log(3.0), "screen noise x 3.00"),
    ],
)
def test_a_parameter_that_has_moved_is_said_first(monkeypatch, name, by, said):
    belief = believed("plant.friction.rolling_mm=0.18", "plant.level_deg=[0.1, -0.2]")
    found = compared(monkeypatch, belief, **{name: by})
    assert {each.name for each in found} == {*COMPARED_PARAMETERS}
    assert [each.name for each in found if each.significant] == [name]
    assert (found[0].name, found[0].words) == (name, said)
    assert found[0].change == pytest.approx(by, rel=1e-6)


def test_a_friction_that_was_none_has_no_share(monkeypatch):
    belief = believed("plant.kind=lagrange", "plant.friction.rolling_mm=0.0002")
    found = compared(monkeypatch, belief, rolling=5e-5)
    assert found[0].words == "rolling friction 0.000 -> 0.050 mm"


def test_a_rig_of_one_axis_has_one_level(monkeypatch):
    found = compared(monkeypatch, believed("parameters=tube"), delay=0.03)
    assert "level_theta" not in {each.name for each in found}
    assert "level_phi" in {each.name for each in found}


def test_the_same_motion_is_found_at_any_shift_in_time_and_across_gaps():
    reference = circle(30.0)
    cut = circle(20.0, 7.3)
    cut[100:150] = np.nan
    for track in (circle(20.0, 7.3), circle(20.0, -6.0), cut):
        assert motion_distance(track, reference) == pytest.approx(np.sqrt(2) * 0.01, abs=0.02)
    line = circle(20.0) * (1.0, 0.0)
    for other in (line, circle(20.0, radius=0.06), circle(40.0)[::2]):
        assert motion_distance(other, reference) > SAME_MOTION_SHARE
    assert motion_distance(circle(9.0), reference) == np.inf


def test_a_track_has_no_ball_in_a_gap():
    time = np.arange(0.0, 3.0, 0.02)
    parts = [
        SimpleNamespace(sampled=part, ball=np.stack((part, -part), axis=-1))
        for part in (time[:50], time[100:])
    ]
    track = ball_track(SimpleNamespace(segments=parts))
    at = TRACK_STEP_S * np.arange(len(track))
    inside = (at <= 0.98 + 1e-9) | (at >= 2.0 - 1e-9)
    np.testing.assert_allclose(track[inside], np.stack((at, -at), axis=-1)[inside])
    assert np.isnan(track[~inside]).all()
    assert len(track) == 75


def test_a_dead_time_counts_for_more_in_a_log_of_the_same_motion(monkeypatch):
    """A change between both limits, which the scales of the calibration set."""
    about = HEALTHY_CHANGE_STDS["delay"]
    between = MAX_CHANCE_STDS * 1e-6 * (about["scale"] + about["same_motion_scale"]) / 2
    line = circle(20.0) * (1.0, 0.0)
    for track, seen in ((None, True), (line, False)):
        found = compared(monkeypatch, believed(), track, delay=between)
        assert [each.name for each in found if each.significant] == ["delay"] * seen
        said = " ".join(sentences(report(*found)))
        assert ("Their motion differs from the reference" in said) == (not seen)


def rolling_std(value, fit_std):
    """Standard deviation of a difference of the rolling friction."""
    about = HEALTHY_CHANGE_STDS["rolling"]
    return np.sqrt((about["scale"] * fit_std) ** 2 + (about["between"] * value) ** 2)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_chance_is_what_both_fits_and_healthy_logs_leave_open(share):
    """A change of a share of the limit, which is the root of the sum of squares."""
    limit = MAX_CHANCE_STDS * rolling_std(2e-4, 3e-6)
    found = Difference("rolling", 2e-4, -share * limit, 3e-6, 2e-4)
    assert found.significant == (share > 1)
    assert found.deviation == pytest.approx(-share * MAX_CHANCE_STDS)


def report(*differences):
    return Shadow(SequentialTests(believed()), moved_s=20.0, length=30.0, differences=differences)


def test_a_log_that_differs_is_not_called_healthy():
    fine = Difference("delay", 0.04, 0.0, 1e-3, 1.0)
    doubled = Difference("rolling", 1.8e-4, 1.8e-4, 1e-6, 1.8e-4)
    assert not report(fine).differs
    assert report(fine).verdict == "healthy"
    found = report(doubled, fine)
    assert found.differs
    assert found.verdict == found.as_dict()["verdict"] == "differs"
    said = " ".join(sentences(found))
    assert "Healthy" not in said
    assert (
        "Differs from the reference since its first row: rolling friction 0.180 -> 0.360 mm "
        "(+100 %)" in said
    )
    assert "dead time" not in said
    assert [each["significant"] for each in found.as_dict()["differences"]] == [True, False]


def test_a_log_that_agrees_states_what_would_not_be_seen():
    std = 1e-6
    limit = MAX_CHANCE_STDS * rolling_std(1.8e-4, std) / 1.8e-4
    said = " ".join(sentences(report(Difference("rolling", 1.8e-4, 0.0, std, 1.8e-4))))
    assert "agree with the reference" in said
    assert f"rolling friction below {100 * limit:.0f} %" in said
    assert "reference" not in " ".join(sentences(report()))


@pytest.mark.parametrize("alarms", [[], [SimpleNamespace(words="9 s")]])
def test_a_twin_that_does_not_follow_its_reference_says_nothing_of_other_logs(alarms):
    found = replace(report(), alarms=alarms, reference_score=MAX_REFERENCE_SCORE + 0.1)
    assert found.verdict == "cannot tell"
    words = " ".join(sentences(found))
    assert words.startswith("Cannot tell: the twin does not follow the reference log itself")
    assert "2.6 times as far" in words
    assert "Alarm" not in words
    near = replace(found, reference_score=MAX_REFERENCE_SCORE - 0.1)
    assert near.verdict == ("alarm" if alarms else "healthy")
