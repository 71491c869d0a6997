"""`twin.devices.akd.conditions`.

Any frames at all between those of healthy drives: nothing is raised, and no motor runs away."""

import can
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from stepped import SteppedDrives

from twin.devices.akd.conditions import DRIVE_CONDITIONS, DriveError
from twin.emulator.power_stage import Power
from twin.hal.interface import Severity

OURS = [
    base + node
    for base in (0x080, 0x180, 0x200, 0x280, 0x300, 0x380, 0x480, 0x580, 0x600, 0x700)
    for node in (0, 1, 2, 3, 127)
]
IDENTIFIERS = st.sampled_from([0x000, *OURS]) | st.integers(0, 0x7FF) | st.integers(0, 0x1FFFFFFF)
KINDS = ("data", "data", "data", "remote", "extended", "error", "fd")


@st.composite
def messages(draw):
    """A frame of any identifier, length and kind."""
    kind, identifier = draw(st.sampled_from(KINDS)), draw(IDENTIFIERS)
    extended = kind in {"extended", "error"} or identifier > 0x7FF
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        is_fd=kind == "fd",
        data=None if kind == "remote" else draw(st.binary(max_size=8)),
    )


RATE, LIMIT = 0.8, 1.0
"""Rate that is commanded, and the fastest that a motor may turn, rad/s."""


def garbled(garbage, every):
    """Two drives in motion whose host hears a frame of garbage every so many s, and 0.1 s more.

    Returns:
        The rig, the fastest rate of a motor in rad/s, and whether something forbids torque.
    """
    with SteppedDrives() as rig:
        rig.enabled()
        rig.run(0.02, lambda _: (RATE, -RATE))
        adapter, waiting, fastest = rig.adapter, list(garbage), 0.0
        receive = adapter.recv

        def recv(timeout=None):
            if waiting and rig.bus.time >= recv.due:
                recv.due = rig.bus.time + every
                return waiting.pop(0)
            return receive(timeout)

        recv.due = 0.0
        adapter.recv = recv
        while waiting:
            rig.run(rig.config.period, lambda _: (RATE, -RATE))
            fastest = max(fastest, *(abs(drive.rate) for drive in rig.drives))
        rig.run(0.1, lambda _: (RATE, -RATE))
        fastest = max(fastest, *(abs(drive.rate) for drive in rig.drives))
        stopped = any(each.condition.severity is Severity.STOP for each in rig.seen)
        return rig, fastest, stopped


def check(garbage, every):
    """No more torque, and nothing that brings it back, once something forbids it."""
    rig, fastest, stopped = garbled(garbage, every)
    assert {each.condition for each in rig.seen} <= set(DRIVE_CONDITIONS)
    assert fastest <= LIMIT
    if stopped:
        assert not rig.servos.enabled
        assert all(drive.state is not Power.OPERATION_ENABLED for drive in rig.drives)
        assert all(abs(drive.rate) < 0.7 for drive in rig.drives)


GARBAGE = st.lists(messages(), min_size=1, max_size=20)
EVERY = st.sampled_from([0.0, 0.002, 0.01])


@pytest.mark.long
@settings(max_examples=300, deadline=None)
@given(GARBAGE, EVERY)
def test_many_frames_raise_nothing_and_let_no_motor_run_away(garbage, every):
    check(garbage, every)


@settings(max_examples=8, deadline=None)
@given(GARBAGE, EVERY)
@example([can.Message(arbitration_id=0x181, is_extended_id=False, data=b"")], 0.0)
@example([can.Message(arbitration_id=0x581, is_extended_id=False, data=bytes(8))] * 3, 0.02)
@example([can.Message(arbitration_id=0x701, is_extended_id=False, data=b"\x7f")] * 9, 0.002)
def test_no_frame_raises_or_lets_a_motor_run_away(garbage, every):
    check(garbage, every)


@settings(max_examples=20, deadline=None)
@given(st.lists(messages(), max_size=20))
def test_a_start_beside_any_frames_comes_up_or_is_refused_in_one_line(garbage):
    with SteppedDrives() as rig:
        opened, waiting = rig.servos._opener, list(garbage)

        def opener(config):
            bus = opened(config)
            receive = bus.recv
            bus.recv = lambda timeout=None: waiting.pop(0) if waiting else receive(timeout)
            return bus

        rig.servos._opener, refusal = opener, ""
        try:
            rig.servos.start()
        except DriveError as error:
            refusal = str(error)
        assert "\n" not in refusal
        assert not any(drive.power.live for drive in rig.drives)
