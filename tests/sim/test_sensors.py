"""Tests of `twin.sim.sensors`."""

from dataclasses import replace

import numpy as np
import pytest

from twin.hal.interface import SCREEN_SIZE_M, Touch
from twin.sim.sensors import EncoderModel, Noise, SimulatedEncoders, SimulatedScreen, TouchModel

PERIOD = 0.002


def seeds(rigs):
    return [np.random.SeedSequence(0, spawn_key=(rig,)) for rig in range(rigs)]


def watch(model, path, rigs=1, first=0, ticks=500):
    """What the screen reports of balls that follow path(time) on x, by period and rig."""
    screen = SimulatedScreen(model, PERIOD, seeds(first + rigs)[first:])
    samples = []
    for tick in range(ticks):
        position = np.tile([path(tick * PERIOD), 0.0], (rigs, 1))
        screen.see(position, np.ones(rigs, bool))
        samples.append([each.copy() for each in screen.read()])
    return Touch(*map(np.array, zip(*samples, strict=True)))


@pytest.mark.parametrize("dead_time", [0.0, 0.002, 0.042, 0.0427])
def test_a_uniform_motion_is_seen_exactly_one_dead_time_late(dead_time):
    found = watch(TouchModel(dead_time=dead_time, grid=0), lambda t: 0.1 * t)
    expected = 0.1 * (PERIOD * np.arange(100, 500) - dead_time)
    assert found.position[100:, 0, 0] == pytest.approx(expected, abs=1e-12)


def test_before_the_first_sample_arrives_the_ball_is_where_it_started():
    found = watch(TouchModel(dead_time=0.042, grid=0), lambda t: 0.05 + 0.1 * t)
    assert found.position[10, 0, 0] == 0.05


def test_positions_lie_on_the_grid_within_half_a_step():
    seen = watch(TouchModel(dead_time=0.0), lambda t: 0.1 * np.sin(3 * t)).position[:, 0, 0]
    true = 0.1 * np.sin(3 * PERIOD * np.arange(500))
    step = SCREEN_SIZE_M[0] / 4096
    assert np.abs(seen / step - np.rint(seen / step)).max() < 1e-6
    assert np.abs(seen - true).max() <= step / 2 + 1e-12


def test_frames_come_at_their_rate_and_age_in_between():
    model = TouchModel(dead_time=0.042, frame_rate=58.0, grid=0)
    found = watch(model, lambda t: 0.1 * t)
    seen, age = found.position[50:, 0, 0], found.age[50:, 0]
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
    found = watch(model, lambda t: 0.05 * t, rigs=2)
    for rig in range(2):
        seen, age = found.position[50:, rig], found.age[50:, rig]
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


def camera(**about):
    return TouchModel(dead_time=0.03, frame_rate=50.0, grid=0, **about)


CAMERAS = 10


def frames_of(model, seconds=6):
    """Of each camera its frames: when each had come, s, how old it was then, what it shows."""
    found = watch(model, lambda t: t, CAMERAS, ticks=round(seconds / PERIOD))
    now = np.broadcast_to(PERIOD * np.arange(len(found.age))[:, None], found.age.shape)
    each = np.stack((now, found.age, found.position[..., 0]), axis=-1).swapaxes(0, 1)
    return [seen[1:][np.diff(seen[:, 2]) != 0][5:] for seen in each]


def test_frames_of_a_jittering_clock_scatter_as_said_and_show_what_was_there():
    off, steps = [], []
    for found in frames_of(camera(jitter=0.002)):
        came = found[:, 0] - found[:, 1]
        assert len(found) == pytest.approx(6 * 50, abs=8)
        assert (found[:, 1] >= -1e-12).all()
        assert (found[:, 1] < PERIOD).all()
        assert found[:, 2] == pytest.approx(came - 0.03, abs=1e-9)
        late = np.mod(came - came[0] + 0.01, 0.02)
        off.append(late - late.mean())
        steps.append(np.stack((np.diff(came)[:-1], np.diff(came)[1:])))
    # a normal law's standard deviation, estimated from n: to 4 of its own errors
    off = np.concatenate(off)
    assert off.std() == pytest.approx(0.002, abs=4 * 0.002 / np.sqrt(2 * len(off)))
    assert np.corrcoef(np.concatenate(steps, axis=1))[0, 1] == pytest.approx(-0.5, abs=0.06)


@pytest.mark.parametrize(
    ("before", "after"), [(50.0, 20.0), (20.0, 50.0), (0.0, 25.0), (25.0, 0.0)]
)
def test_a_camera_whose_frame_rate_changes_shows_frames_of_the_new_rate_and_what_was_there(
    before, after
):
    model = TouchModel(dead_time=0.03, frame_rate=before, grid=0, variance=(0.0, 0.0))
    screen, seen = SimulatedScreen(model, PERIOD, seeds(1)), []
    for tick in range(1000):
        if tick == 500:
            screen.change(replace(model, frame_rate=after))
        screen.see(np.array([[tick * PERIOD, 0.0]]), np.ones(1, bool))
        touch = screen.read()
        seen.append((tick * PERIOD, touch.age[0], touch.position[0, 0]))
    now, age, place = np.array(seen).T
    # of a slower camera the newest frame may be older than anything that was kept
    settled = (now > 0.1) & ((now < 1.0) | (now > 1.05))
    assert place[settled] == pytest.approx((now - age - 0.03)[settled], abs=1e-9)
    for rate, part in ((before, slice(100, 500)), (after, slice(550, 1000))):
        came = now[part][1:][np.diff(place[part]) != 0]
        assert np.diff(came).mean() == pytest.approx(1 / rate if rate else PERIOD, rel=0.05)


def test_a_screen_that_slips_in_its_mount_turns_what_it_reports_from_then_on():
    model = TouchModel(dead_time=0.0, grid=0, variance=(0.0, 0.0))
    screen = SimulatedScreen(model, PERIOD, seeds(1))
    ball, touching = np.array([[0.1, 0.05]]), np.ones(1, bool)
    screen.see(ball, touching)
    assert screen.read().position[0] == pytest.approx([0.1, 0.05])
    screen.change(replace(model, rotation=np.radians(2.0)))
    screen.see(ball, touching)
    along = complex(0.1, 0.05) * np.exp(-1j * np.radians(2.0))
    assert screen.read().position[0] == pytest.approx([along.real, along.imag])


def test_the_clock_that_jitters_most_still_shows_frames_in_their_order():
    for found in frames_of(camera(jitter=0.1), seconds=4):
        assert (np.diff(found[:, 2]) > 0).all()
        assert np.diff(found[:, 2]).max() < 2 * 0.02 + PERIOD


def test_of_the_frames_the_share_that_is_said_is_lost_each_by_itself():
    found = frames_of(camera(lost=0.25))
    came = [frames[:, 0] - frames[:, 1] for frames in found]
    steps = np.concatenate([np.rint(np.diff(each) / 0.02).astype(int) for each in came])
    share = 1 - len(steps) / steps.sum()
    assert share == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / 3000))
    # lost each by itself: gaps are geometric
    for length in (1, 2, 3):
        wanted = 0.75 * 0.25 ** (length - 1)
        error = 4 * np.sqrt(wanted * (1 - wanted) / len(steps))
        assert (steps == length).mean() == pytest.approx(wanted, abs=error)


def test_in_a_batch_a_camera_has_the_frames_that_it_has_alone():
    about = {
        "frame_rate": np.array([0.0, 50.0, 50.0, 31.0]),
        "jitter": np.array([0.0, 0.0, 0.004, 0.01]),
        "lost": np.array([0.5, 0.0, 0.3, 0.2]),
    }

    def swings(t):
        return 0.1 * np.sin(3 * t)

    together = watch(TouchModel(**about), swings, rigs=4, ticks=1000)
    for k in range(4):
        model = TouchModel(**{name: each[k] for name, each in about.items()})
        alone = watch(model, swings, first=k, ticks=1000)
        np.testing.assert_array_equal(together.position[:, k], alone.position[:, 0])
        np.testing.assert_array_equal(together.age[:, k], alone.age[:, 0])


def test_a_ball_behind_something_is_not_seen_and_stays_where_it_was_seen_last():
    model = TouchModel(
        dead_time=0.01, grid=0, variance=(0.0, 0.0), hidden=(0.0201, -0.01, 0.0501, 0.01)
    )
    found = watch(model, lambda t: 0.1 * t, rigs=2)
    true = 0.1 * np.maximum(PERIOD * np.arange(500) - 0.01, 0.0)
    behind = (true > 0.0201) & (true < 0.0501)
    assert found.touched.tolist() == np.stack((~behind, ~behind), axis=1).tolist()
    shown = np.where(behind, 0.02, true)
    assert found.position[:, 1, 0] == pytest.approx(shown, abs=1e-12)
    beside = replace(model, hidden=(0.0201, 0.001, 0.0501, 0.01))
    assert watch(beside, lambda t: 0.1 * t).touched.all()


def test_of_two_rigs_the_one_with_nothing_before_it_sees_its_ball_as_alone():
    hidden = np.array([[0.0, -1.0, 1.0, 1.0], [0.0] * 4])
    found = watch(TouchModel(hidden=hidden), lambda t: 0.1 * t, rigs=2)
    alone = watch(TouchModel(), lambda t: 0.1 * t, first=1)
    assert found.position[:, 1].tolist() == alone.position[:, 0].tolist()
    assert found.touched.tolist() == [[tick < 22, True] for tick in range(500)]
