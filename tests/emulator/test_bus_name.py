"""Tests of `twin.emulator.bus_name`: names of buses, read without python-can."""

import can
import pytest

from twin.base.errors import RigError
from twin.emulator.bus_name import BusName, interface_names, parse_bus


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("vcan0", ("socketcan", "vcan0")),
        ("can1", ("socketcan", "can1")),
        ("udp_multicast", ("udp_multicast", "")),
        ("udp_multicast:ff15::1", ("udp_multicast", "ff15::1")),
        ("udp_multicast:239.1.2.3@43000", ("udp_multicast", "239.1.2.3", 43000)),
        ("slcan:/dev/ttyACM0", ("slcan", "/dev/ttyACM0")),
    ],
)
def test_a_bus_has_a_name(text, name):
    assert parse_bus(text) == BusName(*name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("socketcam:can0", "did you mean 'socketcan'"),
        ("", "unknown CAN interface"),
        ("udp_multicast:10.0.0.1", "not an IP multicast address"),
        ("udp_multicast:here", "not an IP multicast address"),
        ("udp_multicast:239.1.2.3@80", "port must be 1024 to 65535"),
    ],
)
def test_a_bus_that_cannot_be_is_refused_in_one_line(text, words):
    with pytest.raises(RigError, match=words) as caught:
        parse_bus(text)
    assert "\n" not in str(caught.value)


def test_the_interfaces_are_those_of_the_loaded_library():
    assert interface_names() == can.VALID_INTERFACES


def test_the_interfaces_of_an_unknown_version_come_from_the_loaded_library(monkeypatch):
    monkeypatch.setattr("twin.emulator.bus_name.find_spec", lambda _: None)
    assert interface_names() == can.VALID_INTERFACES
