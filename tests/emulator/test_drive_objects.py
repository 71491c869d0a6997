"""`twin.emulator.drive_objects`.

Two readings of one drive, the host's object dictionary and the emulated drive's, side by side.

They were written apart. Either one with a wrong index or type must be noticed: by the comparison
here, and by the bring-up where it uses the object.
"""

from dataclasses import replace

import pytest
from stepped import SteppedDrives

from twin.devices.akd import protocol
from twin.devices.akd.conditions import DriveError
from twin.emulator import drive_objects

NODE = 1
HOST = protocol.objects()
DRIVE = drive_objects.drive_objects(NODE)
NOT_IN_THE_DRIVE = {(index, sub) for index in range(0x1400, 0x1404) for sub in (3, 5)}
"""CiA 301 has these parameters of receive PDOs, the vendor's EDS has not; nothing may use them."""

READ = 0x40


def text(key):
    return f"{key[0]:04X}h:{key[1]}"


def brought_up():
    """Objects that a host brings a drive up with, enables and watches it: all, those written."""
    used, written = set(), set()
    with SteppedDrives() as rig:
        drive = rig.drives[0]
        receive = drive.receive

        def listen(frame):
            if frame.cob_id == 0x600 + drive.node and len(frame.data) == 8:
                key = (int.from_bytes(frame.data[1:3], "little"), frame.data[3])
                used.add(key)
                if frame.data[0] != READ:
                    written.add(key)
            return receive(frame)

        drive.receive = listen
        rig.enabled().run(1.0)
    return sorted(used), sorted(written)


USED, WRITTEN = brought_up()


def test_host_and_drive_agree_in_every_object_of_the_host():
    of_both = {key: each for key, each in HOST.items() if key not in NOT_IN_THE_DRIVE}
    assert {key: each.type for key, each in of_both.items()} == {
        key: DRIVE[key].type for key in of_both
    }
    assert not NOT_IN_THE_DRIVE & DRIVE.keys()


def test_the_host_uses_no_object_beyond_both_dictionaries():
    assert set(USED) <= HOST.keys() & DRIVE.keys()
    assert len(USED) > 40


@pytest.mark.parametrize(
    ("record", "entry"),
    [
        (0x1600, 0x36220020),  # a limit, which no PDO carries
        (0x1A00, 0x36220020),
        (0x1600, 0x60410010),  # the status word cannot be commanded
        (0x1A00, 0x60410020),  # nor has it 32 bits
        (0x1A00, 0x40000010),  # nothing there
    ],
)
def test_a_pdo_takes_nothing_that_the_drive_cannot_put_there(record, entry):
    store = drive_objects.ObjectStore(NODE)
    store.write(record - 0x200, 1, (1 << 31 | 0x201).to_bytes(4, "little"))
    store.write(record, 0, b"\0")
    with pytest.raises(drive_objects.AbortError) as caught:
        store.write(record, 1, entry.to_bytes(4, "little"))
    assert caught.value.code == drive_objects.NOT_MAPPABLE


OTHER = {"U8": "U16", "U16": "U8", "U32": "U16", "I8": "I16", "I16": "I32", "I32": "I16"}


def start_refused(*others):
    """How a start is refused, in one line; others: exceptions that will do as well."""
    with pytest.raises((DriveError, *others)) as caught, SteppedDrives() as rig:
        rig.servos.start()
    return str(caught.value)


@pytest.mark.parametrize("key", WRITTEN, ids=text)
def test_the_bring_up_itself_fails_if_the_host_has_a_wrong_type(key, monkeypatch):
    wrong = replace(HOST[key], type=OTHER[HOST[key].type])
    table = {**HOST, key: wrong}
    monkeypatch.setattr(protocol, "objects", lambda: table)
    refusal = start_refused()
    assert any(words in refusal for words in (f"{key[0]:04X}h", "mapping PDO", "data size"))


OPTIONAL = {(0x3498, 0), (0x3506, 0), (0x36E5, 0)}
"""Settings that the host reads where they are; it names them and goes on."""


@pytest.mark.parametrize("key", [key for key in USED if key not in OPTIONAL], ids=text)
def test_the_bring_up_itself_fails_if_the_drive_has_no_such_object(key, monkeypatch):
    table = {other: each for other, each in DRIVE.items() if other != key}
    monkeypatch.setattr(drive_objects, "drive_objects", lambda node: dict(table))
    assert start_refused(KeyError)  # those that the drive itself cannot do without


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ((0x1000, 0), 0x00030192, "device type"),
        ((0x1018, 1), 0x6B, "vendor"),
        ((0x608F, 2), 2, "524288 counts per motor revolution"),
        ((0x36E9, 0), 1 << 4, "204Ch"),
        ((0x6091, 1), 80, "gear ratio 6091h is 80:1"),
        ((0x6092, 1), 360, "feed constant 6092h is 360:1"),
        ((0x6502, 0), 0xE9, "no profile velocity mode"),
    ],
    ids=lambda each: text(each) if isinstance(each, tuple) else "",
)
def test_a_drive_that_begins_with_another_constant_is_refused(key, value, words, monkeypatch):
    table = {**DRIVE, key: DRIVE[key]._replace(default=value)}
    monkeypatch.setattr(drive_objects, "drive_objects", lambda node: dict(table))
    assert words in start_refused()
