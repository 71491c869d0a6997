"""`twin.identify.suspicions`: wrong signs, axes, units, balls and clocks, by their names."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from command_line import ballplate  # noqa: F401  a fixture

from docs.identify_errors import Rig, simulate_log
from twin.identify.axis_logs import AxisLog
from twin.identify.first_look import look_first
from twin.identify.suspicions import are_axes_exchanged, describe_suspicions

SOLID, HOLLOW = 5 / 7, 3 / 5


def axis_of(seed, rig, sign=1.0):
    time, sampled, ball, command, _ = simulate_log(seed, rig)
    return AxisLog(time, sign * command, True, sampled, ball)


@pytest.fixture(scope="module")
def log():
    return axis_of(1, Rig(seconds=25.0))


def suspected(log, factor=SOLID, unit="rad"):
    look = look_first(log)
    return list(describe_suspicions({"x": log}, {"x": unit}, {"x": look}, factor))


def test_a_log_without_a_mistake_is_not_suspected(log):
    assert suspected(log) == []
    y = replace(axis_of(2, Rig(seconds=25.0)), tilt=-axis_of(2, Rig(seconds=25.0)).tilt)
    both = {"x": log, "y": y}
    looks = {axis: look_first(each) for axis, each in both.items()}
    assert list(describe_suspicions(both, dict.fromkeys("xy", "rad"), looks, SOLID)) == []


def test_a_wrong_sign_is_named_with_the_column(log):
    (found,) = suspected(replace(log, tilt=-log.tilt))
    assert found.startswith("x: wrong sign of command_phi")
    assert "command_phi=-NAME" in found


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (math.degrees(1), "degrees taken for radians"),
        (math.radians(1), "radians taken for degrees"),
    ],
)
def test_a_wrong_unit_of_angles_is_named(log, factor, says):
    (found,) = suspected(replace(log, tilt=factor * log.tilt))
    assert says in found


def test_counts_are_no_wrong_unit(log):
    assert suspected(replace(log, tilt=math.degrees(1) * log.tilt), unit="count") == []


@pytest.mark.short("*-solid")
@pytest.mark.parametrize(
    ("share", "assumed", "name"), [(SOLID, HOLLOW, "solid"), (HOLLOW, SOLID, "hollow")]
)
def test_a_ball_that_is_not_the_assumed_one_is_named(share, assumed, name):
    log = axis_of(3, Rig(gain=share * 9.81))
    (found,) = suspected(log, assumed)
    assert f"of a {name} ball" in found
    assert f"--ball {name}" in found
    assert suspected(log, share) == []
    # the variants of a look leave its gain open, however small its scatter is
    look = look_first(log)
    open_gain = replace(look, variants=(replace(look, gain=assumed * 9.81),))
    assert list(describe_suspicions({"x": log}, {"x": "rad"}, {"x": open_gain}, assumed)) == []


@pytest.mark.long
def test_exchanged_axes_are_named_and_the_right_ones_are_not(log):
    both = {"x": log, "y": axis_of(2, Rig(seconds=25.0), -1.0)}
    assert not are_axes_exchanged(both)
    assert not are_axes_exchanged({"x": log})
    x, y = both.values()
    crossed = {"x": replace(x, time=y.time, tilt=y.tilt), "y": replace(y, time=x.time, tilt=x.tilt)}
    assert are_axes_exchanged(crossed)
    looks = {axis: look_first(each) for axis, each in crossed.items()}
    (found,) = describe_suspicions(crossed, dict.fromkeys("xy", "rad"), looks, SOLID)
    assert "the axes look exchanged" in found


@pytest.mark.short("0.0005")
@pytest.mark.parametrize("drift", [5e-4, -5e-4])
def test_a_clock_that_drifts_shows_at_first_sight_in_a_long_log(drift):
    log = axis_of(4, Rig(seconds=90.0, drift=drift))
    look = look_first(log)
    assert look.drifts()
    assert look.drift == pytest.approx(drift, abs=3 * look.drift_std)
    assert any("clock of the positions looks" in each for each in suspected(log))
    mended = look_first(log.with_clock(drift))
    assert not mended.drifts()
    assert mended.delay == pytest.approx(0.1, abs=0.01)


def test_a_log_with_a_slower_clock_begins_at_the_same_time(log):
    slow = log.with_clock(0.01)
    assert slow.sampled[0] == pytest.approx(log.sampled[0])
    assert np.ptp(slow.sampled) == pytest.approx(np.ptp(log.sampled) / 1.01)
    assert (slow.time == log.time).all()


@pytest.mark.long
def test_identify_says_a_suspicion_once(ballplate, tmp_path, write):  # noqa: F811
    time, sampled, ball, command, _ = simulate_log(1, Rig(seconds=15.0))
    at = np.searchsorted(time, sampled, "right") - 1
    columns = {"time": sampled, "x": ball, "u": -command[np.maximum(at, 0)]}
    write(tmp_path / "rig.csv", columns)
    roles = "time=time,measured_x=x,command_phi=u"
    code, out, err = ballplate("identify", "rig.csv", "--columns", roles)
    assert code == 0
    said = " ".join(err.split())
    assert "warning: x: wrong sign of command_phi" in said
    assert f"{out} {said}".count("wrong sign of command_phi") == 1
    (report,) = tmp_path.rglob("report.html")
    assert "wrong sign of command_phi" in report.read_text(encoding="utf-8")
