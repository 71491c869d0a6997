"""twin.hal.agreement: motors and plate turn together, or how they do not."""

import numpy as np
import pytest

from twin.hal.agreement import EXCHANGED, OPPOSITE, WRONG_RATIO, Agreement
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


def compared(transmission, period, plate, motor_of=None, lost=LOST):
    """The disagreement of plate encoders with motors that hold other angles; where that was."""
    agreement = Agreement(transmission, lost, period)
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


def test_nothing_is_proven_before_both_axes_have_turned():
    true = circle(0.002)
    _, _, agreement = compared(FixedRatio(), 0.002, true * (1, 0))
    assert not agreement.proven
    _, _, agreement = compared(FixedRatio(), 0.002, 0.2 * true)
    assert not agreement.proven


def test_a_transmission_that_gives_no_number_says_nothing_of_the_plate():
    agreement = Agreement(FixedRatio(np.nan), LOST, 0.002)
    assert agreement.look(np.zeros(2), np.zeros(2)) is None
