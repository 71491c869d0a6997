"""Cranks and rods: closed forms against the closed loop in space, and what locks."""

import re

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from twin.hal.linkage import Linkage

LINKAGE = Linkage(crank=(0.04, 0.03), rod=(0.09, 0.1), arm=(0.1, 0.07), distance=(0.05, 0.045))
TILT = np.random.default_rng(2).uniform(-0.26, 0.26, (40, 2))


def gaps(plate, motor):
    """By how much each rod would have to stretch, from points in space, m."""
    turn = Rotation.from_euler("XY", [plate[1], plate[0]])  # R = Rx(theta) Ry(phi)
    found = []
    for axis, (way, about) in enumerate((((-1, 0, 0), "y"), ((0, 1, 0), "x"))):
        crank, rod, arm, away = (
            getattr(LINKAGE, name)[axis] for name in ("crank", "rod", "arm", "distance")
        )
        depth = np.sqrt(rod**2 - (arm - away - crank) ** 2)
        out = np.array(way, float)
        shaft = away * out - (0, 0, depth)
        end = shaft + Rotation.from_euler(about, motor[axis]).apply(crank * out)
        found.append(np.linalg.norm(turn.apply(arm * out) - end) - rod)
    return found


def test_plate_and_crank_angles_close_both_loops_in_space():
    for plate in TILT:
        expected = fsolve(lambda motor, p=plate: gaps(p, motor), plate * LINKAGE.ratio, xtol=1e-11)
        assert LINKAGE.motor(plate) == pytest.approx(expected, abs=1e-9)
        back = fsolve(lambda p, m=expected: gaps(p, m), 0.9 * plate, xtol=1e-11)
        assert LINKAGE.plate(expected) == pytest.approx(back, abs=1e-9)


def test_rates_are_those_of_the_angles():
    rate, nudge = np.random.default_rng(3).normal(size=TILT.shape), 1e-6
    motor = LINKAGE.motor(TILT)
    slope = (LINKAGE.plate(motor + nudge * rate) - LINKAGE.plate(motor - nudge * rate)) / 2e-6
    assert LINKAGE.plate_rate(TILT, motor, rate) == pytest.approx(slope, abs=1e-8)
    assert LINKAGE.motor_rate(TILT, motor, slope) == pytest.approx(rate, abs=1e-7)


def test_at_level_the_cranks_are_level_and_the_ratio_is_the_slope():
    level, nudge = np.zeros(2), np.array([1e-6, 1e-6])
    assert LINKAGE.motor(level) == pytest.approx(level, abs=1e-12)
    slope = (LINKAGE.motor(nudge) - LINKAGE.motor(-nudge)) / 2e-6
    assert slope == pytest.approx(LINKAGE.ratio, rel=1e-6)


def test_only_phi_depends_on_the_other_axis():
    tilted = np.array([[0.0, 0.2], [0.2, 0.2]])
    alone = LINKAGE.motor(np.array([[0.0, 0.2], [0.2, 0.0]]))
    both = LINKAGE.motor(tilted)
    assert both[:, 1] == pytest.approx(alone[0, 1], abs=1e-12)
    assert both[0, 0] == pytest.approx(alone[0, 0], abs=1e-12)
    assert abs(both[1, 0] - alone[1, 0]) > 0.005


UPRIGHT = {"rod": (0.09, 0.09), "arm": (0.1, 0.1), "distance": (0.06, 0.06)}


def test_an_upright_crank_of_a_long_rod_locks_where_its_length_says():
    # a long rod stays upright: the arm's end rises by the crank's length and no further
    long = Linkage(crank=(0.03, 0.03), rod=(50.0, 50.0), arm=(0.1, 0.1), distance=(0.07, 0.07))
    limit = np.degrees(np.arcsin(0.3))
    assert long.problem(np.radians(limit - 0.1) / 1.1) == ""
    told = long.problem(np.radians(limit + 0.3))
    assert float(told.split("locks at ")[1].split(" deg")[0]) == pytest.approx(limit, abs=0.2)


@pytest.mark.parametrize(
    ("lengths", "words"),
    [
        ({"crank": (0.04, 0.0)}, "above 0 for both axes"),
        ({"crank": (0.04, 0.04), "rod": (0.05, 0.0)}, "above 0 for both axes"),
        ({"crank": (0.04, 0.04), "distance": (0.0, 0.2)}, "-140 mm apart"),
        # the arm's end is 110 mm from the shaft at 8.8 deg: crank and rod in line
        ({"crank": (0.02, 0.04)}, "phi locks at 8.85 deg; .* = 15 needs 1.1 times"),
        ({"crank": (0.04, 0.02)}, "theta locks"),
    ],
)
def test_lengths_that_cannot_be_are_refused_in_one_line(lengths, words):
    told = Linkage(**UPRIGHT | lengths).problem(np.radians(15))
    assert re.search(words, told)
    assert "\n" not in told
