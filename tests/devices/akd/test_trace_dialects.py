"""`twin.devices.akd.trace_files`.

One run on an emulated rig, as every program writes it: the same events come back."""

import json
import re
import subprocess
import sys
from copy import copy
from functools import cache
from importlib.util import find_spec

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trace_dialects import DIALECTS, candump_log, pack, write_dialect

from twin.base.errors import LogError
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.trace_files import Notes
from twin.devices.akd.trace_files.candump import LOG_LINE, read_candump_log
from twin.devices.akd.traces import read_trace
from twin.emulator.lockstep import LockstepRig
from twin.run.finished import run
from twin.scenario import load

BEGIN = 1_700_000_000.0
"""Time of day of the first frame, s since 1970."""


@pytest.fixture(scope="session")
def frames():
    """The frames of a run, from the boot-up of its drives to their end, in whole microseconds."""
    rig = LockstepRig(scenario := load("hold", ["duration=0.1"]))
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


@pytest.mark.long
def test_a_measurement_file_is_read_where_asammdf_was_imported_before(tmp_path, frames):
    skip_without_asammdf("a.mf4")
    file = write_dialect(DIALECTS["python-can .mf4"], tmp_path, frames[:30])
    script = """
import sys
import asammdf
from pathlib import Path
from twin.devices.akd.traces import read_trace
print(len(read_trace(Path(sys.argv[1])).frames))
"""
    done = subprocess.run(
        [sys.executable, "-c", script, file], capture_output=True, text=True, check=True
    )
    assert done.stdout == "30\n"


COPIED = {
    ".trc 1.0": lambda line: line,
    ".trc 1.1": lambda line: line,
    ".trc 1.2": lambda line: line,
    ".trc 1.3": lambda line: line,
    ".trc 2.0": lambda line: line,
    ".trc 2.1": lambda line: line,
    "candump -td": lambda line: line,
    "candump -tz": lambda line: line.replace("can0", ""),
    "candump": lambda line: line.replace("can0", ""),
}
"""Dialects of which lines are copied without the head of the file, and what is left of a line."""


@pytest.mark.parametrize("name", COPIED)
def test_lines_copied_out_of_a_file_are_read(tmp_path, frames, name):
    file = write_dialect(DIALECTS[name], tmp_path, frames)
    lines = [each for each in file.read_text().splitlines(keepends=True) if each[0] != ";"]
    file.write_text("".join(COPIED[name](line) for line in lines[100:]))
    found = read_trace(file)
    assert len(found.frames) == len(frames) - 100
    began = found.frames[0].timestamp - frames[100].timestamp if found.timed else 0.0
    for number, (each, known) in enumerate(zip(found.frames, frames[100:], strict=True)):
        assert each.arbitration_id == known.arbitration_id
        assert bytes(each.data) == bytes(known.data)
        at = known.timestamp + began if found.timed else float(number)
        assert each.timestamp == pytest.approx(at, abs=2e-3)


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


@pytest.mark.parametrize("ending", [".asc", ".blf", ".trc"])
def test_channels_of_vectors_and_peaks_files_count_from_one(tmp_path, ending):
    """The file itself is the truth: python-can adds 1 to its channels when it writes one."""
    file = tmp_path / f"bus{ending}"
    with can.Logger(file) as writer:
        for number in range(5):
            which = number % 2
            writer(can.Message(BEGIN + number, 0x701 + which, False, data=b"\5", channel=which))
    if ending == ".asc":
        rows = [line.split() for line in file.read_text().splitlines() if " Rx " in line]
        assert [row[1] for row in rows] == ["1", "2", "1", "2", "1"]
    found = read_trace(file)
    assert found.channel == "1"
    assert {each.channel for each in found.frames} == {"1"}
    assert "channel 1 is shown (3 frames); others: 2 (2)" in found.remarks
    other = read_trace(file, channel="2")
    assert {each.arbitration_id for each in other.frames} == {0x702}


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cut")


CUT = (
    "candump -L", "candump -L -x", "candump", "candump -ta -x", "candump -tA", ".asc, CANFD",
    ".asc, relative", ".trc 1.0", ".trc 1.3", ".trc 2.1", "BUSMASTER", "SavvyCAN",
    "pcap", "pcapng of any device", "python-can .csv",
)  # fmt: skip
"""Formats in which each frame has its own bytes, and whose first line identifies them."""


@pytest.fixture(scope="session")
def whole(folder, frames):
    """A file of the first 41 frames up to the end of the last but one, and where each ends."""

    @cache
    def made(name):
        contents = [
            write_dialect(DIALECTS[name], folder, frames[:k]).read_bytes() for k in range(1, 42)
        ]
        last = np.frombuffer(contents[-1], np.uint8)
        ends = []
        for each in contents[:-1]:
            size = min(len(each), len(last))
            differs = np.flatnonzero(np.frombuffer(each, np.uint8)[:size] != last[:size])
            ends.append(int(differs[0]) if len(differs) else size)
        return contents[-1][: ends[-1]], ends

    return made


def read_part(file, content):
    """The frames that are read of a part of a file; it also is decoded."""
    file.write_bytes(content)
    try:
        found = read_trace(file)
    except LogError as error:
        message = str(error)
        assert "\n" not in message
        return []
    Conversation(found.frames, timed=found.timed)
    return [(each.arbitration_id, bytes(each.data)) for each in found.frames]


@pytest.mark.parametrize("name", CUT)
@settings(max_examples=20)
@given(share=st.floats(0, 1))
def test_of_a_file_cut_anywhere_the_whole_frames_are_read(folder, frames, whole, name, share):
    content, ends = whole(name)
    size = round(share * len(content))
    found = read_part(folder / DIALECTS[name].file, content[:size])
    count = sum(end <= size for end in ends)
    assert found == [(each.arbitration_id, bytes(each.data)) for each in frames[:count]]


@pytest.mark.parametrize("name", ["candump -L", ".asc", "pcap", "python-can .blf"])
def test_of_a_packed_file_cut_anywhere_the_first_frames_are_read(folder, frames, name):
    file = write_dialect(DIALECTS[name], folder, frames[:200])
    file = file if name.endswith(".blf") else pack(file)
    content = file.read_bytes()
    for size in range(0, len(content), len(content) // 20):
        found = read_part(file, content[:size])
        assert found == [(each.arbitration_id, bytes(each.data)) for each in frames[: len(found)]]


@given(data=st.data())
def test_a_damaged_line_of_a_log_is_a_frame_exactly_if_the_whole_line_is_one(data):
    plain = data.draw(
        st.sampled_from(
            (
                "(1700000000.169500) can0 601#4018100100000000 T\n",
                "(1700000000.000500)  can1 701#05\n",
                "(0.000500) can0 080# R\n",
                "(0.000500) can0 20000080#0000000000000000\n",
                "(0.000500) can0 00000701#7F\n",
                "(0.000500) can0 701#R4 R\n",
            )
        )
    )
    at = data.draw(st.integers(0, len(plain) - 1))
    new = data.draw(st.sampled_from((*" \t#()._-+eEGRTx0789aF", "")))
    line = plain[:at] + new + plain[at + 1 :]
    found = list(read_candump_log([line], Notes()))
    match = LOG_LINE.match(line)
    _, seconds, channel, shown, remote, _, content, way = match.groups() if match else [None] * 8
    number = int(shown, 16) if match else 0
    wrong = match is None or (len(shown) == 3 and number > 0x7FF)
    assert found == [None] if wrong else len(found) == 1
    if not wrong:
        (frame,) = found
        assert frame.timestamp == float(seconds or 0.0)  # without a time it is number 0
        assert frame.channel == channel
        assert frame.arbitration_id == number & 0x1FFFFFFF
        assert frame.is_error_frame is (len(shown) == 8 and bool(number & 0x20000000))
        assert frame.is_extended_id is (len(shown) == 8 and not frame.is_error_frame)
        assert frame.is_remote_frame is bool(remote)
        assert frame.data == bytes.fromhex((content or "").replace(".", ""))
        assert frame.is_rx is (way not in {"T", "t"})


READ = """
import sys
from pathlib import Path
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.traces import read_trace
print(len(Conversation(read_trace(Path(sys.argv[1])).frames).events))
print(*sorted({"numpy", "can", "scipy", "pydantic"} & set(sys.modules)))
"""


def test_a_log_is_read_and_decoded_without_the_imports_that_cost(tmp_path, frames, events):
    file = write_dialect(DIALECTS["candump -L"], tmp_path, frames)
    done = subprocess.run(
        [sys.executable, "-c", READ, file], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{len(events[True])}\n\n"


TRACE = """
import sys
from pathlib import Path
from twin.cli import main
try:
    main()
except SystemExit as ended:
    assert not ended.code
(line,) = (each for each in Path("/proc/self/status").open() if each.startswith("VmHWM"))
print(int(line.split()[1]) / 1024, file=sys.stderr)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_million_frames_are_decoded_in_at_most_500_mib(tmp_path, frames):
    begin, part = frames[:-300], frames[-300:]
    span = part[-1].timestamp - part[0].timestamp + 0.002
    with (tmp_path / "a.log").open("w") as file:
        file.write(candump_log()(begin))
        for number in range((1_000_000 - len(begin)) // len(part)):
            moved = [copy(each) for each in part]
            for each in moved:
                each.timestamp += number * span
            file.write(candump_log()(moved))
    done = subprocess.run(
        [sys.executable, "-c", TRACE, "trace", tmp_path / "a.log", "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert 999_000 < json.loads(done.stdout)["frames"] <= 1_000_000
    assert float(done.stderr) < 500
