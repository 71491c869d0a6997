"""`twin.hal.linkage`.

Cranks and rods: closed forms against the closed loop in space, and what locks."""

import re

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from twin.base.errors import ScenarioError
from twin.hal.linkage import Linkage, TiltTable
from twin.scenario import load

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


def closed(gap, guess):
    """Where the loops close, to the rounding of their lengths."""
    found = root(gap, guess, tol=1e-11).x
    assert gap(found) == pytest.approx([0.0, 0.0], abs=1e-13)
    return found


def test_plate_and_crank_angles_close_both_loops_in_space():
    for plate in TILT:
        expected = closed(lambda motor, p=plate: gaps(p, motor), plate * LINKAGE.ratio)
        assert LINKAGE.motor(plate) == pytest.approx(expected, abs=1e-9)
        back = closed(lambda p, m=expected: gaps(p, m), 0.9 * plate)
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


def refused_in_one_line(transmission, tilt_deg, words):
    told = transmission.problem(np.radians(tilt_deg))
    assert re.search(words, told)
    assert told.startswith("plant.linkage")
    assert "\n" not in told


UPRIGHT_ORIENTATION = {"rod": (0.09, 0.09), "arm": (0.1, 0.1), "distance": (0.06, 0.06)}


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
    refused_in_one_line(Linkage(**UPRIGHT_ORIENTATION | lengths), 15, words)


def alone(angles):
    """Plate angles of the linkage where one crank is at each angle, the other level, (n, 2)."""
    one = np.stack((angles, np.zeros_like(angles)), axis=-1)
    return np.stack((LINKAGE.plate(one)[:, 0], LINKAGE.plate(one[:, ::-1])[:, 1]), axis=-1)


def table_of(rows):
    """What somebody would measure of the linkage, at so many servo angles an axis."""
    servo = [np.linspace(-0.8, 0.8, n) for n in rows]
    phi, theta = (
        tuple(zip(at.tolist(), alone(at)[:, axis].tolist(), strict=True))
        for axis, at in enumerate(servo)
    )
    return TiltTable(phi=phi, theta=theta)


WITHIN = np.random.default_rng(4).uniform(-0.79, 0.79, (500, 2))


def test_a_table_of_a_linkage_is_as_near_to_it_as_its_rows_are_near_to_each_other():
    told = np.stack([alone(WITHIN[:, axis])[:, axis] for axis in (0, 1)], axis=-1)
    off = [np.abs(table_of((n, n + 1)).plate(WITHIN) - told).max() for n in (9, 17, 33)]
    assert np.degrees(off[0]) < 0.03
    # of third order in the distance of the rows
    assert off[0] / off[1] > 5
    assert off[1] / off[2] > 5
    ratios = [np.abs(table_of((n, n)).ratio / LINKAGE.ratio - 1).max() for n in (17, 33)]
    assert max(ratios[0] / 3, ratios[1]) < 6e-4


def uneven(seed, n):
    """Rows far from straight, at uneven distances."""
    rng = np.random.default_rng(seed)
    return tuple(zip(*(np.cumsum(rng.uniform(0.01, 0.2, n)) - 0.5 for _ in "xy"), strict=True))


@pytest.mark.long
def test_a_table_of_any_rising_rows_goes_through_them_and_back_and_rises_between_them():
    table = TiltTable(phi=uneven(1, 12), theta=uneven(2, 7))
    for axis, rows in enumerate((table.phi, table.theta)):
        servo, plate = np.transpose(rows)
        assert table.plate(np.stack((servo, servo), -1))[:, axis] == pytest.approx(plate, abs=1e-15)
        fine = np.linspace(servo[0], servo[-1], 30_001)
        both = np.stack((fine, fine), axis=-1)
        there = table.plate(both)
        assert (np.diff(there[:, axis]) > 0).all()
        assert table.motor(there)[:, axis] == pytest.approx(fine, abs=1e-12)
        rate = table.plate_rate(there, both, np.ones_like(both))[:, axis]
        back = table.motor_rate(there, both, np.ones_like(both))[:, axis]
        assert back == pytest.approx(1 / rate, rel=1e-12)
        # the rates add up to the angles
        went = plate[0] + cumulative_trapezoid(rate, fine, initial=0.0)
        assert went == pytest.approx(there[:, axis], abs=1e-4 * np.ptp(plate))
        # and have no jumps at the rows, as those of straight lines would have
        chords = np.diff(plate) / np.diff(servo)
        assert np.abs(np.diff(rate)).max() < 0.02 * np.abs(np.diff(chords)).max()


def test_a_table_that_is_flat_at_its_end_has_a_rate_there():
    steep = ((-0.5, -0.4), (0.0, 0.0), (0.2, 0.2), (0.4, 0.21))
    table = TiltTable(phi=steep, theta=steep)
    end = np.array([0.21, 0.21])
    assert (table.motor_rate(end, table.motor(end), np.ones(2)) > 20).all()
    assert np.isfinite(table.motor_rate(end, table.motor(end), np.ones(2))).all()


def test_beyond_the_ends_of_a_table_servo_and_plate_stand():
    table = TiltTable(phi=((-1.0, -0.3), (0.5, 0.2)), theta=((-0.9, -0.2), (0.0, 0.1), (0.4, 0.2)))
    far = np.array([[9.0, -9.0]])
    assert np.array_equal(table.plate(far), [[0.2, -0.2]])
    assert np.array_equal(table.motor(far), [[0.5, -0.9]])
    assert not table.plate_rate(table.plate(far), far, np.ones((1, 2))).any()


LINE = ((-0.5, -0.2), (0.5, 0.2))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ({"phi": LINE}, r"theta_deg: must be 2 or more rows .*, got \[\]"),
        ({"phi": LINE, "theta": LINE[:1]}, "theta_deg: must be 2 or more rows"),
        ({"phi": (*LINE, (0.6, 0.2)), "theta": LINE}, r"phi_deg: .*both rising, got \[\[-28.6"),
        ({"phi": LINE, "theta": LINE[::-1]}, "theta_deg: .* both rising"),
        ({"phi": ((-0.5, -0.2), (0.5, 0.1)), "theta": LINE}, "= 11 deg .* got -11.4592 to 5.72958"),
    ],
)
def test_a_table_that_cannot_be_is_refused_in_one_line(rows, words):
    refused_in_one_line(TiltTable(**rows), 10, words)
    assert TiltTable(phi=LINE, theta=LINE).problem(np.radians(10)) == ""


@pytest.mark.parametrize(
    "other",
    [
        ["parameters=course", "plant.linkage.crank_mm=[40,28]"],
        ["plant.kind=mujoco", "rig.limits.angle_deg=9"],
    ],
)
def test_a_table_is_for_the_exact_equations_and_has_no_lengths_beside_it(other):
    table = [f"plant.linkage.{axis}_deg=[[-40,-17],[40,17]]" for axis in ("phi", "theta")]
    assert load("circle", ["plant.kind=lagrange", *table]).plant.linkage.phi_deg[0] == (-40, -17)
    with pytest.raises(ScenarioError, match=r"the mechanism has cams or rods|has no lengths"):
        load("circle", [*other, *table])
