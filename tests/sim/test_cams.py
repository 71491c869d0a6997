"""`twin.hal.cams`.

Cam tables: against the geometry of discs and wheels, and against the mechanism itself."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import fsolve

from twin.base.errors import ModelError
from twin.base.shipped import model_path
from twin.hal.cams import CamTable
from twin.sim.calibration import sweep_cams
from twin.sim.plant.mechanism import Mechanism

STIFFNESS = 80e3
"""Of a wheel on its cam in N/m, as the model file states."""
LEVER, WHEEL_HEIGHT = 0.16, 0.05
ECCENTRICITY, RADII = 0.032, 0.05 + 0.02
SHAFT_PHI = np.array([-0.128, 0.0, -0.019173])
SHAFT_THETA = np.array([0.0, 0.128, -0.019169])


@pytest.fixture(scope="module")
def table():
    return CamTable.from_file(model_path("cams.json"))


def gaps(plate, motor):
    """Distance between each wheel and its cam's surface for plate and motor angles, by geometry.

    A disc's axis is a line through its centre along the shaft; only distance from it counts.
    """
    (phi, theta), (a, b) = plate, motor
    c, s = math.cos, math.sin
    rotation = np.array(
        [
            [c(phi), 0, s(phi)],
            [s(theta) * s(phi), c(theta), -s(theta) * c(phi)],
            [-c(theta) * s(phi), s(theta), c(theta) * c(phi)],
        ]
    )
    wheel_phi = rotation @ [-LEVER, 0, WHEEL_HEIGHT]
    wheel_theta = rotation @ [0, LEVER, WHEEL_HEIGHT]
    disc_phi = SHAFT_PHI + ECCENTRICITY * np.array([-c(a), 0, s(a)])
    disc_theta = SHAFT_THETA + ECCENTRICITY * np.array([0, c(b), s(b)])
    return (
        math.hypot(*(wheel_phi - disc_phi)[[0, 2]]) - RADII,
        math.hypot(*(wheel_theta - disc_theta)[[1, 2]]) - RADII,
    )


def test_the_plate_stands_where_the_geometry_of_discs_and_wheels_puts_it():
    motor = np.array([[0.6, 0.0], [0.0, -0.6], [0.7, 0.7], [-0.7, 0.7], [0.4, -0.8]])
    plant = Mechanism(rigs=len(motor))
    plant.start(np.tile([0.6, 0.0, 0.0, 0.0], (len(motor), 1)))
    plant.advance(motor, 1000)
    plant.advance(np.zeros_like(motor), 2000)
    told = dict(zip(plant.channels, plant.telemetry().T, strict=True))
    for i, pose in enumerate(plant.motor):
        sink = np.array([told["wheel_phi_N"][i], told["wheel_theta_N"][i]]) / STIFFNESS
        expected = fsolve(lambda p, m=pose, s=sink: gaps(p, m) + s, pose / 5, xtol=1e-9)
        assert np.degrees(plant.state[i, [2, 6]]) == pytest.approx(np.degrees(expected), abs=1e-3)


def test_the_table_closes_the_geometry_too(table):
    # one sink for all poses, that of level: the spring's change is worth 0.03 deg
    sink = np.array([66.15, 66.49]) / STIFFNESS
    line = np.radians(np.linspace(-8, 8, 6))
    for plate in np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2):
        expected = fsolve(lambda m, p=plate: gaps(p, m) + sink, 5 * plate, xtol=1e-9)
        error = (table.motor(plate) - expected) / table.ratio
        assert np.degrees(np.abs(error)).max() < 0.05


def static_error(table, lines):
    """Largest angle in deg by which the plate rests beside poses that motor rates lead it to."""
    line = np.radians(np.linspace(-8, 8, lines))
    target = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    plant = Mechanism(rigs=len(target))
    plant.start(np.tile([0.6, 0.0, 0.0, 0.0], (len(target), 1)))
    steps = round(0.01 / plant.step)
    shares = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, 101))
    for now, after in pairwise([table.motor(share * target) for share in shares]):
        plant.advance((after - now) / 0.01, steps)
    plant.advance(np.zeros_like(target), 100 * steps)
    return np.degrees(np.abs(plant.state[:, [2, 6]] - target)).max()


@pytest.mark.long
def test_integrated_rates_bring_both_axes_within_a_twentieth_of_a_degree(table):
    assert static_error(table, lines=6) < 0.05


@pytest.mark.long
def test_one_table_per_axis_leaves_the_cross_coupling_over(table):
    assert 0.2 < static_error(table.per_axis(), lines=4) < 0.4


@pytest.mark.long
def test_a_fresh_sweep_makes_the_stored_table(table):
    fresh = sweep_cams()
    inside = np.abs(fresh.grid) < math.radians(9)
    error = (fresh.angles - table.angles)[inside][:, inside]
    assert np.degrees(np.abs(error)).max() < 1e-3
    assert fresh.provenance == table.provenance


def test_the_stored_table_was_made_with_the_stored_model(table):
    table.check(model_path())


def test_a_table_of_another_model_is_noticed(table, tmp_path):
    other = tmp_path / "ballplate.xml"
    other.write_text(model_path().read_text().replace("0.032 0 0", "0.033 0 0"))
    with pytest.raises(ModelError, match=r"make it again: twin\.sim\.calibration\.sweep_cams"):
        table.check(other)


def test_comments_and_spacing_do_not_make_another_model(table, tmp_path):
    other = tmp_path / "ballplate.xml"
    text = model_path().read_text(encoding="utf-8").replace("<!--", "<!-- again:")
    other.write_bytes(text.replace("\n", "\r\n  ").encode())
    table.check(other)


angle = st.floats(-math.radians(12), math.radians(12))


@given(angle, angle)
def test_any_plate_angle_gives_the_motor_angle_of_its_clamped_self(table, phi, theta):
    edge = table.grid[-1]
    plate = np.array([phi, theta])
    inside = np.clip(plate, -edge, edge)
    assert np.array_equal(table.motor(plate), table.motor(inside))


@pytest.mark.parametrize("bend", [0.0, 1.5], ids=["even", "uneven"])
def test_a_table_is_scipys_cubic_spline_for_one_rig_and_for_many(table, bend):
    grid = table.grid + bend * table.grid**2
    made = CamTable(grid, table.angles, table.provenance)
    plate = np.random.default_rng(3).uniform(grid[0], grid[-1], (500, 2))
    found = made.motor(plate)
    for motor in (0, 1):
        spline = RectBivariateSpline(grid, grid, table.angles[..., motor])
        assert found[:, motor] == pytest.approx(spline(*plate.T, grid=False), abs=1e-12)
    alone = [made.motor(one[None])[0] for one in plate]
    assert np.array_equal(alone, found)


def test_a_saved_table_is_read_back(table, tmp_path):
    path = tmp_path / "cams.json"
    table.save(path)
    again = CamTable.from_file(path)
    assert np.array_equal(again.angles, table.angles)
    assert again.provenance == table.provenance
    assert path.read_bytes() == model_path("cams.json").read_bytes()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "No such file"),
        ("not json", "not JSON"),
        ("[1, 2]", "not a cam table"),
        ('{"plate_rad": [0, 1], "motor_rad": [], "provenance": {}}', "not a cam table"),
        ('{"plate_rad": 1, "motor_rad": [], "provenance": {}}', "not a cam table"),
        (f'{{"plate_rad": [{"9" * 5000}]}}', "an integer beyond 64 bit"),
        ("[" * 3000 + "]" * 3000, "nested deeper than 32 levels"),
        ("TABLE", "not a cam table"),
    ],
)
def test_a_file_that_is_no_table_is_refused_in_one_line(tmp_path, text, words):
    path = tmp_path / "cams.json"
    if text == "TABLE":
        text = json.dumps(json.loads(model_path("cams.json").read_text()) | {"provenance": [1]})
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=words) as caught:
        CamTable.from_file(path)
    assert "\n" not in str(caught.value)
    assert "ballplate calibrate cams" in str(caught.value)
