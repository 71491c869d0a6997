"""`twin.sim.drives`: What lies between commanded and made motor rates, against closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from twin.run.finished import run
from twin.scenario import load
from twin.sim.drives import DriveModel, Hysteresis, Play, Resonance, SimulatedDrives, Vibration

PERIOD, RATIO = 0.002, 5.0


def column(*values):
    return np.array(values, float)[:, None]


def streams(rigs):
    return [np.random.SeedSequence(rig) for rig in range(rigs)]


def driving(model, rigs=1):
    return SimulatedDrives(model, PERIOD, RATIO, streams(rigs))


def turned(drives, rates):
    """Turns of either axis of the plate in each period for plate rates (K,) on both, rad."""
    phi, theta = np.transpose([drives.follow(np.full((1, 2), RATIO * rate))[0] for rate in rates])
    np.testing.assert_array_equal(phi, theta)
    return PERIOD * phi / RATIO


def angles(model, rates):
    """Its angles after each period on such drives, rad, shape (K,)."""
    return np.cumsum(turned(driving(model), rates))


def loop(part, reach):
    """Input and output of a part along a settled triangle between -reach and reach."""
    path = np.concatenate([np.linspace(-reach, reach, 400), np.linspace(reach, -reach, 400)])
    path = np.tile(path, 6)
    output = np.cumsum([part.follow(np.full((1, 2), d))[0, 0] for d in np.diff(path, prepend=0)])
    return path[-799:], output[-799:]


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
    drives = driving(DriveModel(backlash=0.004))
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
    part.set_parameters(column(amplitude, amplitude), column(f, f), column(wander, 0.0))
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


def test_a_lagging_drive_makes_the_mean_rates_of_a_first_order_lag():
    corner = 2 * math.pi * 10.0
    t = PERIOD * np.arange(1, 101)
    # the integral of 1 - exp(-corner t)
    expected = t - (1 - np.exp(-corner * t)) / corner
    assert angles(DriveModel(bandwidth=10.0), [1.0] * 100) == pytest.approx(expected)


def test_a_servo_turns_at_its_slew_until_it_is_where_it_was_told_to_go():
    slew, asked, ticks = 0.3, 0.9, 100
    rates = np.concatenate((np.full(ticks, asked), np.zeros(4 * ticks)))
    t = PERIOD * np.arange(1, len(rates) + 1)
    expected = np.minimum(slew * t, asked * PERIOD * ticks)
    np.testing.assert_allclose(angles(DriveModel(slew=slew), rates), expected, rtol=0, atol=1e-12)
    slower = np.full(50, 0.29)
    found = angles(DriveModel(slew=slew), slower)
    np.testing.assert_allclose(found, 0.29 * t[:50], rtol=0, atol=1e-12)


@pytest.mark.parametrize("slew", [0.0, 0.25])
def test_a_servo_of_limited_acceleration_takes_the_shortest_time_for_a_step(slew):
    """Full acceleration to the middle and as much back; with a slew limit that between them."""
    step, most = 0.1, 1.5
    jump = np.zeros(700)
    jump[0] = step / PERIOD
    found = angles(DriveModel(slew=slew, acceleration=most), jump)
    peak = min(math.sqrt(step * most), slew or math.inf)
    takes = step / peak + peak / most  # 2 sqrt(step / most) where the slew is not reached
    assert takes == pytest.approx(0.5667 if slew else 2 * math.sqrt(step / most), abs=1e-4)
    speeds = np.diff(found, prepend=0.0) / PERIOD
    changes = np.diff(speeds, prepend=0.0, append=0.0) / PERIOD
    assert np.abs(changes).max() <= most * (1 + 1e-9)
    assert speeds.max() == pytest.approx(peak, abs=most * PERIOD)
    assert found[-1] == pytest.approx(step, rel=1e-12)
    arrived = np.count_nonzero(found < step * (1 - 1e-9))
    assert PERIOD * arrived == pytest.approx(takes, abs=2 * PERIOD)
    t = PERIOD * np.arange(1, len(found) + 1)
    rising = most * np.minimum(t, peak / most) ** 2 / 2 + peak * np.maximum(t - peak / most, 0)
    until = t < takes - peak / most
    assert np.abs(found - rising)[until].max() < 1.5 * peak * PERIOD


def test_a_servo_of_limited_acceleration_follows_as_far_behind_as_it_needs_to_brake():
    most, rate = 2.0, 0.4
    t = PERIOD * np.arange(1, 701)
    found = angles(DriveModel(acceleration=most), np.full(700, rate))
    behind = rate * t[-200:] - found[-200:]
    assert behind == pytest.approx(rate**2 / (2 * most), abs=rate * PERIOD)


def test_a_servo_that_is_called_back_overshoots_by_its_way_to_brake():
    """From a rate v it goes on by v^2 / 2 a, and comes back in the shortest time."""
    most, peak = 2.0, 0.4
    rates = np.zeros(1500)
    rates[0] = 1.0 / PERIOD
    gone = round(peak / most / PERIOD)
    angle = peak**2 / most / 2
    rates[gone] = (angle - 1.0) / PERIOD  # the goal is now where it is
    found = angles(DriveModel(acceleration=most), rates)
    assert found.max() - angle == pytest.approx(angle, abs=1.5 * peak * PERIOD)
    assert found[-1] == pytest.approx(angle, abs=1e-12)
    back = 2 * math.sqrt(angle / most)
    arrives = PERIOD * (1 + np.flatnonzero(np.abs(found - angle) > 1e-12)[-1])
    assert arrives == pytest.approx(2 * peak / most + back, abs=4 * PERIOD)
    assert np.abs(np.diff(found, 2)).max() / PERIOD**2 <= most * (1 + 1e-6)


def test_a_servo_whose_acceleration_is_limited_while_it_moves_does_not_jump():
    most, rate = 2.0, 0.4
    drives = driving(DriveModel())
    before = turned(drives, [rate] * 3)
    drives.change(DriveModel(acceleration=most), np.full((1, 2), RATIO * rate))
    after = turned(drives, [0.0] * 400)
    steps = np.diff([*before, *after]) / PERIOD**2
    assert np.abs(steps).max() == pytest.approx(most, rel=1e-6)
    assert np.sum(after) == pytest.approx(0.0, abs=1e-12)


def slow_sine(size, duration=4.0):
    """Times, and rates whose sums are a sine of this amplitude in rad over one cycle."""
    t = PERIOD * np.arange(round(duration / PERIOD) + 1)
    angle = size * np.sin(2 * np.pi * t / duration)
    return t[1:], np.diff(angle) / PERIOD, angle[1:]


def test_a_dead_band_makes_a_slow_sine_the_staircase_of_its_crossings():
    """Up by one dead band whenever the command passes one, held over the top, down by the same."""
    band, size, duration = 0.01, 0.0347, 4.0
    t, rates, _ = (each[:-10] for each in slow_sine(size, duration))
    # 3 bands up, held until the command is one below the third, and so on to -3, and up again
    up = [duration * math.asin(k * band / size) / (2 * math.pi) for k in (1, 2, 3)]
    down = [duration / 2 - time for time in (up[1], up[0])] + [duration / 2]
    down += [duration / 2 + time for time in up]
    last = [duration - time for time in (up[1], up[0])]
    crossings = [*up, *down, *last]
    heights = band * np.array([0, 1, 2, 3, 2, 1, 0, -1, -2, -3, -2, -1])
    expected = heights[np.searchsorted(crossings, t)]
    found = angles(DriveModel(deadband=band), rates)
    # a crossing is seen in the period after it: each step is so much higher, and the next as late
    most = size * 2 * math.pi / duration * PERIOD
    settled = np.abs(t[:, None] - crossings).min(axis=1) > 0.02
    assert settled.mean() > 0.85
    assert np.abs(found - expected)[settled].max() < 3 * most < 0.04 * band
    # it stands to the last bit, and has gone in one period
    assert np.count_nonzero(np.diff(found)) == len(crossings)


def test_a_servo_is_on_its_grid_next_to_its_command():
    step = np.radians(180) / 255 / 4
    _, rates, told = slow_sine(0.08)
    found = angles(DriveModel(resolution=step), rates)
    np.testing.assert_allclose(found / step, np.round(found / step), rtol=0, atol=1e-9)
    assert np.abs(found - told).max() == pytest.approx(step / 2, rel=0.05)
    assert len(set(np.round(found / step))) == 2 * round(0.08 / step) + 1


def test_a_servo_has_its_effects_in_the_order_that_is_told():
    """A jump of the command by 2.6 steps: nothing within the dead band, 3 steps at the slew."""
    step, slew = 0.01, 0.5
    model = DriveModel(slew=slew, deadband=0.025, resolution=step)
    jumps = np.zeros(60)
    jumps[[0, 10]] = np.array([2.4, 0.2]) * step / PERIOD
    t = PERIOD * np.arange(1, 61)
    expected = np.clip(slew * (t - t[9]), 0.0, 3 * step)
    np.testing.assert_allclose(angles(model, jumps), expected, rtol=0, atol=1e-12)
    # the lag is behind them: what it makes of the servo's motion
    corner = 2 * math.pi * 8.0
    rates = np.diff(expected, prepend=0.0) / PERIOD
    lagging = [0.0]
    for rate in rates:
        lagging.append(rate + (lagging[-1] - rate) * math.exp(-corner * PERIOD))
    lost = np.diff(lagging) / -corner  # a lag takes in what it does not yet let out
    exact = np.cumsum(rates * PERIOD + lost)
    found = angles(DriveModel(slew=slew, deadband=0.025, resolution=step, bandwidth=8.0), jumps)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12)


@pytest.mark.parametrize("dead_time", [0.0, 0.0005, 0.006, 0.0317, 0.1])
def test_a_dead_time_shows_what_was_commanded_so_long_ago(dead_time):
    rates = np.random.default_rng(3).normal(0, 0.4, 300)
    t = PERIOD * np.arange(301)
    commanded = np.concatenate(([0.0], PERIOD * np.cumsum(rates)))
    expected = np.interp(t[1:] - dead_time, t, commanded)
    found = angles(DriveModel(dead_time=dead_time), rates)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    # then it goes there as any servo does
    jump = np.zeros(300)
    jump[0] = 0.1 / PERIOD
    begun = np.floor(dead_time / PERIOD) * PERIOD
    slewed = angles(DriveModel(dead_time=dead_time, slew=0.5), jump)
    expected = np.clip(0.5 * (t[1:] - begun), 0.0, 0.1)
    np.testing.assert_allclose(slewed, expected, rtol=0, atol=1e-12)


def test_a_dead_time_that_comes_or_grows_lets_a_servo_stand_and_one_that_ends_lets_it_catch_up():
    drives, rate = driving(DriveModel()), np.full((1, 2), RATIO * 0.3)
    one = 0.3 * PERIOD  # in a period
    np.testing.assert_allclose(turned(drives, [0.3] * 20), one)
    for dead_time, stands in ((0.02, 10), (0.05, 15)):
        drives.change(DriveModel(dead_time=dead_time), rate)
        turns = turned(drives, [0.3] * 40)
        np.testing.assert_allclose(turns[:stands], 0.0, atol=1e-12)
        np.testing.assert_allclose(turns[stands + 1 :], one)
    drives.change(DriveModel(dead_time=0.0, slew=5.0), rate)
    assert turned(drives, [0.3] * 40).sum() == pytest.approx(40 * one + 0.05 * 0.3, abs=1e-9)


@pytest.mark.long
def test_without_encoders_a_law_asks_the_same_of_late_drives_as_of_a_later_screen():
    """And the ball does the same, later by as much."""
    common = (
        *("parameters=hobby", "duration=2", "observer.plate=modelled", "predictor.delay=0.074"),
        *("sensors.touch.frame_rate=0", "sensors.touch.variance=[0,0]"),
    )
    drives = "sensors.touch.dead_time=0.03", "plant.servo.dead_time=0.044"
    late = run(load("cure", (*common, *drives)))
    seen = run(load("cure", (*common, "sensors.touch.dead_time=0.074")))
    asked = seen["requested_phi_acc"]
    assert np.abs(asked).max() > 0.1
    np.testing.assert_allclose(late["requested_phi_acc"], asked, rtol=0, atol=1e-9)
    moved, ticks = seen["true_x"], 22
    assert np.abs(moved[ticks:] - moved[:-ticks]).max() > 3e-4
    np.testing.assert_allclose(late["true_x"][ticks:], moved[:-ticks], rtol=0, atol=1e-12)


def test_dead_times_side_by_side_change_to_the_bit_as_each_alone():
    rates = np.cumsum(np.random.default_rng(6).normal(0, 0.4, (90, 1, 2)), axis=0)
    changes = np.array([[0.0, 0.1, 0.02, 0.0313], [0.05, 0.02, 0.1, 0.06], [0.0, 0.0, 0.08, 0.0]])

    def went(dead_times):
        count = dead_times.shape[1]
        drives = driving(DriveModel(), count)
        turns = []
        for part, each in zip(np.split(rates, 3), dead_times, strict=True):
            drives.change(DriveModel(dead_time=each, slew=3.0), np.tile(part[0], (count, 1)))
            turns += [drives.follow(np.tile(rate, (count, 1))) for rate in part]
        return np.array(turns)

    together = went(changes)
    for rig in range(4):
        assert np.array_equal(went(changes[:, rig : rig + 1])[:, 0], together[:, rig])


def test_servos_side_by_side_turn_to_the_bit_as_each_alone():
    rates = np.cumsum(np.random.default_rng(5).normal(0, 0.4, (300, 2)), axis=0)
    every = {
        "slew": [0.0, 0.3, 0.0, 0.2, 0.0],
        "deadband": [0.0, 0.0, 0.004, 0.003, 0.0],
        "resolution": [0.0, 0.0, 0.0, 0.002, 0.003],
        "acceleration": [0.0, 4.0, 0.0, 0.0, 6.0],
        "dead_time": [0.0, 0.031, 0.0, 0.1, 0.06],
    }
    together = driving(DriveModel(**{name: np.array(each) for name, each in every.items()}), 5)
    found = np.array([together.follow(np.tile(rate, (5, 1))) for rate in rates])
    for rig in range(5):
        alone = driving(DriveModel(**{name: each[rig] for name, each in every.items()}))
        for rate, both in zip(rates, found[:, rig], strict=True):
            assert np.array_equal(alone.follow(rate[None])[0], both)


def test_a_servo_on_its_way_goes_on_through_a_change_and_begins_anew_at_rest():
    """A jump of 3.5 dead bands that takes 50 periods; changed when it has less than one to go."""
    model = DriveModel(slew=0.35, deadband=0.01)
    jump, still = [0.035 / PERIOD, *[0.0] * 44], np.zeros((1, 2))
    drives = driving(model)
    first = turned(drives, jump)
    drives.change(DriveModel(slew=0.7, deadband=0.01), still)
    assert first.sum() + turned(drives, [0.0] * 75).sum() == pytest.approx(0.035, abs=1e-12)
    drives.change(model, still)
    turned(drives, jump)
    drives.adopt(np.arange(1), driving(model))
    assert not np.any(turned(drives, [0.0] * 20))
    assert np.array_equal(turned(drives, jump), first)
