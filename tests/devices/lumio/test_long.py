"""Half an hour of a rolling ball and of damaged bytes."""

import random

import pytest

from twin.devices.lumio.config import Calibration, LumioConfig
from twin.devices.lumio.screen import TouchStream
from twin.emulator.screen import ENCODERS, Protocol, Spot

pytestmark = pytest.mark.long
FRAMES = 25_000
FRAME = 0.01736


@pytest.mark.parametrize("protocol", list(Protocol))
def test_a_rolling_ball_is_never_placed_far_from_the_truth_by_damaged_bytes(protocol):
    dice = random.Random(14)
    config = LumioConfig(port="", protocol=protocol.value, baud=12_000_000)
    calibration, limits = Calibration.nominal(), config.gate
    touch_stream = TouchStream(config)
    worst, x, step = 0.0, 0.0, 0.3 * FRAME
    for frame in range(FRAMES):
        x += step
        if abs(x) > 0.3:
            step = -step
        (packet,) = ENCODERS[protocol]([Spot(*calibration.screen(x, 0.05))])
        if dice.random() < 0.05:
            packet = packet[: dice.randrange(1, len(packet))]
        if dice.random() < 0.05:
            packet += dice.randbytes(dice.randrange(1, 12))
        touch_stream.take(frame * FRAME, packet)
        sample = touch_stream.tracker.sample
        if sample is not None and sample.time == frame * FRAME:
            worst = max(worst, abs(sample.position[0] - x), abs(sample.position[1] - 0.05))
    # What passes the limits lies within its reach of the last position, after at most two misses.
    assert worst <= limits.slack + limits.speed * 3 * FRAME + 0.3 * FRAME
