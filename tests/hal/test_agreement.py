"""`twin.hal.agreement`: motors and plate turn together, or how they do not."""

import numpy as np
import pytest

from twin.hal.agreement import (
    DRIVES_EXCHANGED,
    EXCHANGED,
    MOTION_TEST,
    OPPOSITE,
    UPHILL,
    WRONG_RATIO,
    Agreement,
    BallAgreement,
    MotionTest,
)
from twin.hal.cams import CamTable, FixedRatio
from twin.hal.linkage import Linkage

RODS = {"crank": (0.04, 0.028), "rod": (0.09, 0.09), "arm": (0.1, 0.07), "distance": (0.06, 0.042)}
KINDS = {"direct": FixedRatio(), "cams": CamTable.packaged(), "rods": Linkage(**RODS)}
LOST = np.radians(0.6)
PERIODS = (0.001, 0.002, 0.004)


@pytest.fixture(params=KINDS)
def transmission(request):
    return KINDS[request.param]


@pytest.fixture(params=PERIODS)
def period(request):
    return request.param


def circle(period, degrees=4.0, seconds=2.0):
    """Plate angles that begin at level and swing by some degrees, a quarter turn apart, (n, 2)."""
    time = period * np.arange(round(seconds / period))
    grown = np.minimum(time / 0.5, 1.0)[:, None]
    swing = np.stack((np.sin(4 * time), -np.cos(4 * time)), axis=1)
    return np.radians(degrees) * grown * swing


def compared(transmission, period, plate, motor_of=None, lost=LOST, test=MOTION_TEST):
    """The disagreement of plate encoders with motors that hold other angles; where that was."""
    agreement = Agreement(transmission, lost, period, test)
    motors = transmission.motor(plate if motor_of is None else motor_of)
    for each, motor in zip(plate, motors, strict=True):
        found = agreement.look(each, motor)
        if found is not None:
            return found, each, agreement
    return None, plate[-1], agreement


WRONG = {
    "phi the other way": (lambda true: true * (-1, 1), OPPOSITE),
    "theta the other way": (lambda true: true * (1, -1), OPPOSITE),
    "both the other way": (lambda true: -true, OPPOSITE),
    "exchanged": (lambda true: true[:, ::-1], EXCHANGED),
    "phi twice": (lambda true: true * (2, 1), WRONG_RATIO),
    "theta half": (lambda true: true * (1, 0.5), WRONG_RATIO),
    "both twice": (lambda true: true * 2, WRONG_RATIO),
    "phi 1.5": (lambda true: true * (1.5, 1), WRONG_RATIO),
    "theta 2/3": (lambda true: true * (1, 2 / 3), WRONG_RATIO),
    "phi slips": (lambda true: true * (0, 1), WRONG_RATIO),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_sign_scale_or_exchange_is_found_while_the_plate_is_hardly_tilted(
    wrong, transmission, period
):
    measured, condition = WRONG[wrong]
    true = circle(period)
    found, at, _ = compared(transmission, period, measured(true), true)
    assert found is not None
    assert found.condition is condition
    assert np.degrees(np.abs(at).max()) < 5.0
    if wrong.endswith("way"):
        assert np.degrees(np.abs(at).max()) < 1.5


def test_a_wrong_scale_is_found_in_slow_motion_too(period):
    time = period * np.arange(round(8.0 / period))[:, None]
    true = np.radians(4.0) * np.sin(0.5 * time) * (1, 0)
    found, at, _ = compared(FixedRatio(), period, 0.5 * true, true)
    assert found.condition is WRONG_RATIO
    assert np.degrees(np.abs(at).max()) < 1.5


def test_a_part_that_slips_after_wide_motion_is_found_by_the_last_moments(period):
    wide, small = circle(period, 9.0), circle(period, 3.0)
    true = np.concatenate((wide, wide[-1] + small))
    measured = np.concatenate((wide, wide[-1] + 0.4 * small))
    found, _, _ = compared(FixedRatio(), period, measured, true)
    assert found.condition is WRONG_RATIO


def test_a_transmission_that_is_not_linear_is_no_disagreement_at_all(transmission):
    exact = MotionTest(max_difference=0.0)
    found, _, _ = compared(transmission, 0.002, circle(0.002, 9.0), lost=1e-6, test=exact)
    assert found is None


def test_a_change_in_the_middle_of_a_run_is_found_and_named_by_what_came_since(period):
    true = circle(period)
    half = len(true) // 2
    measured = true.copy()
    measured[half:] = 2 * true[half] - true[half:]
    found, at, _ = compared(FixedRatio(), period, measured, true)
    assert found.condition is OPPOSITE
    assert np.degrees(np.abs(at - true[half]).max()) < 3.0


def test_motors_and_plate_that_turn_together_agree(transmission, period):
    found, _, agreement = compared(transmission, period, circle(period, 9.0))
    assert found is None
    assert agreement.proven


@pytest.mark.parametrize(("lost", "agrees"), [(0.5, True), (2.0, False)])
def test_what_is_lost_by_play_is_no_disagreement_as_far_as_it_is_expected(lost, agrees, period):
    true, output = circle(period), np.zeros(2)
    half, measured = np.radians(lost) / 2, []
    for each in true:
        output = np.clip(output, each - half, each + half)
        measured.append(output)
    found, _, _ = compared(FixedRatio(), period, np.array(measured), true)
    assert (found is None) == agrees


@pytest.mark.parametrize(("scale", "agrees"), [(1.2, True), (1 / 1.2, True), (1.5, False)])
def test_a_transmission_that_is_known_badly_is_none(scale, agrees, period):
    true = circle(period, 6.0)
    found, _, _ = compared(FixedRatio(), period, scale * true, true)
    assert (found is None) == agrees


@pytest.mark.parametrize("axis", [0, 1])
def test_an_encoder_that_freezes_is_no_wrong_scale_but_has_a_condition_of_its_own(axis, period):
    time = period * np.arange(round(1.0 / period))
    true = np.radians([10.0, -12.0]) * time[:, None]
    seen = true.copy()
    seen[time > 0.5, axis] = seen[time <= 0.5, axis][-1]
    assert compared(FixedRatio(), period, seen, true)[0] is None
    slips = true.copy()
    slips[time > 0.5, axis] -= 0.8 * (slips[time > 0.5, axis] - slips[time <= 0.5, axis][-1])
    assert compared(FixedRatio(), period, slips, true)[0].condition is WRONG_RATIO


def test_nothing_is_proven_before_both_axes_have_turned():
    true = circle(0.002)
    _, _, agreement = compared(FixedRatio(), 0.002, true * (1, 0))
    assert not agreement.proven
    _, _, agreement = compared(FixedRatio(), 0.002, 0.2 * true)
    assert not agreement.proven


def test_a_transmission_that_gives_no_number_says_nothing_of_the_plate():
    agreement = Agreement(FixedRatio(np.nan), LOST, 0.002)
    assert agreement.look(np.zeros(2), np.zeros(2)) is None


def rolled(
    period, as_if=lambda phi, theta: (phi, theta), *, k=7.0, noise=2e-4, push=0.0, seconds=2.0
):
    """What disagrees of a ball on a plate that is tilted otherwise than measured, and when, s.

    Args:
        period: Control period in s.
        as_if: The true angles for the measured ones, rad.
        k: Acceleration per angle, m/s^2.
        noise: Of the positions, m.
        push: Acceleration in m/s^2 along x for a tenth of a second, from 0.5 s on.
        seconds: Duration in s.
    """
    rng = np.random.default_rng(1)
    agreement, late = BallAgreement(period), []
    ball, rate, seen = np.zeros(2), np.zeros(2), np.zeros(2)
    frame = round(0.0174 / period)
    for tick in range(round(seconds / period)):
        time = tick * period
        measured = np.radians([2 * np.sin(5 * time), -1.5 * np.cos(4 * time)])
        phi, theta = as_if(*measured)
        force = np.array([k * phi, -k * theta])
        force[0] += push * (0.5 <= time < 0.6)
        rate = rate + period * force
        ball = ball + period * rate
        late.append(ball + rng.normal(0.0, noise, 2))
        if tick % frame == 0:
            seen = late[max(0, tick - round(0.042 / period))]
        found = agreement.look(seen, measured, True)
        if found is not None:
            return found[0], time
    return None, seconds


ROLLS = {
    "exchanged": (lambda phi, theta: (theta, phi), DRIVES_EXCHANGED),
    "phi": (lambda phi, theta: (-phi, theta), UPHILL),
    "theta": (lambda phi, theta: (phi, -theta), UPHILL),
    "both": (lambda phi, theta: (-phi, -theta), UPHILL),
}


@pytest.mark.parametrize("wrong", ROLLS)
def test_a_ball_that_rolls_another_way_than_the_plate_is_tilted_tells_which(wrong, period):
    as_if, condition = ROLLS[wrong]
    found, time = rolled(period, as_if)
    assert found is condition
    assert time < condition.longest(period)


@pytest.mark.parametrize(
    "about",
    [{}, {"k": 5.0}, {"noise": 2e-3}, {"push": 3.0}, {"push": -8.0}, {"noise": 0.02}],
    ids=str,
)
def test_a_ball_that_rolls_downhill_disagrees_with_nothing(about, period):
    assert rolled(period, **about)[0] is None


def test_a_ball_that_is_not_felt_or_felt_nowhere_disagrees_with_nothing():
    agreement = BallAgreement(0.002)
    for tick in range(1000):
        place = np.array([np.nan if tick % 3 else 0.001 * tick, 0.0])
        assert agreement.look(place, np.array([0.05, 0.05]), bool(tick % 2)) is None
