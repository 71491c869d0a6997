"""`twin.devices.lumio`.

Any bytes between those of a healthy screen: nothing is raised, and no ball that cannot be."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from twin.devices.lumio.conditions import SCREEN_CONDITIONS
from twin.devices.lumio.config import HID_PANELS, Calibration, LumioConfig
from twin.devices.lumio.screen import TouchStream
from twin.emulator.screen import PACKET_ENCODERS, Protocol, Spot, hid_timed
from twin.hal.interface import SCREEN_SIZE_M

CALIBRATION = Calibration.nominal()
FRAME = 0.01736


@settings(max_examples=60)
@given(
    protocol=st.sampled_from(list(Protocol)),
    noise=st.lists(st.tuples(st.integers(0, 40), st.binary(min_size=1, max_size=300)), max_size=8),
    scans=st.booleans(),
)
def test_no_bytes_raise_and_every_position_is_one_that_a_ball_can_reach(protocol, noise, scans):
    transport = "hidraw" if protocol in HID_PANELS else "serial"
    config = LumioConfig(
        port="", transport=transport, protocol=str(protocol), calibration=CALIBRATION
    )
    stream, between, before = TouchStream(config), dict(noise), None
    for frame in range(45):
        time = frame * FRAME
        spot = Spot(*CALIBRATION.screen(0.1 * math.sin(2 * time), 0.0))
        packets = PACKET_ENCODERS[protocol]([spot])
        if protocol is Protocol.HID_TIMED and scans:
            packets = hid_timed([spot], round(time * 1e4))
        stream.take(time, between.get(frame, b""))
        stream.take(time, b"".join(packets))
        stream.tracker.watch(time)
        assert {each.condition for each in stream.faults()} <= set(SCREEN_CONDITIONS)
        sample = stream.tracker.sample
        if sample is None:
            continue
        x, y = sample.position
        assert abs(x) <= SCREEN_SIZE_M[0] / 2 + 1e-6
        assert abs(y) <= SCREEN_SIZE_M[1] / 2 + 1e-6
        gate = config.gate
        if before is not None and sample.time - before.time <= gate.lost:
            way = math.dist(sample.position, before.position)
            near = way <= gate.slack + gate.speed * (sample.time - before.time) + 1e-9
            assert near or sample.since == sample.time  # else several have confirmed it
        before = sample
