"""`twin.devices.lumio.config`.

A calibration, what it says of the screen, the fit behind it, and its file."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio.config import (
    Calibration,
    CalibrationError,
    Mounting,
    fit,
    read_calibration,
)

SWAPPED = Calibration(((0.0, 0.7), (-0.395, 0.0)), (-0.35, 0.1975))
POINTS = np.array([(x, y) for y in (-0.15, 0, 0.15) for x in (-0.28, 0, 0.28)])


def mounted(size, swapped, mirrored, turn, skew, centre):
    """A calibration put together from what a person would say of the screen."""
    signs = [-1 if each else 1 for each in mirrored]
    x = signs[0] * size[0] * np.array([math.cos(turn - skew / 2), math.sin(turn - skew / 2)])
    y = signs[1] * size[1] * np.array([-math.sin(turn + skew / 2), math.cos(turn + skew / 2)])
    first, second = (y, x) if swapped else (x, y)
    origin = np.array(centre) - first / 2 - second / 2
    matrix = ((first[0], second[0]), (first[1], second[1]))
    return Calibration(matrix, tuple(origin.tolist()))


MOUNTED = st.tuples(
    st.tuples(st.floats(0.1, 2), st.floats(0.1, 2)),
    st.booleans(),
    st.tuples(st.booleans(), st.booleans()),
    st.floats(-0.6, 0.6),
    st.floats(-0.1, 0.1),
    st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1)),
)


@given(way=MOUNTED)
def test_size_sides_turn_and_place_are_read_from_a_calibration_as_it_was_put_together(way):
    size, swapped, mirrored, turn, skew, centre = way
    found = Mounting.of(mounted(*way))
    assert found.size_m == pytest.approx(size)
    assert (found.swapped, found.mirrored_x, found.mirrored_y) == (swapped, *mirrored)
    told = math.degrees(turn), math.degrees(skew)
    assert (found.turn_deg, found.skew_deg) == pytest.approx(told, abs=1e-7)
    assert found.centre_m == pytest.approx(centre, abs=1e-9)


def test_the_words_say_where_each_axis_of_the_screen_runs():
    scale, axes, turn, offset = Mounting.of(SWAPPED).lines
    assert "700.0 x 395.0 mm" in scale
    assert axes == "axes: the screen's x runs along the plate's -y, its y along the plate's +x"
    assert ("+0.00 deg" in turn, "x +0.00, y +0.00 mm" in offset) == (True, True)


def test_the_screens_origin_lies_in_the_corner_its_mounting_says():
    assert Calibration.nominal().plate(0, 0) == pytest.approx((-0.35, 0.1975))


def test_the_distance_left_is_that_of_the_noise():
    # Four corners pushed by 1 mm in turn along x: no affine map can follow any of it.
    seen = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    plate = seen + np.array([[1e-3, 0.0], [-1e-3, 0.0], [1e-3, 0.0], [-1e-3, 0.0]])
    found = fit(seen, plate)
    assert found.rms == pytest.approx(1e-3)
    assert found.distances == pytest.approx([1e-3] * 4)


@pytest.mark.parametrize("points", [[[0, 0], [1, 1]], [[0, 0], [0.5, 0.5], [1, 1]]])
def test_too_few_points_or_a_line_are_refused_in_words(points):
    with pytest.raises(CalibrationError, match="on one line"):
        fit(points, points)


def test_a_calibration_without_an_area_is_refused():
    with pytest.raises(CalibrationError, match="cover an area"):
        Calibration(((1.0, 2.0), (0.5, 1.0)), (0.0, 0.0))


@given(way=MOUNTED)
def test_the_fit_of_exact_points_is_the_calibration(way):
    true = mounted(*way)
    found = fit([true.screen(*point) for point in POINTS], POINTS)
    assert np.allclose(found.calibration.matrix, true.matrix, atol=1e-12)
    assert np.allclose(found.calibration.origin, true.origin, atol=1e-12)
    assert found.rms < 1e-12


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "3",
        "null",
        '{"matrix_m": [[1, 0], [0, 1]]}',
        '{"matrix_m": [[1, 0], [0, 0]], "origin_m": [0, 0], "provenance": {}}',
        '{"matrix_m": [[1, 0], [0, NaN]], "origin_m": [0, 0], "provenance": {}}',
        '{"matrix_m": [[1, 0], [0, true]], "origin_m": [0, 0], "provenance": {}}',
        '{"matrix_m": [[1, 0], [0, "1"]], "origin_m": [0, 0], "provenance": {}}',
        '{"matrix_m": [[1, 0], [0, 1e999]], "origin_m": [0, 0], "provenance": {}}',
        '{"matrix_m": ["ab", "cd"], "origin_m": [0, 0], "provenance": {}}',
        "[" * 3000,
    ],
)
def test_a_damaged_calibration_file_is_one_line_with_the_remedy(tmp_path, text):
    file = tmp_path / "touch.json"
    file.write_text(text)
    with pytest.raises(CalibrationError, match="calibrate touch") as caught:
        read_calibration(file)
    assert "\n" not in str(caught.value)
