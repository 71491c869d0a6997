"""What lies between commanded and made motor rates, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.sim.drives import DriveModel, SimulatedDrives

PERIOD, RATIO = 0.002, 5.0


def shafts(model, rates):
    """Shaft angles after each period for motor rates (K,) on both axes, rad, shape (K, 2)."""
    drives = SimulatedDrives(model, PERIOD, RATIO, [np.random.SeedSequence(0)])
    return PERIOD * np.cumsum([drives.follow(np.full((1, 2), rate))[0] for rate in rates], axis=0)


def test_without_imperfections_the_shaft_follows_at_once():
    rates = np.random.default_rng(1).uniform(-1, 1, 50)
    expected = PERIOD * np.cumsum(rates)
    assert shafts(DriveModel(), rates) == pytest.approx(np.stack((expected, expected), axis=-1))


def test_a_reversed_motor_turns_by_the_whole_play_before_the_shaft_moves():
    play = math.radians(0.3)
    forth = shafts(DriveModel(backlash=play), [1.0] * 100)
    # it began in the middle of its play, which is told as plate angle
    assert forth[-1] == pytest.approx(100 * PERIOD - RATIO * play / 2)
    back = shafts(DriveModel(backlash=play), [1.0] * 100 + [-1.0] * 100)
    lost = RATIO * play
    still = int(lost / PERIOD)
    assert back[100 : 100 + still] == pytest.approx(np.tile(forth[-1], (still, 1)))
    assert back[-1] == pytest.approx(forth[-1] - (100 * PERIOD - lost))


def test_a_lagging_drive_makes_the_mean_rates_of_a_first_order_lag():
    corner = 2 * math.pi * 10.0
    t = PERIOD * np.arange(1, 101)
    # the integral of 1 - exp(-corner t)
    expected = t - (1 - np.exp(-corner * t)) / corner
    found = shafts(DriveModel(bandwidth=10.0), [1.0] * 100)
    assert found == pytest.approx(np.stack((expected, expected), axis=-1))
