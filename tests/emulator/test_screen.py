"""Tests of `twin.emulator.screen`."""

import numpy as np
import pytest
from served_screen import EmulatedScreen

from twin.base.jobs import wait_until
from twin.emulator.screen import PACKET_ENCODERS, Damage, Protocol, ScreenFault, ScreenLine, Spot

pytestmark = pytest.mark.real_time


BALL = Spot(0.25, 0.5)
SOON = {"frame": 0.004, "dead_time": 0.01}
"""A screen that looks four times as often as a real one and tells at once."""


def collect_bytes(line, begin, end):
    """Portions of bytes and their times, looked for every millisecond of made-up time."""
    times = [begin + 0.001 * k for k in range(round(1000 * (end - begin)))]
    return [(now, part) for now in times for part in line.step(now)]


@pytest.mark.parametrize("balls", [[], [(0.36, 0.0)]], ids=["none", "beside"])
def test_what_does_not_touch_the_screen_is_not_felt(balls):
    assert collect_bytes(ScreenLine(lambda: balls, **SOON), 0.0, 0.1) == []


def test_a_ball_that_leaves_gives_exactly_one_lift_off_at_its_last_place():
    balls = [(0.0, 0.0)]
    line = ScreenLine(lambda: balls, protocol=Protocol.HID_0007, **SOON)
    collect_bytes(line, 0.0, 0.08)
    balls.clear()
    reports = [part for _, part in collect_bytes(line, 0.08, 0.16)]
    assert [report[0] for report in reports].count(0x30) == 1
    assert reports[-1][0] == 0x30
    assert len({report[1:] for report in reports}) == 1


def test_bytes_never_come_faster_than_the_line_carries_them():
    line = ScreenLine(lambda: [(0.0, 0.0)], protocol=Protocol.ELO, baud=4800)
    line.damage.inject(ScreenFault.FLOOD, 2.0)
    parts = collect_bytes(line, 0.0, 1.0)
    total = sum(len(part) for _, part in parts[1:])
    assert total > 300
    assert parts[-1][0] - parts[0][0] >= total * 10 / 4800 - 0.001


def test_nothing_arrives_before_the_dead_time_is_over():
    parts = collect_bytes(ScreenLine(lambda: [(0.0, 0.0)], dead_time=0.1), 0.0, 0.2)
    ends = [now for n, (now, _) in enumerate(parts) if sum(len(p) for _, p in parts[: n + 1]) >= 5]
    assert ends[0] == pytest.approx(0.1, abs=0.0015)


@pytest.mark.long
def test_frames_jitter_about_their_clock_get_lost_and_take_longer_or_shorter():
    looked = []
    line = ScreenLine(
        lambda: looked.append(now) or [(0.0, 0.0)],
        protocol=Protocol.HID_0007,
        frame=0.02,
        dead_time=0.005,
        spread=0.001,
        jitter=0.003,
        lost=0.2,
    )
    arrived = []
    for now in np.arange(0.0, 100.0, 1e-4).tolist():
        arrived += [now] * bool(line.step(now))
    assert len(looked) == pytest.approx(0.8 * 5000, abs=4 * np.sqrt(5000 * 0.8 * 0.2))
    about = np.remainder(np.array(looked[1:]) + 0.01, 0.02) - 0.01
    off = 4 / np.sqrt(2 * len(about))  # four standard deviations of an estimated one
    assert np.mean(about) == pytest.approx(0.0, abs=4 * 0.003 / np.sqrt(len(about)) + 1e-4)
    assert np.std(about) == pytest.approx(0.003, rel=off)
    took = np.array(arrived) - looked[: len(arrived)]
    assert np.mean(took) == pytest.approx(0.005, abs=4 * 0.001 / np.sqrt(len(took)) + 1e-4)
    assert np.std(took) == pytest.approx(0.001, rel=off)


def test_a_port_has_the_same_path_after_plugging_in_again_and_none_in_between():
    with EmulatedScreen(ScreenLine(list)) as screen:
        screen.unplug()
        assert not screen.path.exists()
        screen.plug()
        assert screen.path.exists()
    assert not screen.path.parent.exists()


def test_bytes_sent_while_unplugged_are_lost(monkeypatch):
    written = []
    write = EmulatedScreen.write
    monkeypatch.setattr(
        EmulatedScreen, "write", lambda port, data: written.append((write(port, data), len(data)))
    )
    with EmulatedScreen(ScreenLine(lambda: [(0.0, 0.0)], **SOON)) as screen:
        screen.unplug()
        before = len(written)
        assert wait_until(lambda: len(written) >= before + 5, 60.0)
        tried = written[before:]
    assert all(size > 0 for _, size in tried)
    assert not any(sent for sent, _ in tried)


@pytest.mark.parametrize(
    "fault", [ScreenFault.TRUNCATE, ScreenFault.GARBLE, ScreenFault.NOISE, ScreenFault.SPLIT]
)
def test_damage_is_the_same_for_the_same_seed(fault):
    (packet,) = PACKET_ENCODERS[Protocol.ELO]([BALL])

    def damaged(seed):
        damage = Damage(Protocol.ELO, seed)
        damage.inject(fault, 1.0)
        return [damage.packet(0.0, packet) for _ in range(20)]

    assert damaged(1) == damaged(1) != damaged(2)
    assert all(parts != [packet] for parts in damaged(1))


def test_damage_is_over_when_its_time_is():
    damage = Damage(Protocol.ELO, 0)
    for fault in ScreenFault:
        damage.inject(fault, 1.0)
    (packet,) = PACKET_ENCODERS[Protocol.ELO]([BALL])
    assert damage.packet(1.0, packet) == [packet]
    assert damage.contacts(1.0, [BALL]) == (BALL,)


@pytest.mark.parametrize(
    ("fault", "seen"),
    [
        (ScreenFault.SWAP_AXES, [(Spot(0.5, 0.25),)] * 3),
        (ScreenFault.PEN_UP, [()] * 3),
        (ScreenFault.DROPOUT, [()] * 3),
        (ScreenFault.FREEZE, [(Spot(0.1, 0.1),)] * 3),
        (ScreenFault.TWO_CONTACTS, [(BALL, Damage.FINGER)] * 3),
        (ScreenFault.JUMP, [(Spot(0.7, 0.95),), (BALL,), (BALL,)]),
    ],
)
def test_faults_of_contacts_do_what_they_say(fault, seen):
    damage = Damage(Protocol.HID_0006, 0)
    damage.contacts(0.0, [Spot(0.1, 0.1)])
    damage.inject(fault, 1.0)
    assert [damage.contacts(time, [BALL]) for time in (0.1, 0.2, 0.3)] == seen


def test_merged_packets_are_two_in_one():
    damage = Damage(Protocol.ELO, 0)
    damage.inject(ScreenFault.MERGE, 1.0)
    assert [damage.packet(0.0, b"one"), damage.packet(0.0, b"two")] == [[], [b"onetwo"]]
