"""`twin.devices.lumio`.

Touch reports by the panel's own word, on the decoder and through a raw HID device."""

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.base.jobs import wait_until
from twin.devices.lumio import config as settings
from twin.devices.lumio.config import LumioConfig, ScreenError
from twin.devices.lumio.protocols import HidDecoder, TouchLayout, decoder_of
from twin.devices.lumio.screen import LumioScreen
from twin.emulator.screen import PACKET_ENCODERS, Protocol, Spot

PANELS = [Protocol.HID_0006, Protocol.HID_0007]
SHARE = st.floats(0, 1)
AT = "80 13 68 19"
REST = " 00" * 18
ODD = {
    "no confidence": ("hid-0006", f"11 01 {AT}{REST} 01"),
    "not in range": ("hid-0006", f"21 01 {AT}{REST} 01"),
    "padding": ("hid-0006", f"ff 01 {AT}{REST} 01"),
    "a stale place beyond the count": ("hid-0006", f"31 01 {AT} 31 02 e0 67 70 10{' 00' * 12} 01"),
    "a number of 0": ("hid-0006", f"31 00 {AT}{REST} 01"),
    "no confidence, one contact": ("hid-0007", f"11 00 {AT} 01 00"),
    "padding, one contact": ("hid-0007", f"f1 ff {AT} 01 00"),
}


RECORDED = [
    ("hid-0006", f"31 01 80 13 68 19{REST} 01", [(0x1380, 0x1968, True, 1)]),
    ("hid-0006", f"30 01 b0 5b 28 5c{REST} 01", [(0x5BB0, 0x5C28, False, 1)]),
    (
        "hid-0006",
        f"31 01 c8 1e 08 27 31 02 e0 67 70 10{' 00' * 12} 02",
        [(0x1EC8, 0x2708, True, 1), (0x67E0, 0x1070, True, 2)],
    ),
    (
        "hid-0006",  # six fingers take two reports
        "31 01 98 35 48 46 31 02 d8 2d 20 3e 31 03 b0 1c 78 3f 31 04 68 4b 30 2d 06"
        f"31 05 b8 58 40 21 31 06 48 65 40 26{' 00' * 13}",
        [
            (0x3598, 0x4648, True, 1),
            (0x2DD8, 0x3E20, True, 2),
            (0x1CB0, 0x3F78, True, 3),
            (0x4B68, 0x2D30, True, 4),
            (0x58B8, 0x2140, True, 5),
            (0x6548, 0x2640, True, 6),
        ],
    ),
    (
        "hid-0007",
        "31 00 d8 07 a0 0a 01 00 30 00 48 70 58 69 01 00",
        [(0x07D8, 0x0AA0, True, 1), (0x7048, 0x6958, False, 1)],
    ),
    ("hid-0007", f"fe 00 {AT} 01 00", [(0x1380, 0x1968, False, 1)]),  # all but the tip is set
]


@pytest.mark.parametrize(("name", "text", "contacts"), RECORDED)
def test_recorded_reports_of_a_panel_give_its_contacts(name, text, contacts):
    reports = decoder_of(name).feed(bytes.fromhex(text))
    found = [contact for report in reports for contact in report]
    assert [(round(c.x * 32767), round(c.y * 32767), c.down, c.id) for c in found] == contacts


@pytest.mark.parametrize("case", ODD)
def test_padding_and_flags_that_are_no_tip_do_not_hide_a_contact(case):
    name, text = ODD[case]
    ((contact,),) = decoder_of(name).feed(bytes.fromhex(text))
    assert (contact.x, contact.y, contact.down) == (0x1380 / 32767, 0x1968 / 32767, True)


@pytest.mark.short("hid-0007")
@pytest.mark.parametrize("protocol", PANELS)
@given(
    spots=st.lists(st.tuples(SHARE, SHARE, st.booleans()), min_size=1, max_size=8),
    cuts=st.booleans(),
)
def test_what_an_emulated_panel_says_is_read_within_half_a_native_count(protocol, spots, cuts):
    packets = PACKET_ENCODERS[protocol](
        [Spot(x, y, k, d) for k, (x, y, d) in enumerate(spots, start=1)]
    )
    decoder = decoder_of(protocol)
    parts = packets if cuts else [b"".join(packets)]
    found = [c for part in parts for report in decoder.feed(part) for c in report]
    assert [(c.down, c.id) for c in found] == [(d, k) for k, (_, _, d) in enumerate(spots, 1)]
    # Half a count of 4096, and the 7 of 32767 by which the range is larger than the grid.
    within = 0.5 / 4095 + 7 / 32767 + 1e-12
    assert [c[:2] for c in found] == [pytest.approx(spot[:2], abs=within) for spot in spots]
    assert decoder.stats.skipped == 0


def test_half_a_report_is_skipped_and_a_position_beyond_the_range_refused():
    one = decoder_of("hid-0007")
    assert one.feed(bytes.fromhex("31 00 80")) == []
    assert one.feed(bytes.fromhex("31 00 f8 ff 00 20 01 00")) == []
    assert (one.stats.skipped, one.stats.outside, one.stats.reports) == (3, 1, 0)


def test_numbered_reports_of_other_parts_of_an_interface_are_left_alone(descriptors):
    data = descriptors["mouse"].replace(b"\xa1\x01", b"\xa1\x01\x85\x01", 1)
    data += descriptors["hid-0007"].replace(b"\xa1\x01", b"\xa1\x01\x85\x07", 1)
    decoder = HidDecoder(TouchLayout.of(data))
    assert decoder.feed(bytes.fromhex("01 00 05 05")) == []
    ((contact,),) = decoder.feed(bytes.fromhex(f"07 31 00 {AT} 01 00"))
    assert contact.x == 0x1380 / 32767
    assert decoder.stats.skipped == 0


def test_without_a_count_places_that_touch_hold_contacts(descriptors):
    places = descriptors["hid-0006"].replace(bytes.fromhex("09 54"), bytes.fromhex("09 56"))
    decoder = HidDecoder(TouchLayout.of(places))
    touch = bytes.fromhex(f"31 01 {AT}{REST} 00")
    ((first,),) = decoder.feed(touch)
    assert first.down
    assert decoder.feed(bytes([0x30]) + touch[1:]) == []


@pytest.fixture
def hidraw(descriptors, monkeypatch, tmp_path):
    """Makes a raw HID device of a pipe: a port, and what writes a report to it.

    A panel that is not known has a damaged descriptor.
    """
    pytest.importorskip("fcntl")
    port = tmp_path / "hidraw0"
    os.mkfifo(port)
    end = os.open(port, os.O_RDWR | os.O_NONBLOCK)
    monkeypatch.setattr(settings, "HIDRAW_CLASS", tmp_path / "class")

    def make(name):
        folder = tmp_path / "class" / "hidraw0" / "device"
        folder.mkdir(parents=True)
        (folder / "report_descriptor").write_bytes(descriptors.get(name, b"\x26\xff"))
        return port, lambda text: os.write(end, bytes.fromhex(text))

    yield make
    os.close(end)


def sees(screen, send, text):
    """Whether a screen feels a ball while a report is repeated."""
    return wait_until(lambda: send(text) and bool(screen.read().touched[0]), 60.0)


@pytest.mark.real_time
@pytest.mark.parametrize("protocol", ["auto", "hid-0007", "hid-0006"])
def test_a_raw_hid_device_is_read_by_its_descriptor_whatever_was_set(hidraw, protocol):
    port, send = hidraw("hid-0006")
    config = LumioConfig(port=str(port), transport="hidraw", protocol=protocol)
    with LumioScreen(config) as screen:
        assert sees(screen, send, ODD["no confidence"][1])
        assert screen.protocol == "hid"


@pytest.mark.real_time
def test_without_a_calibration_the_size_is_the_one_that_the_panel_says(hidraw):
    port, send = hidraw("hid-0007")
    with LumioScreen(LumioConfig(port=str(port), transport="hidraw")) as screen:
        assert sees(screen, send, "31 00 ff 7f 00 00 01 00")
        assert screen.read().position[0].tolist() == pytest.approx([0.377 / 2, 0.305 / 2])


def test_another_interface_of_the_panel_is_refused_and_the_right_one_named(hidraw, monkeypatch):
    port, _ = hidraw("mouse")
    monkeypatch.setattr(settings, "touch_screens", lambda: ["/dev/hidraw3"])
    with pytest.raises(
        ScreenError, match=r"is not a touch screen; the touch screen is /dev/hidraw3$"
    ):
        LumioScreen(LumioConfig(port=str(port), transport="hidraw")).start()


def test_a_damaged_descriptor_is_one_line(hidraw):
    port, _ = hidraw("damaged")
    with pytest.raises(ScreenError, match=r"cannot be read: byte 0: cut short$"):
        LumioScreen(LumioConfig(port=str(port), transport="hidraw")).start()
