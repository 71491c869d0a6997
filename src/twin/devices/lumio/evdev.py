"""Linux input events, the fallback where the kernel does not hand out the raw HID reports."""

from __future__ import annotations

import struct

from twin.devices.lumio.decoder import INCOMPLETE, Contact, Decoder, Packet, Report

_EVENT = struct.Struct("@llHHi")
_SYN, _ABS = 0x00, 0x03
_REPORT, _DROPPED = 0x00, 0x03
_SLOT, _X, _Y, _TRACKING = 0x2F, 0x35, 0x36, 0x39
_TOP = 32767
_SLOTS = 16
_TYPES = frozenset(range(0x20))


class Evdev(Decoder):
    """Decoder of ``struct input_event``, multi-touch protocol B.

    The kernel passes on only what changes: a ball at rest sends nothing, so silence tells nothing.
    The range is the digitizer's, 0..32767.
    """

    name = "evdev"
    size = _EVENT.size
    silent_at_rest = True

    def __init__(self) -> None:
        super().__init__()
        self._slot = 0
        self._contacts: dict[int, list[int]] = {}
        self._changed: set[int] = set()

    def _packet(self, buffer: bytearray, at: int) -> Packet | None:
        if len(buffer) - at < self.size:
            return INCOMPLETE
        _, micro, kind, code, value = _EVENT.unpack_from(buffer, at)
        if not (0 <= micro < 1_000_000 and kind in _TYPES):
            return None
        if kind == _ABS:
            self._set(code, value)
        elif kind == _SYN and code == _DROPPED:
            self._changed.clear()
        elif kind == _SYN and code == _REPORT:
            return Packet(self.size, self._report())
        return Packet(self.size)

    def _set(self, code: int, value: int) -> None:
        """Take in one absolute axis of the current slot: [x, y, down]."""
        if code == _SLOT:
            self._slot = value if 0 <= value < _SLOTS else 0
            return
        if code not in {_X, _Y, _TRACKING}:
            return
        contact = self._contacts.setdefault(self._slot, [0, 0, 1])
        if code == _TRACKING:
            contact[2] = int(value >= 0)
        else:
            contact[code - _X] = value
        self._changed.add(self._slot)

    def _report(self) -> Report | None:
        contacts = []
        for slot in sorted(self._changed):
            x, y, down = self._contacts[slot]
            if 0 <= x <= _TOP and 0 <= y <= _TOP:
                contacts.append(Contact(x / _TOP, y / _TOP, bool(down), slot + 1))
            else:
                self.tally.outside += 1
            if not down:
                del self._contacts[slot]
        self._changed.clear()
        return tuple(contacts) or None
