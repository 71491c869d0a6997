"""The master of the library canopen on emulated drives, in bus time."""

import io
from functools import cache

import canopen
from canopen.objectdictionary.eds import import_eds
from canopen.profiles.p402 import BaseNode402

from twin.emulator.can_bus import EmulatedBus
from twin.emulator.drive_objects import Frame
from twin.emulator.load import InertiaLoad
from twin.emulator.profile_drive import ProfileDrive
from twin.emulator.profile_eds import eds_text

STEP_S = 0.0005
TURN = 65536
"""Counts per motor revolution."""


@cache
def read_eds(node):
    """The drive's EDS as canopen reads it; nobody changes it."""
    return import_eds(io.StringIO(eds_text()), node)


class SteppedNetwork(canopen.Network):
    """A network without threads: each frame of the master takes a millisecond of bus time.

    Args:
        nodes: Nodes of the drives.
    """

    def __init__(self, *nodes):
        super().__init__()
        self.drives = [ProfileDrive(node, InertiaLoad()) for node in nodes]
        self.emulated = EmulatedBus(self.drives)
        self.heard = []
        for node in nodes:
            self.add_node(BaseNode402(node, read_eds(node)))
        self.run(STEP_S)

    def send_message(self, can_id, data, remote=False):
        self.emulated.from_host(Frame(can_id, bytes(data), remote))
        self.deliver()
        self.run(0.001)

    def run(self, seconds):
        """Let bus time in s pass."""
        for _ in range(round(seconds / STEP_S)):
            self.emulated.step(STEP_S)
            self.deliver()

    def deliver(self):
        """Give the master what it hears."""
        for frame in self.emulated.to_host():
            self.heard.append((self.emulated.time, frame))
            self.notify(frame.cob_id, bytearray(frame.data), self.emulated.time)

    def disconnect(self):
        """Nothing is open."""
