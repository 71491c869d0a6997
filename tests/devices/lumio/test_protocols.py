"""`twin.devices.lumio.protocols`.

Bytes of a serial line as the manuals lay them out, and random bytes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.devices.lumio.config import LumioConfig
from twin.devices.lumio.protocols import STREAM_DECODERS, Detector, EloDecoder, MicroTouchDecoder
from twin.devices.lumio.screen import TouchStream
from twin.emulator.screen import PACKET_ENCODERS, Protocol, Spot

PROTOCOLS = [Protocol.MICROTOUCH, Protocol.ELO]
SHARE = st.floats(0, 1)


def decode(decoder, text):
    return decoder.feed(bytes.fromhex(text))


def test_format_tablet_has_seven_bits_a_byte_and_counts_upwards():
    ((contact,),) = decode(MicroTouchDecoder(), "c0 05 40 7f 7f")
    assert (contact.x, contact.y, contact.down) == ((0x40 * 128 + 5) / 16383, 0.0, True)


def test_format_tablet_says_lift_off_with_bit_six_cleared():
    ((contact,),) = decode(MicroTouchDecoder(), "80 00 00 00 00")
    assert (contact.x, contact.y, contact.down) == (0.0, 1.0, False)


def test_replies_of_a_microtouch_controller_are_no_touches():
    decoder = MicroTouchDecoder()
    assert decode(decoder, "01 30 0d 01 41 31 30 31 30 30 0d c0 00 00 00 00") != []
    assert decoder.stats.reports == 1


def test_smartset_is_little_endian_and_its_checksum_starts_at_aa():
    # 0xAA + 0x55 + 0x54 + 0x01 + 0x34 + 0x02 + 0x08 + 0x01 + 0x7F + 0x00 = 0x212.
    ((contact,),) = decode(EloDecoder(), "55 54 01 34 02 08 01 7f 00 12")
    assert contact == pytest.approx((0x234 / 4095, 0x108 / 4095, True, 1))


@pytest.mark.parametrize("status", [0x04, 0x06])
def test_smartset_says_lift_off_with_bit_two(status):
    body = [0x55, 0x54, status, 0x34, 0x02, 0x08, 0x01, 0x00, 0x00]
    ((contact,),) = EloDecoder().feed(bytes([*body, (0xAA + sum(body)) % 256]))
    assert not contact.down


def test_an_identity_packet_of_smartset_is_no_touch():
    body = [0x55, 0x49, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36]
    decoder = EloDecoder()
    assert decoder.feed(bytes([*body, (0xAA + sum(body)) % 256])) == []
    assert decoder.stats.skipped == 0


@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(x=SHARE, y=SHARE, down=st.booleans())
def test_what_the_emulated_screen_encodes_comes_back_within_half_a_native_count(
    protocol, x, y, down
):
    (packet,) = PACKET_ENCODERS[protocol]([Spot(x, y, 1, down)])
    ((contact,),) = STREAM_DECODERS[protocol]().feed(packet)
    assert (contact.x, contact.y) == pytest.approx((x, y), abs=0.5 / 4095 + 0.5 / 16383)
    assert contact.down == down


@pytest.mark.short("elo")
@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(
    places=st.lists(st.tuples(SHARE, SHARE), min_size=1, max_size=8),
    cuts=st.lists(st.integers(1, 30), min_size=1, max_size=40),
)
def test_any_portions_of_a_stream_give_the_same_reports(protocol, places, cuts):
    stream = b"".join(PACKET_ENCODERS[protocol]([Spot(x, y)])[0] for x, y in places)
    decoder, at, reports = STREAM_DECODERS[protocol](), 0, []
    for cut in [*cuts, len(stream)]:
        reports += decoder.feed(stream[at : at + cut])
        at += cut
    assert reports == STREAM_DECODERS[protocol]().feed(stream)
    assert len(reports) == len(places)


@pytest.mark.parametrize("protocol", [Protocol.MICROTOUCH, Protocol.ELO])
@pytest.mark.parametrize("heard", range(1, 5))
def test_the_end_of_a_packet_that_began_before_listening_is_no_fault(protocol, heard):
    (packet,) = PACKET_ENCODERS[protocol]([Spot(0.3, 0.6)])
    decoder = STREAM_DECODERS[protocol]()
    assert len(decoder.feed(packet[-heard:] + 2 * packet)) == 2
    assert decoder.stats.skipped == 0
    decoder.feed(packet[-heard:] + packet)
    assert decoder.stats.skipped == heard


@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(garbage=st.binary(max_size=60), x=SHARE, y=SHARE)
def test_a_stream_is_understood_again_after_garbage(protocol, garbage, x, y):
    packet = PACKET_ENCODERS[protocol]([Spot(x, y)])[0]
    decoder = STREAM_DECODERS[protocol]()
    decoder.feed(garbage)
    reports = decoder.feed(packet * 8)
    (expected,) = STREAM_DECODERS[protocol]().feed(packet)
    assert reports[-1] == expected
    assert len(reports) >= 3


def test_a_stream_is_listened_to_for_a_while_before_its_protocol_is_taken():
    packet = bytes.fromhex("c0 05 40 7f 7f")
    detector = Detector()
    assert [detector.feed(packet) for _ in range(11)] == [None] * 11
    assert detector.feed(packet) is not None


@given(data=st.binary(max_size=3000))
def test_a_detector_takes_no_protocol_that_leaves_most_bytes_unexplained(data):
    found = Detector().feed(data)
    if found is not None:
        decoder, _ = found
        assert decoder.size * decoder.stats.reports >= 0.8 * len(data)


@pytest.mark.short("auto-*", "elo-elo", "microtouch-microtouch")
@pytest.mark.parametrize("spoken", PROTOCOLS)
@pytest.mark.parametrize("set_to", ["auto", "hid-0006", *PROTOCOLS])
@settings(max_examples=25)
@given(places=st.lists(st.tuples(SHARE, SHARE), min_size=16, max_size=20), lost=st.integers(0, 9))
def test_listening_tells_the_protocol_even_from_the_middle_of_a_packet(
    set_to, spoken, places, lost
):
    data = b"".join(PACKET_ENCODERS[spoken]([Spot(x, y)])[0] for x, y in places)[lost:]
    stream = TouchStream(LumioConfig(port="", protocol=str(set_to), baud=10**10))
    for at in range(0, len(data), 7):
        stream.take(0.001 * at, data[at : at + 7])
    assert stream.looks_like == ("" if set_to in {"auto", spoken} else spoken)
    assert stream.decoder.name == (spoken if set_to == "auto" else str(set_to).partition("-")[0])
