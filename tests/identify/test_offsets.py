"""`twin.identify.offsets`: Commands far from zero, fitted from their middle on."""

from dataclasses import replace

import numpy as np
import pytest

from twin.identify.any_rig import identify_axes
from twin.identify.axis_logs import AnyLog, AxisLog
from twin.identify.offsets import find_offsets, take_out_offsets, tell_level_at_zero
from twin.identify.parameters import plain_parameter
from twin.identify.verdicts import IDENTIFIED_VERDICT, NOT_IDENTIFIABLE, ParameterVerdict

PULSE_US, PULSE_US_PER_RAD = 1480.0, 600.0
T = np.arange(0.0, 20.0, 0.02)
SWING = 40 * np.sin(np.pi * T)


def log_of(tilt, unit="count"):
    return AnyLog("rig.csv", {"x": AxisLog(T, tilt, True, T, 0 * T)}, {"x": unit}, ())


def verdict(name, value, half, word=IDENTIFIED_VERDICT):
    about = plain_parameter(name, "count")
    return ParameterVerdict(
        about=about, name=f"{name}_x", value=value, low=value - half, high=value + half, word=word
    )


@pytest.mark.parametrize(
    ("tilt", "middle"),
    [
        (1480 + SWING, 1480.0),
        (-900 + SWING, -900.0),
        (30 + SWING, None),  # zero is one of the commands
        (np.where(T < 2, 0.0, 400.0), None),  # a step from zero
        (np.full_like(T, 1480.0), None),  # nobody moved it
    ],
)
def test_an_offset_is_the_middle_of_commands_that_stay_far_from_zero(tilt, middle):
    found = find_offsets([log_of(tilt)])
    assert found == ({} if middle is None else {"x": pytest.approx(middle, abs=3.0)})


def test_all_logs_are_taken_from_one_middle_and_a_share_held_out_stays():
    first, other = log_of(1480 + SWING), log_of(1460 + SWING)
    (shifted,), (held,), offsets = take_out_offsets([first], [other])
    assert shifted.axes["x"].tilt == pytest.approx(1480 + SWING - offsets["x"])
    assert held.axes["x"].tilt == pytest.approx(1460 + SWING - offsets["x"])
    assert take_out_offsets([first], 0.3)[1] == 0.3


def test_the_level_at_zero_has_the_error_of_the_gain_as_well():
    levels = [verdict("gain", 0.003, 3e-5), verdict("level", 0.05, 0.01)]
    (gain, level), (note,) = tell_level_at_zero(levels, {"x": 1500.0}, {"x": "count"})
    assert gain == levels[0]
    assert level.value == pytest.approx(0.05 - 4.5)
    half = np.hypot(0.01, 1500 * 3e-5)
    assert (level.low, level.high) == pytest.approx((level.value - half, level.value + half))
    assert level.word == IDENTIFIED_VERDICT
    assert "about 1500 count, where the level is 0.05" in note


@pytest.mark.parametrize("name", ["gain", "level"])
@pytest.mark.parametrize("lost", [("value", "low", "high"), ("low", "high"), ("high",)])
def test_a_level_at_zero_is_known_only_with_values_and_intervals_of_level_and_gain(name, lost):
    """A level without an interval used to stay as it is at the middle, 4.5 m/s^2 off."""
    verdicts = [verdict("gain", 0.003, 1e-4), verdict("level", 0.05, 0.01)]
    k = ("gain", "level").index(name)
    verdicts[k] = replace(verdicts[k], word=NOT_IDENTIFIABLE, **dict.fromkeys(lost))
    (_, level), _ = tell_level_at_zero(verdicts, {"x": 1500.0}, {"x": "count"})
    assert (level.value, level.low, level.high) == (None, None, None)
    assert level.word == NOT_IDENTIFIABLE
    assert f"and the {name}" in level.why


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 5])
def test_pulses_about_1480_us_give_what_their_angles_give(axis_log, seed):
    """Gain and level were nearly one parameter: the gain was 9 % off, with an interval of 1 %."""
    truth = {"gain": 6.0, "level": 0.05, "friction": 0.03}
    log = {"seconds": 35, "rate": 25.0, "noise": 2e-3, "pixel": 1e-3, **truth}
    t, ball, angle = axis_log(seed, **log)
    angles = AnyLog("rig.csv", {"x": AxisLog(t, angle, True, t, ball)}, {"x": "rad"}, ())
    pulse = PULSE_US + PULSE_US_PER_RAD * angle
    pulses = AnyLog("rig.csv", {"x": AxisLog(t, pulse, True, t, ball)}, {"x": "count"}, ())
    by_angle, by_pulse = (identify_axes([each], 1 / 3) for each in (angles, pulses))
    own = {each.name: each for each in by_pulse.verdicts}
    gain = truth["gain"] / PULSE_US_PER_RAD
    assert own["gain_x"].low <= gain <= own["gain_x"].high
    assert own["level_x"].low <= truth["level"] - gain * PULSE_US <= own["level_x"].high
    (one,), (other,) = by_angle.scores, by_pulse.scores
    assert other.median["model"][1] == pytest.approx(one.median["model"][1], rel=0.15)
