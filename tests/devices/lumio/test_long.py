"""Half an hour of damaged bytes: no exception, no position off the screen, most packets kept."""

import random

import pytest

from twin.devices.lumio.calibration import Calibration
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.lumio.protocols import DECODERS, Detector
from twin.devices.lumio.stream import TouchStream
from twin.emulator.screen_bytes import ENCODERS, Protocol, Spot
from twin.sim.plant.exact import SCREEN

pytestmark = pytest.mark.long
PACKETS = 100_000
FRAME = 0.01736


def stream(protocol, seed, share=0.05):
    """Packets of random places, some cut short, some followed by noise, with what they mean."""
    dice = random.Random(seed)
    for _ in range(PACKETS):
        (packet,) = ENCODERS[protocol]([Spot(dice.random(), dice.random())])
        whole = dice.random() >= share
        data = packet if whole else packet[: dice.randrange(1, len(packet))]
        if dice.random() < share:
            data += dice.randbytes(dice.randrange(1, 12))
        yield packet, data, whole


@pytest.mark.parametrize("protocol", list(Protocol))
def test_nearly_all_whole_packets_of_a_damaged_stream_are_recovered(protocol):
    decoder = DECODERS[protocol]()
    reference = DECODERS[protocol]()
    whole = recovered = false = 0
    for packet, data, kept in stream(protocol, 11):
        (meant,) = reference.feed(packet)
        reports = decoder.feed(data)
        assert all(0 <= c.x <= 1 and 0 <= c.y <= 1 for report in reports for c in report)
        hits = reports.count(meant)
        whole += kept
        recovered += min(hits, kept)
        false += len(reports) - min(hits, 1)
    # A packet that noise or a cut one runs into may be lost or come late; about one in ten is hit.
    assert recovered >= 0.85 * whole
    # Elo has a checksum of eight bits; the others can only be plausible.
    assert false <= (0.001 if protocol is Protocol.ELO else 0.12) * PACKETS


@pytest.mark.parametrize("name", ["auto", *sorted(DECODERS)])
def test_random_bytes_of_any_kind_never_raise_nor_leave_the_screen(name):
    dice = random.Random(12)
    touch_stream = TouchStream(name, 1000.0, Calibration.nominal(), PlausibilityLimits())
    marks = b"\x31\x30\x55\x54\x01\x0d\xc0\x80\x00\xff"
    time = 0.0
    for _ in range(PACKETS):
        size = dice.randrange(40)
        data = bytes(dice.choice(marks) for _ in range(size)) if dice.random() < 0.5 else b""
        touch_stream.take(time, data or dice.randbytes(size))
        time += dice.choice((0.0005, 0.004, 0.017, 0.2))
        if touch_stream.sample is not None:
            x, y = touch_stream.sample.position
            assert abs(x) <= SCREEN[0] / 2 + 1e-12
            assert abs(y) <= SCREEN[1] / 2 + 1e-12
        touch_stream.faults()


@pytest.mark.parametrize("protocol", list(Protocol))
def test_the_protocol_is_detected_from_any_offset_and_never_taken_for_another(protocol):
    dice = random.Random(13)
    for _ in range(2000):
        places = [(dice.random(), dice.random()) for _ in range(20)]
        data = b"".join(ENCODERS[protocol]([Spot(*place)])[0] for place in places)
        detector, found, at = Detector(), None, dice.randrange(25)
        while found is None and at < len(data):
            size = dice.randrange(1, 30)
            found = detector.feed(data[at : at + size])
            at += size
        assert found is not None
        assert found[0].name == protocol


@pytest.mark.parametrize("protocol", list(Protocol))
def test_a_rolling_ball_is_never_placed_far_from_the_truth_by_damaged_bytes(protocol):
    dice = random.Random(14)
    calibration, limits = Calibration.nominal(), PlausibilityLimits()
    touch_stream = TouchStream(protocol.value, 1e6, calibration, limits)
    worst, x, step = 0.0, 0.0, 0.3 * FRAME
    for frame in range(PACKETS // 4):
        x += step
        if abs(x) > 0.3:
            step = -step
        (packet,) = ENCODERS[protocol]([Spot(*calibration.screen(x, 0.05))])
        if dice.random() < 0.05:
            packet = packet[: dice.randrange(1, len(packet))]
        if dice.random() < 0.05:
            packet += dice.randbytes(dice.randrange(1, 12))
        touch_stream.take(frame * FRAME, packet)
        sample = touch_stream.sample
        if sample is not None and sample.time == frame * FRAME:
            worst = max(worst, abs(sample.position[0] - x), abs(sample.position[1] - 0.05))
    # What passes the limits lies within its reach of the last position, after at most two misses.
    assert worst <= limits.slack + limits.speed * 3 * FRAME + 0.3 * FRAME
