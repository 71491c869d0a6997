import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio.calibration import Calibration, CalibrationError, fit

SHARE = st.floats(0, 1)


@pytest.mark.parametrize(
    ("options", "corner"),
    [
        ({}, (-0.35, 0.1975)),
        ({"mirrored_y": False}, (-0.35, -0.1975)),
        ({"mirrored_x": True}, (0.35, 0.1975)),
        ({"swapped": True, "mirrored_x": True, "mirrored_y": False}, (0.35, -0.1975)),
    ],
)
def test_the_screens_origin_lies_in_the_corner_its_mounting_says(options, corner):
    assert Calibration.nominal(**options).plate(0, 0) == pytest.approx(corner)


@given(x=SHARE, y=SHARE, swapped=st.booleans(), mirrored=st.booleans())
def test_plate_and_screen_are_each_others_inverse(x, y, swapped, mirrored):
    calibration = Calibration.nominal(swapped=swapped, mirrored_x=mirrored)
    assert calibration.screen(*calibration.plate(x, y)) == pytest.approx((x, y), abs=1e-12)


def test_the_distance_left_is_that_of_the_noise():
    # Four corners pushed by 1 mm in turn along x: no affine map can follow any of it.
    seen = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    plate = seen + np.array([[1e-3, 0.0], [-1e-3, 0.0], [1e-3, 0.0], [-1e-3, 0.0]])
    found = fit(seen, plate)
    assert found.rms == pytest.approx(1e-3)
    assert found.distances == pytest.approx([1e-3] * 4)


@pytest.mark.parametrize(
    ("points", "words"),
    [([[0, 0], [1, 1]], "3 or more"), ([[0, 0], [0.5, 0.5], [1, 1]], "on one line")],
)
def test_too_few_points_or_a_line_are_refused_in_words(points, words):
    with pytest.raises(CalibrationError, match=words):
        fit(points, points)


def test_a_calibration_without_an_area_is_refused():
    with pytest.raises(CalibrationError, match="cover an area"):
        Calibration(((1.0, 2.0), (0.5, 1.0)), (0.0, 0.0))
