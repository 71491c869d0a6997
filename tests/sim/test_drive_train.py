"""What lies between commanded and made motor rates, against closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.sim.rig import DriveModel, Hysteresis, Play, Resonance, SimulatedDrives, Vibration


def column(*values):
    return np.array(values, float)[:, None]


def streams(rigs):
    return [np.random.SeedSequence(rig) for rig in range(rigs)]


def loop(part, reach, turns=6, steps=400):
    """Input and output of a part along a settled triangle between -reach and reach."""
    path = np.concatenate([np.linspace(-reach, reach, steps), np.linspace(reach, -reach, steps)])
    path = np.tile(path, turns)
    start = part.follow(np.full((1, 2), path[0]))[0, 0]
    output = start + np.cumsum([part.follow(np.full((1, 2), d))[0, 0] for d in np.diff(path)])
    return path[-2 * steps + 1 :], output[-2 * steps + 1 :]


@pytest.mark.parametrize("kind", [Play, Hysteresis])
def test_a_triangle_shows_a_loop_as_wide_as_the_lost_motion(kind):
    width, reach = 0.004, 0.03
    given, came = loop(kind(column(width)), reach)
    up, down = given[1:] > given[:-1], given[1:] < given[:-1]
    rising = np.interp(0.0, given[1:][up], came[1:][up])
    falling = np.interp(0.0, -given[1:][down], came[1:][down])
    assert falling - rising == pytest.approx(width, rel=0.01)


def test_hysteresis_follows_its_differential_equation_and_play_stands_in_its_gap():
    width, reach = 0.004, 0.03
    given, came = loop(Hysteresis(column(width)), reach)
    lost = given - came
    turn = np.diff(given)
    middle = (lost[1:] + lost[:-1]) / 2
    expected = (1 - middle * np.sign(turn) / (width / 2)) / 2
    moving = np.abs(turn) > 0
    assert np.abs(np.diff(lost)[moving] / turn[moving] - expected[moving]).max() < 2e-3
    given, came = loop(Play(column(width)), reach)
    share = np.diff(came)[given[1:] > given[:-1]] / np.diff(given)[given[1:] > given[:-1]]
    assert ((share < 1e-6) | (share > 1 - 1e-6)).mean() > 0.99


def test_a_soft_train_swings_as_its_equation_says():
    f, zeta, period = 1.4, 0.1, 0.002
    w = 2 * np.pi * f
    part = Resonance(column(f), column(zeta), period)
    ends, whole = [], 0.0
    for _ in range(500):
        whole += part.follow(np.full((1, 2), 0.02 * period))[0, 0]
        ends.append(whole)
    # the motor turns at 0.02 rad/s from t = 0 on; the plate is its spring's
    exact = solve_ivp(
        lambda t, q: (q[1], -2 * zeta * w * (q[1] - 0.02) - w**2 * (q[0] - 0.02 * t)),
        (0, 1), (0.0, 0.0), t_eval=period * np.arange(1, 501), rtol=1e-10, atol=1e-13,
    ).y[0]  # fmt: skip
    assert np.abs(np.array(ends) - exact).max() < 1e-9


def test_a_motor_is_ahead_of_its_shaft_by_what_the_play_holds_back():
    drives = SimulatedDrives(DriveModel(backlash=0.004), 0.002, 5.0, streams(1))
    forth = [drives.follow(np.full((1, 2), 1.0)) for _ in range(100)]
    assert drives.ahead == pytest.approx(np.full((1, 2), 5.0 * 0.004 / 2))
    back = [drives.follow(np.full((1, 2), -1.0)) for _ in range(100)]
    assert drives.ahead == pytest.approx(np.full((1, 2), -5.0 * 0.004 / 2))
    shafts = 0.002 * np.sum(forth + back, axis=0)
    assert shafts + drives.ahead == pytest.approx(np.zeros((1, 2)), abs=1e-12)


@pytest.mark.long
def test_a_random_vibration_has_the_size_of_the_steady_one_about_its_frequency():
    amplitude, f, wander, count = 0.7, 1.4, 0.5, 60_000
    part = Vibration(0.01, streams(2))
    part.be(column(amplitude, amplitude), column(f, f), column(wander, 0.0))
    rates = np.array([part.rate() for _ in range(count)])
    steady = amplitude * np.sin(2 * np.pi * f * 0.01 * np.arange(1, count + 1))
    assert rates[:, 1, 0] == pytest.approx(steady)
    # 600 s hold some 600 independent stretches: the variance is known to 6 %
    assert rates[:, 0].var(axis=0) == pytest.approx(np.full(2, amplitude**2 / 2), rel=0.2)
    spectrum = np.abs(np.fft.rfft(rates[:, 0, 0])) ** 2
    frequencies = np.fft.rfftfreq(count, 0.01)
    near = np.abs(frequencies - f) < 1 / wander
    assert spectrum[near].sum() > 0.8 * spectrum.sum()
    # its lines are Lorentzian of half-width 1 / (2 pi wander): 80 % lie within 3.1 of them
    close = np.abs(frequencies - f) < 1 / (2 * np.pi * wander)
    assert spectrum[close].sum() == pytest.approx(0.5 * spectrum.sum(), rel=0.2)


PERIOD, RATIO = 0.002, 5.0


def shafts(model, rates):
    """Shaft angles after each period for motor rates (K,) on both axes, rad, shape (K, 2)."""
    drives = SimulatedDrives(model, PERIOD, RATIO, streams(1))
    return PERIOD * np.cumsum([drives.follow(np.full((1, 2), rate))[0] for rate in rates], axis=0)


def test_without_imperfections_the_shaft_follows_at_once():
    rates = np.random.default_rng(1).uniform(-1, 1, 50)
    expected = PERIOD * np.cumsum(rates)
    assert shafts(DriveModel(), rates) == pytest.approx(np.stack((expected, expected), axis=-1))


def test_a_lagging_drive_makes_the_mean_rates_of_a_first_order_lag():
    corner = 2 * math.pi * 10.0
    t = PERIOD * np.arange(1, 101)
    # the integral of 1 - exp(-corner t)
    expected = t - (1 - np.exp(-corner * t)) / corner
    found = shafts(DriveModel(bandwidth=10.0), [1.0] * 100)
    assert found == pytest.approx(np.stack((expected, expected), axis=-1))
