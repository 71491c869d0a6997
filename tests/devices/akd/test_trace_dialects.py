"""`twin.devices.akd.trace_files`.

One run on an emulated rig, as every program writes it: the same events come back."""

import re
from copy import copy
from importlib.util import find_spec

import can
import pytest
from trace_dialects import DIALECTS, pack, write_dialect

from twin.devices.akd.decoding import Conversation
from twin.devices.akd.traces import read_trace
from twin.emulator.lockstep import LockstepRig
from twin.run.finished import run
from twin.scenario import load

BEGIN = 1_700_000_000.0
"""Time of day of the first frame, s since 1970."""


@pytest.fixture(scope="session")
def frames():
    """The frames of a run, from the boot-up of its drives to their end, in whole microseconds."""
    rig = LockstepRig(scenario := load("hold", ["duration=0.2"]))
    heard = []
    rig.lockstep.heard = heard.append
    run(scenario, rig=rig)
    first = heard[0].timestamp
    for each in heard:
        each.timestamp = round(BEGIN + each.timestamp - first, 6)
        each.channel = 0
    return heard


@pytest.fixture(scope="session")
def events(frames):
    """The events of the run, with its times, and with the numbers of frames instead."""
    numbered = [copy(each) for each in frames]
    for number, each in enumerate(numbered):
        each.timestamp = float(number)
    return {True: Conversation(frames).events, False: Conversation(numbered, timed=False).events}


def without_durations(event):
    """An event without its time and the durations in its text, which the format rounds."""
    return event.who, event.kind, re.sub(r"[\d.]+ ms", "ms", event.text)


def skip_without_asammdf(name):
    if name.endswith(".mf4") and find_spec("asammdf") is None:
        pytest.skip("asammdf is not installed")


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_gives_the_same_events(tmp_path, frames, events, name):
    skip_without_asammdf(name)
    dialect = DIALECTS[name]
    found = read_trace(write_dialect(dialect, tmp_path, frames))
    assert found.timed is dialect.timed
    assert len(found.remarks) == len(dialect.remarks)
    assert all(map(str.endswith, found.remarks, dialect.remarks))
    assert len(found.frames) == len(frames)
    decoded = Conversation(found.frames, timed=found.timed)
    known = events[dialect.timed]
    assert len(known) > 50
    assert list(map(without_durations, decoded.events)) == list(map(without_durations, known))
    times = [each.time for each in decoded.events]
    near = 1.1 * dialect.resolution + 1e-6  # a time since 1970 has 0.2 us in float64
    assert times == pytest.approx([each.time for each in known], abs=near)


@pytest.mark.parametrize("name", DIALECTS)
def test_every_dialect_may_be_packed_by_gzip(tmp_path, frames, name):
    skip_without_asammdf(name)
    file = write_dialect(DIALECTS[name], tmp_path, frames[:300])
    plain, packed = read_trace(file), read_trace(pack(file))
    assert len(plain.frames) == 300
    for each, other in zip(plain.frames, packed.frames, strict=True):
        assert (each.timestamp, each.arbitration_id) == (other.timestamp, other.arbitration_id)
        assert bytes(each.data) == bytes(other.data)
    assert [each.partition(": ")[2] for each in plain.remarks] == [
        each.partition(": ")[2] for each in packed.remarks
    ]


@pytest.mark.parametrize("name", ["candump -L", "candump -L -x", "python-can .log"])
def test_a_log_of_candump_is_read_as_python_can_reads_it(tmp_path, frames, name):
    file = write_dialect(DIALECTS[name], tmp_path, frames)
    with can.LogReader(file) as reader:
        theirs = list(reader)
    ours = read_trace(file).frames
    assert len(theirs) == len(frames)
    for each, their in zip(ours, theirs, strict=True):
        assert each.timestamp == their.timestamp
        assert each.arbitration_id == their.arbitration_id
        assert bytes(each.data) == bytes(their.data)
        assert (each.is_extended_id, each.is_rx) == (their.is_extended_id, their.is_rx)
        assert each.channel == their.channel
