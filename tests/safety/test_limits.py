"""`twin.safety.limits`: The limits of the fault matrix against motions computed here."""

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.emulator.drive import Motor
from twin.hal.interface import Clamp, Limits
from twin.safety.faults import CASES
from twin.safety.limits import (
    LEVEL_RAD,
    STANDSTILL_RAD_S,
    AtFault,
    FaultCase,
    Stopper,
    ball_limit,
    standstill_limit,
    tilt_limit,
    torque_off_limit,
)

CASE = {case.name: case for case in CASES}
AT = AtFault(0.03, 0.06, np.array([0.06, 0.01]), np.array([0.1, 0.15]))
PERIOD = 0.002


def row(*stoppers, **more):
    return FaultCase(name="", act=lambda _: None, expected=None, stopped_by=stoppers, **more)


def test_a_quick_stop_takes_two_periods_and_the_ramp_from_8_rad_per_s_at_1000():
    limit = standstill_limit(row(Stopper.QUICK_STOP), 0.01, AT)
    assert limit == pytest.approx(0.01 + 0.004 + 0.008)


def test_the_heartbeat_watch_takes_its_60_ms_or_300_more_where_it_is_withheld():
    assert standstill_limit(row(Stopper.HEARTBEAT), 0.01, AT) == pytest.approx(0.07)
    withheld = row(Stopper.HEARTBEAT, withheld=True)
    assert standstill_limit(withheld, 0.01, AT) == pytest.approx(0.01 + 0.3 + 0.07 + 0.004)


def test_a_host_that_is_more_patient_than_it_stays_on_the_bus_is_waited_for_no_longer():
    host = AkdConfig(silence=0.6, watch=MonitorConfig(stop=2.0))
    withheld = row(Stopper.HEARTBEAT, withheld=True, host=host)
    expected = 0.01 + (0.4 + 0.4 + 0.05) + 0.6 + 0.002 + 0.008 + 0.004
    assert standstill_limit(withheld, 0.01, AT) == pytest.approx(expected)


def test_a_zero_rate_brakes_at_once_and_the_watch_takes_the_torque_later():
    case = row(Stopper.HEARTBEAT, withheld=True, zeroed=True)
    stop = standstill_limit(case, 0.01, AT)
    assert stop == standstill_limit(row(Stopper.QUICK_STOP), 0.01, AT)
    watched = standstill_limit(row(Stopper.HEARTBEAT, withheld=True), 0.01, AT)
    assert torque_off_limit(case, 0.01, stop) == pytest.approx(watched + 0.004)


def test_of_two_axes_the_slower_one_counts():
    slow, fast = (row(each) for each in (Stopper.HEARTBEAT, Stopper.QUICK_STOP))
    mixed = row(Stopper.HEARTBEAT, Stopper.QUICK_STOP)
    assert standstill_limit(mixed, 0.001, AT) == standstill_limit(slow, 0.001, AT)
    assert standstill_limit(fast, 0.001, AT) < standstill_limit(mixed, 0.001, AT)


def test_where_nobody_has_to_stop_there_is_no_standstill_to_wait_for():
    assert standstill_limit(row(Stopper.NOBODY), 0.01, AT) is None


def test_a_motor_without_torque_stands_within_its_limit_but_not_within_a_tenth_less():
    motor, time = Motor(), 0.0
    motor.rate = rate = AT.rate + 2 * 7 * PERIOD
    while abs(motor.rate) > STANDSTILL_RAD_S:
        motor.coast(PERIOD / 4)
        time += PERIOD / 4
    limit = standstill_limit(row(Stopper.STO), 0.0, AT)
    assert rate > STANDSTILL_RAD_S
    assert 0.9 * limit < time <= limit


@pytest.mark.parametrize("detected", [0.01, 0.1, 0.4])
def test_levelling_from_the_largest_tilt_is_over_within_its_limit(detected):
    case = row(Stopper.LEVELLING)
    clamp = Clamp(Limits(), PERIOD)
    angle = np.full((1, 2), tilt_limit(case, detected, 1.0, AT))
    # the largest tilt is where it has braked from the fastest rate
    rate, time = np.zeros((1, 2)), detected + min(AT.rate + 7 * detected, Limits().rate) / 7
    while (np.abs(angle) >= LEVEL_RAD).any() or (np.abs(rate) >= STANDSTILL_RAD_S).any():
        rate = clamp(clamp.towards_level(angle), rate, angle)
        angle = angle + PERIOD * rate
        time += PERIOD
    drift = 0.1  # of the measured angle; here there is none
    limit = standstill_limit(case, detected, AT) - drift
    assert 2 / 3 * limit < time <= limit


@pytest.mark.parametrize("stopper", [Stopper.QUICK_STOP, Stopper.HEARTBEAT, Stopper.STO])
def test_a_plate_driven_as_fast_as_can_be_until_it_stands_keeps_its_limits(stopper):
    case, detected = row(stopper, withheld=True), 0.03
    stop = standstill_limit(case, detected, AT)
    angle, rate, ball, velocity = AT.tilt, AT.rate, AT.ball.copy(), AT.velocity.copy()
    for time in np.arange(0.0, stop, 1e-4):
        if time < detected:
            rate += 1e-4 * 7
        angle += 1e-4 * rate
        velocity += 1e-4 * BallPlate().k1 * np.sin(angle)
        ball += 1e-4 * velocity
    assert angle <= tilt_limit(case, detected, stop, AT)
    assert (ball <= ball_limit(case, detected, stop, AT)).all()


def test_a_rig_that_is_refused_must_not_move_at_all():
    refused = CASE["STO is open"]
    assert tilt_limit(refused, 1.0, None, AT) == LEVEL_RAD


def test_no_limit_is_beyond_the_clamp_unless_the_fault_itself_drives_the_plate():
    beyond = np.radians(10.5)
    for case in CASES:
        stop = standstill_limit(case, 1.0, AT)
        tilt = tilt_limit(case, 1.0, stop, AT)
        assert case.speed or tilt <= beyond + 1e-12


def test_a_ball_must_still_be_on_the_screen_when_the_plate_stands():
    x, y = ball_limit(row(Stopper.LEVELLING), 1.0, 1.5, AT)
    assert (x, y) == (0.35, 0.1975)
