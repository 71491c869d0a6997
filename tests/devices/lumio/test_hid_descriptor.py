"""`twin.devices.lumio.protocols`.

Report descriptors: of real panels, made up from fields, damaged, and of random bytes."""

import pytest
from at_once import is_at_once
from hypothesis import given
from hypothesis import strategies as st

from twin.devices.lumio.protocols import (
    MAX_REPORT_BITS,
    TOUCH_SCREEN,
    DescriptorError,
    HidDecoder,
    TouchLayout,
    parse,
)


def item(head, value, size):
    """A short item of a type and tag, with a value of 1, 2 or 4 bytes."""
    code = {0: 0, 1: 1, 2: 2, 4: 3}[size]
    return bytes([head | code]) + (value & (1 << 8 * size) - 1).to_bytes(size, "little")


@pytest.mark.parametrize(
    ("name", "size"), [("hid-0006", (0.376, 0.301)), ("hid-0007", (0.377, 0.305))]
)
def test_a_panel_says_its_size(descriptors, name, size):
    assert TouchLayout.of(descriptors[name]).extent == pytest.approx(size)


def test_an_inch_is_2_54_cm(descriptors):
    inches = descriptors["hid-0007"].replace(b"\x65\x11", b"\x65\x13")
    assert TouchLayout.of(inches).extent == pytest.approx((0.377 * 2.54, 0.305 * 2.54))


def test_a_mouse_and_a_touch_pad_are_no_touch_screens(descriptors):
    assert TouchLayout.of(descriptors["mouse"]) is None
    pad = descriptors["hid-0007"].replace(b"\x05\x0d\x09\x04", b"\x05\x0d\x09\x05", 1)
    assert TouchLayout.of(pad) is None


def test_a_largest_value_is_below_zero_only_where_the_smallest_is():
    screen = b"\x05\x0d\x09\x04\xa1\x01\x75\x08\x95\x01\x09\x01"
    for low, high, meant in (
        (0x81, 0x7F, (-127, 127)),
        (0, 0xFF, (0, 255)),
        (0x81, 0xFF, (-127, -1)),
    ):
        _, (field,) = parse(screen + bytes([0x15, low, 0x25, high, 0x81, 2, 0xC0]))[0]
        assert (field.low, field.high) == meant


SIGNED = st.integers(-(1 << 31), (1 << 31) - 1)
FIELDS = st.lists(
    st.tuples(
        st.integers(1, 32),  # bits
        st.integers(0, 1 << 16),  # padding before it
        st.lists(st.integers(1, 0xFFFF), min_size=1, max_size=3),  # usages
        st.integers(0, 2),  # further fields, of the last usage
        SIGNED,
        st.integers(0, 1 << 31),
        st.booleans(),  # with its own page, in four bytes
    ),
    max_size=12,
)


@given(fields=FIELDS, report=st.none() | st.integers(1, 255), page=st.integers(1, 0xFFFF))
def test_any_fields_written_as_items_are_read_as_they_were_meant(fields, report, page):
    data = item(0x08, TOUCH_SCREEN, 4) + item(0xA0, 1, 1) + item(0x04, page, 2)
    data += b"" if report is None else item(0x84, report, 1)
    offset, meant = 0, []
    for bits, padding, usages, further, low, span, own in fields:
        high, every = min(low + span, (1 << 31) - 1), usages + usages[-1:] * further
        if offset + padding + len(every) * bits > MAX_REPORT_BITS:
            break
        data += item(0x74, 1, 1) + item(0x94, padding, 4) + item(0x80, 0x03, 1)
        data += item(0x14, low, 4) + item(0x24, high, 4)
        data += item(0x74, bits, 1) + item(0x94, len(every), 1)
        for usage in usages:
            data += item(0x08, 7 << 16 | usage, 4) if own else item(0x08, usage, 2)
        data += item(0x80, 0x02, 1)
        offset += padding
        for usage in every:
            meant.append(((7 if own else page) << 16 | usage, offset, bits, low, high))
            offset += bits
    found = parse(data + b"\xc0")
    assert [field[:5] for _, fields in found.values() for field in fields] == meant
    assert found.keys() <= {report or 0}


@given(
    value=st.integers(-(1 << 31), (1 << 31) - 1), before=st.integers(0, 40), noise=st.integers(0)
)
def test_a_signed_value_is_read_from_any_bits_of_a_report(value, before, noise):
    data = item(0x08, TOUCH_SCREEN, 4) + item(0xA0, 1, 1)
    data += item(0x14, -(1 << 31), 4) + item(0x24, (1 << 31) - 1, 4)
    data += item(0x74, before, 1) + item(0x94, 1, 1) + item(0x80, 0x03, 1)
    data += item(0x74, 32, 1) + item(0x08, 1, 1) + item(0x80, 0x02, 1)
    _, (field,) = parse(data)[0]
    report = noise << before + 32 | (value & 0xFFFF_FFFF) << before | noise & (1 << before) - 1
    assert field.value(report) == value


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x26\xff", "byte 0: cut short"),
        (item(0x74, 8, 1) + item(0x94, 1 << 31, 4) + b"\x81\x03", "a report of more"),
    ],
)
def test_what_no_device_can_mean_is_refused_in_words_and_at_once(data, words):
    def refuse():
        with pytest.raises(DescriptorError, match=words):
            parse(data)

    assert is_at_once(refuse, lambda: parse(item(0x74, 8, 1) + item(0x94, 1, 1) + b"\x81\x03"))


def decoded(descriptor, reports):
    """What the decoder of a descriptor, if it is a touch screen's, makes of bytes."""
    try:
        layout = TouchLayout.of(descriptor)
    except DescriptorError:
        return []
    if layout is None:
        return []
    decoder = HidDecoder(layout)
    return [contact for data in reports for report in decoder.feed(data) for contact in report]


@given(data=st.binary(max_size=400))
def test_any_bytes_are_a_descriptor_or_are_refused(data):
    assert decoded(data, [data]) is not None


@given(
    name=st.sampled_from(["hid-0006", "hid-0007", "mouse"]),
    hits=st.lists(st.tuples(st.integers(0, 296), st.integers(0, 255)), min_size=1, max_size=6),
    reports=st.lists(st.binary(max_size=60), max_size=6),
)
def test_a_damaged_descriptor_is_refused_or_gives_positions_on_the_screen(
    descriptors, name, hits, reports
):
    data = bytearray(descriptors[name])
    for at, byte in hits:
        data[at % len(data)] = byte
    assert all(0 <= c.x <= 1 and 0 <= c.y <= 1 for c in decoded(bytes(data), reports))
