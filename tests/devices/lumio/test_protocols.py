"""Bytes as the manuals and the recordings of real panels lay them out, and random bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio.protocols import (
    DECODERS,
    Detector,
    Doubt,
    EloDecoder,
    Hid0006Decoder,
    Hid0007Decoder,
    MicroTouchDecoder,
)
from twin.emulator.screen_bytes import ENCODERS, Protocol, Spot

PROTOCOLS = list(Protocol)
SHARE = st.floats(0, 1)
# Of real panels: products 202E:0006 and 202E:0007.
FINGER_0006 = "31 01 80 13 68 19" + " 00" * 18 + " 01"
LIFTED_0006 = "30 01 b0 5b 28 5c" + " 00" * 18 + " 01"
FINGERS_0006 = "31 01 c8 1e 08 27 31 02 e0 67 70 10" + " 00" * 12 + " 02"
FINGER_0007 = "31 00 d8 07 a0 0a 01 00"
LIFTED_0007 = "30 00 48 70 58 69 01 00"


def decode(decoder, text):
    return decoder.feed(bytes.fromhex(text))


def counts(contact, top):
    return round(contact.x * top), round(contact.y * top), contact.down, contact.id


def test_a_recorded_report_of_product_0006_gives_its_contact():
    ((contact,),) = decode(Hid0006Decoder(), FINGER_0006)
    assert counts(contact, 32767) == (0x1380, 0x1968, True, 1)


def test_a_recorded_lift_off_of_product_0006_is_no_touch():
    ((contact,),) = decode(Hid0006Decoder(), LIFTED_0006)
    assert counts(contact, 32767) == (0x5BB0, 0x5C28, False, 1)


def test_a_recorded_report_of_two_fingers_gives_both():
    ((first, second),) = decode(Hid0006Decoder(), FINGERS_0006)
    assert counts(first, 32767) == (0x1EC8, 0x2708, True, 1)
    assert counts(second, 32767) == (0x67E0, 0x1070, True, 2)


def test_a_recorded_touch_of_six_fingers_takes_two_reports():
    first = "31 01 98 35 48 46 31 02 d8 2d 20 3e 31 03 b0 1c 78 3f 31 04 68 4b 30 2d 06"
    second = "31 05 b8 58 40 21 31 06 48 65 40 26" + " 00" * 13
    reports = decode(Hid0006Decoder(), first + second)
    assert [contact.id for report in reports for contact in report] == [1, 2, 3, 4, 5, 6]
    assert counts(reports[1][1], 32767) == (0x6548, 0x2640, True, 6)


def test_a_report_with_something_in_an_unused_block_is_none():
    decoder = Hid0006Decoder()
    assert decode(decoder, "31 01 80 13 68 19 00 00 00 10" + " 00" * 14 + " 01") == []
    assert decoder.stats.cut + decoder.stats.skipped == 25


def test_recorded_reports_of_product_0007_give_touch_and_lift_off():
    (touch,), (lift,) = decode(Hid0007Decoder(), FINGER_0007 + LIFTED_0007)
    assert counts(touch, 32767) == (0x07D8, 0x0AA0, True, 1)
    assert counts(lift, 32767) == (0x7048, 0x6958, False, 1)


def test_format_tablet_has_seven_bits_a_byte_and_counts_upwards():
    ((contact,),) = decode(MicroTouchDecoder(), "c0 05 40 7f 7f")
    assert (contact.x, contact.y, contact.down) == ((0x40 * 128 + 5) / 16383, 0.0, True)


def test_format_tablet_says_lift_off_with_bit_six_cleared():
    ((contact,),) = decode(MicroTouchDecoder(), "80 00 00 00 00")
    assert (contact.x, contact.y, contact.down) == (0.0, 1.0, False)


def test_replies_of_a_microtouch_controller_are_no_touches():
    decoder = MicroTouchDecoder()
    assert decode(decoder, "01 30 0d 01 41 31 30 31 30 30 0d c0 00 00 00 00") != []
    assert (decoder.stats.replies, decoder.stats.reports, decoder.stats.skipped) == (2, 1, 0)


def test_smartset_is_little_endian_and_its_checksum_starts_at_aa():
    # 0xAA + 0x55 + 0x54 + 0x01 + 0x34 + 0x02 + 0x08 + 0x01 + 0x7F + 0x00 = 0x212.
    ((contact,),) = decode(EloDecoder(), "55 54 01 34 02 08 01 7f 00 12")
    assert counts(contact, 4095) == (0x234, 0x108, True, 1)


@pytest.mark.parametrize("status", [0x04, 0x06])
def test_smartset_says_lift_off_with_bit_two(status):
    body = [0x55, 0x54, status, 0x34, 0x02, 0x08, 0x01, 0x00, 0x00]
    ((contact,),) = EloDecoder().feed(bytes([*body, (0xAA + sum(body)) % 256]))
    assert not contact.down


def test_a_wrong_checksum_is_counted_and_gives_no_contact():
    decoder = EloDecoder()
    assert decode(decoder, "55 54 02 34 02 08 01 7f 00 00") == []
    assert decoder.stats.checksum == 1


def test_an_identity_packet_of_smartset_is_no_touch():
    body = [0x55, 0x49, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36]
    decoder = EloDecoder()
    assert decoder.feed(bytes([*body, (0xAA + sum(body)) % 256])) == []
    assert (decoder.stats.replies, decoder.stats.skipped) == (1, 0)


@pytest.mark.parametrize(
    ("decoder", "text"),
    [
        (Hid0006Decoder(), "31 01 f8 ff 00 20" + " 00" * 18 + " 01"),
        (Hid0007Decoder(), "31 00 00 10 f8 ff 01 00"),
        (EloDecoder(), "55 54 02 00 10 00 00 00 00 65"),
    ],
)
def test_a_position_beyond_the_range_is_counted_and_refused(decoder, text):
    assert decode(decoder, text) == []
    assert (decoder.stats.outside, decoder.stats.skipped) == (1, 0)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(x=SHARE, y=SHARE, down=st.booleans())
def test_what_the_emulated_screen_encodes_comes_back_within_half_a_native_count(
    protocol, x, y, down
):
    (packet,) = ENCODERS[protocol]([Spot(x, y, 1, down)])
    ((contact,),) = DECODERS[protocol]().feed(packet)
    # Half a count of 4096, and the 7 of 32767 by which the range is larger than the grid.
    assert abs(contact.x - x) <= 0.5 / 4095 + 7 / 32767 + 1e-12
    assert abs(contact.y - y) <= 0.5 / 4095 + 7 / 32767 + 1e-12
    assert contact.down == down


@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(
    places=st.lists(st.tuples(SHARE, SHARE), min_size=1, max_size=8),
    cuts=st.lists(st.integers(1, 30), min_size=1, max_size=40),
)
def test_any_portions_of_a_stream_give_the_same_reports(protocol, places, cuts):
    stream = b"".join(ENCODERS[protocol]([Spot(x, y)])[0] for x, y in places)
    decoder, at, reports = DECODERS[protocol](), 0, []
    for cut in [*cuts, len(stream)]:
        reports += decoder.feed(stream[at : at + cut])
        at += cut
    assert reports == DECODERS[protocol]().feed(stream)
    assert len(reports) == len(places)


@pytest.mark.parametrize("name", sorted(DECODERS))
@given(data=st.lists(st.binary(max_size=120), max_size=8))
def test_no_bytes_raise_or_lie_beyond_the_screen(name, data):
    decoder = DECODERS[name]()
    for portion in data:
        for report in decoder.feed(portion):
            assert all(0 <= c.x <= 1 and 0 <= c.y <= 1 for c in report)
    assert decoder.stats.bytes == sum(map(len, data))


@pytest.mark.parametrize("protocol", [Protocol.MICROTOUCH, Protocol.ELO])
@pytest.mark.parametrize("heard", range(1, 5))
def test_the_end_of_a_packet_that_began_before_listening_is_no_fault(protocol, heard):
    (packet,) = ENCODERS[protocol]([Spot(0.3, 0.6)])
    decoder = DECODERS[protocol]()
    assert len(decoder.feed(packet[-heard:] + 2 * packet)) == 2
    assert (decoder.stats.cut, decoder.stats.skipped) == (heard, 0)
    decoder.feed(packet[-heard:] + packet)
    assert (decoder.stats.cut, decoder.stats.skipped) == (heard, heard)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(garbage=st.binary(max_size=60), x=SHARE, y=SHARE)
def test_a_stream_is_understood_again_after_garbage(protocol, garbage, x, y):
    packet = ENCODERS[protocol]([Spot(x, y)])[0]
    decoder = DECODERS[protocol]()
    decoder.feed(garbage)
    reports = decoder.feed(packet * 8)
    (expected,) = DECODERS[protocol]().feed(packet)
    assert reports[-1] == expected
    assert len(reports) >= 3


@pytest.mark.long
@pytest.mark.parametrize("protocol", PROTOCOLS)
@given(places=st.lists(st.tuples(SHARE, SHARE), min_size=16, max_size=20), lost=st.integers(0, 9))
def test_listening_tells_the_protocol_even_from_the_middle_of_a_packet(protocol, places, lost):
    stream = b"".join(ENCODERS[protocol]([Spot(x, y)])[0] for x, y in places)[lost:]
    detector = Detector()
    found = None
    for at in range(0, len(stream), 7):
        found = found or detector.feed(stream[at : at + 7])
    assert found is not None
    assert found[0].name == protocol


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


@pytest.mark.long
@pytest.mark.parametrize("spoken", PROTOCOLS)
@pytest.mark.parametrize("set_to", PROTOCOLS)
@given(places=st.lists(st.tuples(SHARE, SHARE), min_size=16, max_size=20), lost=st.integers(0, 9))
def test_bytes_of_another_protocol_than_the_one_set_are_recognised(set_to, spoken, places, lost):
    stream = b"".join(ENCODERS[spoken]([Spot(x, y)])[0] for x, y in places)[lost:]
    doubt = Doubt(set_to)
    for at in range(0, len(stream), 7):
        doubt.feed(stream[at : at + 7])
    assert doubt.looks_like == ("" if set_to is spoken else spoken)
