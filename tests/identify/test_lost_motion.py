"""`twin.identify.plate_motion`.

Lost motion is found with the number put in, by its shape, and none where there is none."""

import numpy as np
import pytest

from twin.base.errors import LogError
from twin.identify.plate_motion import NO_LOOP, PLAY_KEYS, lost_motion, triangle
from twin.sim.drives import Hysteresis, Play

CYCLES = 3
MOTOR = triangle(np.radians(1.0), np.radians(1.0), CYCLES, 0.002)
COUNT = 2 * np.pi / 245760


def through(part, motor):
    return np.cumsum(
        [part.follow(np.full((1, 2), turn))[0, 0] for turn in np.diff(motor, prepend=0)]
    )


def counted(angle):
    return np.rint(angle / COUNT) * COUNT


@pytest.mark.long
@pytest.mark.parametrize("width", [0.05, 0.44])
@pytest.mark.parametrize(("part", "shape"), [(Play, "flat"), (Hysteresis, "round")])
def test_the_width_put_in_is_found_and_the_shape_is_named(part, shape, width):
    plate = 0.98 * through(part(np.radians([[width]])), MOTOR) + np.radians(0.3)
    found = lost_motion("phi", MOTOR, counted(plate), CYCLES)
    assert found.width == pytest.approx(width, abs=0.001)
    assert found.shape == shape
    assert found.gain == pytest.approx(0.98, abs=0.002)
    assert found.spread < 0.001
    assert found.as_dict()["key"] == PLAY_KEYS[shape]
    assert f"{found.width / 2:.3f} to each side" in found.words


def test_a_plate_that_follows_has_no_lost_motion_and_noise_hides_the_corners():
    none = lost_motion("theta", MOTOR, counted(MOTOR), CYCLES)
    assert none.shape == "none"
    assert none.width < NO_LOOP
    assert none.as_dict()["key"] is None
    noise = np.radians(0.1) * np.random.default_rng(0).normal(size=len(MOTOR))
    noisy = lost_motion("theta", MOTOR, through(Play(np.radians([[0.2]])), MOTOR) + noise, CYCLES)
    assert noisy.shape == "either"
    assert noisy.width == pytest.approx(0.2, abs=0.05)


def test_an_axis_that_stands_is_refused():
    with pytest.raises(LogError, match=r"theta: motor moved 2\.0000 deg, plate 0\.0000 deg"):
        lost_motion("theta", MOTOR, np.zeros(len(MOTOR)), CYCLES)
