"""`twin.cli.calibrate`: The commands that calibrate, as a person types them."""

import json
from functools import partial

import pytest

from twin.cli.rig import request
from twin.devices.lumio.config import UDEV_RULES
from twin.doctor.calibrate import TouchMeasurement, measure_touch
from twin.scenario.rig import read_rig


def test_the_udev_rules_are_printed_and_nothing_else_is_done(ballplate, tmp_path):
    assert ballplate("doctor", "--udev") == (0, UDEV_RULES.read_text(encoding="utf-8"), "")
    assert list(tmp_path.iterdir()) == []


def test_a_person_is_asked_in_words():
    assert request("touch -280 157.5") == "touch the plate at x -280, y +157.5 mm and hold"
    assert request("put") == "put the ball on the plate"
    assert request("lift").startswith("lift the ball")


@pytest.mark.long
@pytest.mark.real_time
def test_the_screen_of_the_virtual_rig_is_found_as_it_is_mounted(ballplate, tmp_path, monkeypatch):
    brief = partial(measure_touch, measurement=TouchMeasurement(reports=5))
    monkeypatch.setattr("twin.doctor.calibrate.measure_touch", brief)
    file = tmp_path / "touch.json"
    corners = [(x, y) for x in (-0.28, 0.28) for y in (-0.15, 0.15)]
    monkeypatch.setattr("twin.doctor.calibrate.usual_points", lambda: corners)
    _, out, _ = ballplate("calibrate", "touch", "--json", "--out", file)
    found = json.loads(out)
    # the virtual screen is square and centred, of 0.7 by 0.395 m and 4096 counts
    assert found["size_m"] == pytest.approx([0.7, 0.395], rel=2 / 4096)
    assert (found["swapped"], found["mirrored_x"], found["mirrored_y"]) == (False, False, True)
    assert found["rms_mm"] < 0.2
    rig = tmp_path / "rig.toml"
    rig.write_text(f'[touch]\nport = "x"\ncalibration_file = "{file}"\n')
    assert read_rig(rig).screen().calibration.plate(0.5, 0.5) == pytest.approx((0, 0), abs=2e-4)
