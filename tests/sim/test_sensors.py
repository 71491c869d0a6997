import numpy as np
import pytest

from twin.hal.interface import SCREEN
from twin.sim.sensors import EncoderModel, Noise, SimulatedEncoders, SimulatedScreen, TouchModel

PERIOD = 0.002


def seeds(rigs, root=0):
    return [np.random.SeedSequence(root, spawn_key=(rig,)) for rig in range(rigs)]


def watch(model, path, rigs=1):
    """What the screen reports each period of balls that follow path(time) on x."""
    screen = SimulatedScreen(model, PERIOD, seeds(rigs))
    samples = []
    for tick in range(500):
        position = np.tile([path(tick * PERIOD), 0.0], (rigs, 1))
        screen.see(position, np.ones(rigs, bool))
        samples.append(screen.read())
    return samples


@pytest.mark.parametrize("dead_time", [0.0, 0.002, 0.042, 0.0427])
def test_a_uniform_motion_is_seen_exactly_one_dead_time_late(dead_time):
    model = TouchModel(dead_time=dead_time, grid=0)
    samples = watch(model, lambda t: 0.1 * t)
    for tick in range(100, 500):
        expected = 0.1 * (tick * PERIOD - dead_time)
        assert samples[tick].position[0, 0] == pytest.approx(expected, abs=1e-12)


def test_before_the_first_sample_arrives_the_ball_is_where_it_started():
    samples = watch(TouchModel(dead_time=0.042, grid=0), lambda t: 0.05 + 0.1 * t)
    assert samples[10].position[0, 0] == 0.05


def test_positions_lie_on_the_grid_within_half_a_step():
    samples = watch(TouchModel(dead_time=0.0), lambda t: 0.1 * np.sin(3 * t))
    seen = np.array([sample.position[0, 0] for sample in samples])
    true = 0.1 * np.sin(3 * PERIOD * np.arange(500))
    step = SCREEN[0] / 4096
    assert np.abs(seen / step - np.rint(seen / step)).max() < 1e-6
    assert np.abs(seen - true).max() <= step / 2 + 1e-12


def test_frames_come_at_their_rate_and_age_in_between():
    model = TouchModel(dead_time=0.042, frame_rate=58.0, grid=0)
    samples = watch(model, lambda t: 0.1 * t)
    seen = np.array([sample.position[0, 0] for sample in samples[50:]])
    age = np.array([sample.age[0] for sample in samples[50:]])
    frames = np.count_nonzero(np.diff(seen) > 1e-9) / (450 * PERIOD)
    assert frames == pytest.approx(58, abs=1.5)
    assert age.min() >= 0
    assert age.max() <= 1 / 58
    # What was seen is what was true a dead time and the age ago.
    expected = 0.1 * (PERIOD * np.arange(50, 500) - 0.042 - age)
    assert seen == pytest.approx(expected, abs=1e-9)


def test_a_lifted_ball_is_reported_one_dead_time_later():
    screen = SimulatedScreen(TouchModel(dead_time=0.042), PERIOD, seeds(1))
    felt = []
    for tick in range(60):
        screen.see(np.zeros((1, 2)), np.array([tick < 10]))
        felt.append(bool(screen.read().touched[0]))
    assert felt.index(False) == 10 + 21


def test_noise_has_the_variance_asked_for():
    noise = Noise((4e-6, 1e-6), seeds(4))
    drawn = np.array([noise.draw() for _ in range(5000)])
    assert drawn.var(axis=(0, 1)) == pytest.approx([4e-6, 1e-6], rel=0.05)


def test_held_noise_changes_only_every_so_many_periods():
    noise = Noise((1.0,), seeds(1), hold=5)
    drawn = np.array([noise.draw()[0, 0] for _ in range(3000)])
    blocks = drawn.reshape(-1, 5)
    assert (blocks == blocks[:, :1]).all()
    assert len(set(blocks[:, 0])) == 600


def test_an_encoder_counts_in_whole_counts():
    encoders = SimulatedEncoders(EncoderModel(), seeds(1))
    count = 2 * np.pi / 245760
    plate = np.array([[10.4 * count, -3.6 * count]])
    assert encoders.read(plate) == pytest.approx(np.array([[10 * count, -4 * count]]), abs=1e-15)


def test_noise_and_grid_belong_to_the_frame():
    model = TouchModel(dead_time=0.042, frame_rate=58.0, variance=(1e-6, 1e-6))
    samples = watch(model, lambda t: 0.05 * t, rigs=2)[50:]
    for rig in range(2):
        seen = np.array([sample.position[rig] for sample in samples])
        age = np.array([sample.age[rig] for sample in samples])
        new = np.diff(age) < 0
        changed = (np.diff(seen, axis=0) != 0).any(axis=1)
        assert not changed[~new].any()
        # of a frame's noise, a millimetre, hardly anything falls on the same point of the grid
        assert changed[new].mean() > 0.95


def test_noise_held_for_differing_times_is_what_each_rig_draws_alone():
    together = Noise((1.0,), seeds(3), hold=np.array([1, 3, 7]))
    alone = [
        Noise((1.0,), seeds(3)[rig : rig + 1], hold=hold) for rig, hold in enumerate((1, 3, 7))
    ]
    for _ in range(2000):
        assert together.draw()[:, 0].tolist() == [noise.draw()[0, 0] for noise in alone]


def test_a_screen_mounted_turned_reports_the_ball_in_its_own_axes():
    angle = 0.3
    screen = SimulatedScreen(TouchModel(dead_time=0.0, grid=0, rotation=angle), PERIOD, seeds(1))
    screen.see(np.array([[0.1, 0.05]]), np.ones(1, bool))
    # its axes are those of the plate turned by the angle: a vector's parts along them
    along = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert screen.read().position[0] == pytest.approx(along @ [0.1, 0.05])
