"""`twin.study.compiled`: The page about rigs without an encoder: what is left of hold."""

from __future__ import annotations

import math

import numpy as np
import pytest

from docs import no_encoder as page
from docs.cure_floor import Screen, floor
from twin.scenario.load import load

PLAN = page.planned("no_encoder")


@pytest.mark.parametrize("rig", PLAN["rigs"])
def test_the_dither_s_circle_is_the_linear_plant_s_response_to_it(rig):
    scenario = load("cure", [f"parameters={rig}"])
    model = scenario.plant.model.linear()
    amplitude, rate = PLAN["dither"][rig]
    response = model.C @ np.linalg.solve(2j * math.pi * rate * np.eye(8) - model.A, model.B[:, :1])
    x, phi = response[:2, 0]
    tilt = math.radians(amplitude - scenario.plant.servo.backlash_deg / 2)
    assert page.rest_floor(PLAN, rig)[1] == pytest.approx(abs(x / phi) * tilt, rel=1e-9)


def test_the_floor_is_of_a_linear_plant_so_it_grows_as_what_disturbs_it():
    once = floor(Screen(0.1, 0.2, 60.0, 0.03), 0.002, noise=1e-6)
    thrice = floor(Screen(0.1, 0.6, 60.0, 0.03), 0.002, noise=9e-6)
    assert thrice == pytest.approx(3 * once, rel=1e-4)
