"""`twin.devices.akd.findings`.

What is wrong in a trace is found where it is, and nowhere else: frames by CiA 301 and CiA 402."""

import json
import math
import re
import struct
from contextlib import closing
from pathlib import Path

import can
import pytest
from command_line import called
from hypothesis import given
from hypothesis import strategies as st

from twin.cli.trace_report import verdict_lines
from twin.devices.akd.config import AkdConfig, AxisConfig, BusConfig
from twin.devices.akd.conversation_summary import list_remarks, summarise
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings import Severity, assess, kinds
from twin.devices.akd.recording import TraceWriter

OFF, READY, ON, ENABLED, FAULT = "5002", "3102", "3302", "3702", "1802"
"""Status words: switch on disabled, ready, switched on, operation enabled, fault."""


def frame(at, identifier, data="", **more):
    data = bytes.fromhex(data)
    return can.Message(
        timestamp=at, arbitration_id=identifier, is_extended_id=False, data=data, **more
    )


def every(period, begin, end, identifier, data=""):
    """Frames with a period from a time to before another, s."""
    count = round((end - begin) / period)
    return [frame(begin + k * period, identifier, data) for k in range(count)]


def drive(*changes, end, node=5, control=(), sync=0.01):
    """SYNC, and with each the status word of a drive; changes are times and words."""

    def word(of, time):
        return [data for at, data in of if at <= time + 1e-9][-1:]

    frames = []
    for k in range(round(end / sync)):
        at = k * sync
        frames.append(frame(at, 0x080))
        frames += [frame(at + 0.0005, 0x180 + node, data) for data in word(changes, at)]
        frames += [frame(at + 0.001, 0x200 + node, data) for data in word(control, at)]
    return frames


def assessed(*frames, rig=None, names=None, **how):
    heard = sorted(frames, key=lambda each: each.timestamp)
    return assess(Conversation(heard, names, rig, **how))


def codes_of(*frames, **how):
    """Codes of all findings, the worst first."""
    return [each.code for each in assessed(*frames, **how).findings]


def one(code, *frames, **how):
    """The only finding of a code."""
    (its,) = [each for each in assessed(*frames, **how).findings if each.code == code]
    return its


HEALTHY = drive((0, ENABLED), end=2.0, control=[(0, "0f00")])


def test_a_healthy_trace_has_no_finding_and_one_line():
    verdict = assessed(*HEALTHY)
    assert not verdict.findings
    assert verdict.worst is None
    assert verdict.headline == (
        "nothing wrong: 1 node and 1 drive for 1.99 s: SYNC every 10 ms (worst 10 ms), "
        "2 PDOs; no emergency, no error frame"
    )


def test_a_trace_without_any_node_is_not_called_healthy():
    foreign = [each for each in HEALTHY if each.arbitration_id == 0x80]
    assert assessed(*foreign).headline.startswith("no CANopen node heard: 0 nodes for ")


def test_what_was_checked_has_heartbeats_transfers_and_the_load_of_the_bus():
    phi, theta = AxisConfig(name="phi", node=1), AxisConfig(name="theta", node=2)
    rig = AkdConfig(axes=(phi, theta), bus=BusConfig(bitrate=125_000), period=0.01)
    settings = write(1.05, LIMIT, "e8030000") + read(1.35, LIMIT, "e8030000")
    # in a tenth of a second: a heartbeat of 65 bits and two frames of 135, stuffed
    headline = assessed(*BEATS, *settings, rig=rig).headline
    assert headline == (
        "nothing wrong: 1 node for 5.9 s: 1 heartbeat every 100 ms (worst 100 ms), "
        "2 SDO transfers, bus load up to 3 %; no emergency, no error frame"
    )


def test_every_code_has_causes_and_a_first_check():
    for code, kind in kinds().items():
        assert kind.causes, code
        assert kind.check, code


PAGE = Path(__file__).parents[3] / "docs" / "can-findings.md"


def test_the_page_has_a_row_for_every_code():
    rows = re.findall(r"^\| (`[a-z-]+`(?:, `[a-z-]+`)*) \| .+ \| .+ \|$", PAGE.read_text(), re.M)
    rows = [code for row in rows for code in re.findall("[a-z-]+", row)]
    assert sorted(rows) == sorted(kinds())


IDENTIFIERS = (0x000, 0x080, 0x085, 0x185, 0x205, 0x285, 0x585, 0x605, 0x705, 0x706)


@given(
    st.lists(
        st.builds(
            can.Message,
            timestamp=st.floats(0, 5),
            arbitration_id=st.sampled_from(IDENTIFIERS),
            is_extended_id=st.just(False),
            is_error_frame=st.booleans(),
            is_remote_frame=st.booleans(),
            is_rx=st.booleans(),
            data=st.binary(max_size=8),
        ),
        min_size=1,
        max_size=60,
    ),
    st.booleans(),
)
def test_no_frames_whatever_end_in_an_error(heard, timed):
    verdict = assess(Conversation(sorted(heard, key=lambda each: each.timestamp), timed=timed))
    json.dumps(verdict.as_dict(), allow_nan=False)
    for each in verdict.findings:
        assert all(1 <= number <= len(heard) for number in each.frames)


BLOCKED = frame(1.0, 0x085, "2171010200000000")


def test_a_fault_to_the_end_is_unresolved_with_its_cause():
    frames = drive((0, ENABLED), (1, FAULT), end=2.0, control=[(0, "0f00")])
    its = one("drive-fault", *frames, BLOCKED)
    assert its.severity is Severity.UNRESOLVED
    assert (its.node, its.axis, its.until) == (5, 1, None)
    assert its.time == pytest.approx(1.0005)
    assert "never reset: 7121h motor blocked" in its.text
    heard = sorted([*frames, BLOCKED], key=lambda each: each.timestamp)
    assert {heard[each - 1].arbitration_id for each in its.frames} == {0x085, 0x185}


def test_a_fault_that_is_reset_is_recovered_and_says_which_resets_failed():
    control = [(0, "0f00"), (1.2, "8000"), (1.4, "0000"), (3.0, "8000")]
    frames = drive((0, ENABLED), (1, FAULT), (3.01, OFF), end=4.0, control=control)
    its = one("drive-fault", *frames)
    assert its.severity is Severity.RECOVERED
    assert its.until == pytest.approx(3.0105)
    assert "then reset: no cause reported" in its.text
    failed = one("reset-failed", *frames)
    assert failed.text == "1 fault reset without effect"
    assert failed.time == pytest.approx(1.201)
    assert failed.severity is Severity.RECOVERED


STUCK = drive((0, ENABLED), (1, FAULT), end=3.0, control=[(0, "0f00"), (1.2, "8000")])
"""A fault whose only reset has no effect."""


def test_a_reset_to_no_avail_leaves_both_unresolved():
    assert assessed(*STUCK).counts[Severity.UNRESOLVED] == 2
    assert one("reset-failed", *STUCK).severity is Severity.UNRESOLVED


def coasting(rad):
    """Node 5 shows that it turns on by an angle within 0.2 s from 1 s."""
    counts = round(rad / 6.283185307 * 245760)
    for k in range(300):
        at = 0.01 * k
        share = min(max((at - 1.0) / 0.2, 0.0), 1.0)
        data = struct.pack("<ii", 0, -round(counts * share * (2 - share)))
        yield frame(at + 0.0006, 0x285, data.hex())


def test_a_fault_says_how_far_the_plate_coasted_by_the_scale_of_the_rig():
    phi, theta = AxisConfig(name="phi", node=5), AxisConfig(name="theta", node=2)
    frames = [*STUCK, *coasting(math.radians(3.1))]
    heard = sorted(frames, key=lambda each: each.timestamp)
    short = [each for each in heard if each.arbitration_id != 0x185]
    full = [frame(each.timestamp, 0x185, f"{each.data.hex()}03{'00' * 4}") for each in heard
            if each.arbitration_id == 0x185]  # fmt: skip
    its = one("drive-fault", *short, *full, rig=AkdConfig(axes=(phi, theta)))
    assert its.motion == "the plate coasted 3.1 deg, and stood after 180 ms"


def test_the_headline_is_the_worst_finding_and_counts_the_others():
    headline = assessed(*STUCK).headline
    assert headline.startswith("unresolved: node 5 at 1.000 s: in fault to the end of the trace")
    assert headline.endswith("(and 1 unresolved)")


BEATS = every(0.1, 0.0, 6.0, 0x705, "05")
"""Heartbeats of node 5, operational, for 6 s."""


def without(frames, begin, end=math.inf):
    return [each for each in frames if not begin < each.timestamp < end]


def test_a_node_that_is_addressed_and_never_sends_is_silent():
    asked = frame(0.5, 0x604, "4000100000000000")
    its = one("node-silent", *BEATS, asked)
    assert (its.node, its.severity, its.time) == (4, Severity.UNRESOLVED, 0.5)
    assert codes_of(*BEATS, frame(5.88, 0x604, "4000100000000000")) == []  # no time to answer
    assert codes_of(*BEATS, asked, frame(0.6, 0x584, "4f00100000000000")) == []


def test_a_scan_for_nodes_is_no_problem_of_each_of_them():
    scan = [frame(0.01 * node, 0x600 + node, "4000100000000000") for node in range(10, 60)]
    (its,) = assessed(*BEATS, *scan).findings
    assert (its.code, its.severity) == ("node-silent", Severity.WARNING)
    assert "no answer of 50 nodes" in its.text


def test_a_node_of_which_nothing_comes_is_lost_for_that_time():
    rest = every(0.1, 0.05, 6.0, 0x706, "05")
    (its,) = assessed(*without(BEATS, 2.0, 3.0), *rest).findings
    assert (its.code, its.severity, its.node) == ("node-lost", Severity.RECOVERED, 5)
    assert (its.time, its.until) == (pytest.approx(2.0), pytest.approx(3.0))
    (its,) = assessed(*without(BEATS, 3.0), *rest).findings
    assert (its.code, its.severity, its.until) == ("node-lost", Severity.UNRESOLVED, None)
    assert (
        its.text == "no frame to the end of the trace, for 2.95 s (heartbeat usually every 100 ms)"
    )


def test_heartbeats_are_lost_while_the_node_sends_something_else():
    pdos = every(0.05, 0.025, 6.0, 0x185, ENABLED)
    its = one("heartbeat-lost", *without(without(BEATS, 2.0, 3.0), 4.0, 4.5), *pdos)
    assert its.severity is Severity.RECOVERED
    assert its.text.startswith("no heartbeat 2 times, at worst for 1 s (usually every 100 ms)")
    assert len(its.frames) == 2
    assert one("heartbeat-lost", *without(BEATS, 5.0), *pdos).severity is Severity.UNRESOLVED
    assert codes_of(*BEATS, *pdos) == []


def test_who_watches_a_heartbeat_is_named_if_it_allows_less():
    watch = every(0.1, 0.05, 6.0, 0x706, "05")
    watch += [frame(0.01, 0x606, "23161001c8000500"), frame(0.02, 0x586, "6016100100000000")]
    watch += [frame(0.03, 0x606, "4016100100000000"), frame(0.04, 0x586, "43161001c8000500")]
    pdos = every(0.05, 0.025, 6.0, 0x185, ENABLED)
    text = one("heartbeat-lost", *without(BEATS, 2.0, 3.0), *pdos, *watch).text
    assert text.endswith("; node 6 allows 200 ms")


def test_a_heartbeat_that_is_late_once_is_a_warning():
    pdos = every(0.05, 0.025, 6.0, 0x185, ENABLED)
    its = one("heartbeat-late", *without(BEATS, 2.0, 2.15), *pdos)
    assert its.severity is Severity.WARNING
    assert its.text == "no heartbeat for 0.2 s (usually every 100 ms)"


def test_all_devices_lost_at_once_are_a_loss_of_the_bus():
    both = [*BEATS, *every(0.1, 0.02, 6.0, 0x706, "05")]
    both += [frame(0.03, 0x585, "4f00100000000000"), frame(0.04, 0x586, "4f00100000000000")]
    host = every(0.1, 0.05, 6.0, 0x77F, "05")
    (its,) = assessed(*without(both, 3.0), *host).findings
    assert (its.code, its.node) == ("bus-lost", 0)
    assert "no frame of node 5 and node 6 to the end" in its.text


def test_a_boot_up_in_the_middle_is_found_unless_it_was_commanded():
    boot = [*without(BEATS, 2.0, 2.25), frame(2.15, 0x705, "00")]
    (its,) = assessed(*boot).findings
    assert (its.code, its.severity) == ("boot-up", Severity.RECOVERED)
    assert its.text == (
        "booted without a command, 150 ms after its last frame; was operational, "
        "and again after 150 ms"
    )
    gone = [*without(BEATS, 2.0), frame(2.2, 0x705, "00"), *every(0.1, 2.3, 6.0, 0x705, "7f")]
    (its,) = assessed(*gone).findings
    assert (its.code, its.severity) == ("boot-up", Severity.UNRESOLVED)
    reset = frame(2.1, 0x000, "8105")
    assert codes_of(*boot, reset) == []
    assert codes_of(frame(-0.1, 0x705, "00"), *BEATS) == []  # the first frame of a node
    # one answers a reset, the next one does not
    answer = [frame(1.8, 0x000, "8105"), frame(1.85, 0x705, "00")]
    assert [each.code for each in assessed(*answer, *boot).findings] == ["boot-up"]


def test_a_drive_that_is_reset_while_it_has_torque_is_found():
    before = drive((0, ENABLED), end=2.0, control=[(0, "0f00")])
    reset = [frame(2.0, 0x000, "8105"), frame(2.1, 0x705, "00")]
    its = one("boot-up", *before, *reset)
    assert its.text.startswith("booted by a command, while it had torque, 110 ms after its last")
    before = drive((0, ENABLED), (1.5, OFF), end=2.0, control=[(0, "0f00"), (1.4, "0000")])
    assert "boot-up" not in codes_of(*before, *reset)


def test_a_node_that_leaves_operational_without_a_command_is_found():
    left = [*without(BEATS, 1.95), *every(0.1, 2.0, 6.0, 0x705, "7f")]
    (its,) = assessed(*left).findings
    assert (its.code, its.severity, its.time) == ("nmt-left", Severity.UNRESOLVED, 2.0)
    assert codes_of(*left, frame(1.97, 0x000, "8005")) == []
    back = [*without(BEATS, 1.95, 2.95), *every(0.1, 2.0, 3.0, 0x705, "7f")]
    assert one("nmt-left", *back).until == pytest.approx(3.0)


def test_a_start_without_effect_is_found():
    waits = every(0.1, 0.0, 6.0, 0x705, "7f")
    start = frame(1.0, 0x000, "0105")
    (its,) = assessed(*waits, start).findings
    assert (its.code, its.severity) == ("nmt-ignored", Severity.UNRESOLVED)
    assert its.text == "did not follow the start, is pre-operational"
    obeys = [*without(waits, 1.05), *every(0.1, 1.1, 6.0, 0x705, "05")]
    assert codes_of(*obeys, start) == []
    assert codes_of(*waits, frame(1.0, 0x000, "0106")) == ["node-silent"]


def test_sync_is_late_or_lost():
    sync = every(0.01, 0.0, 3.0, 0x080)
    its = one("sync-late", *without(sync, 1.0, 1.03), *BEATS)
    assert (its.severity, its.time) == (Severity.WARNING, pytest.approx(1.0))
    assert its.text == "SYNC late 1 time, after 30 ms at worst (usually every 10 ms)"
    its = one("sync-lost", *without(sync, 1.0, 1.5), *BEATS)
    assert (its.severity, its.until) == (Severity.RECOVERED, pytest.approx(1.5))
    assert codes_of(*sync, *BEATS) == []  # it ends while no drive has torque


def test_sync_that_ends_while_a_drive_has_torque_is_unresolved():
    frames = drive((0, ENABLED), end=2.0, control=[(0, "0f00")])
    its = one("sync-lost", *frames, *BEATS)
    assert its.severity is Severity.UNRESOLVED
    assert its.text.endswith("while a drive has torque")
    off = drive((0, ENABLED), (1.9, OFF), end=2.0, control=[(0, "0f00"), (1.89, "0000")])
    assert "sync-lost" not in codes_of(*off, *BEATS)


def test_a_pause_of_everybody_is_one_finding():
    everything = sorted([*every(0.01, 0.0, 6.0, 0x080), *BEATS], key=lambda each: each.timestamp)
    (its,) = assessed(*without(everything, 2.0, 5.0)).findings
    assert (its.code, its.severity) == ("trace-gap", Severity.WARNING)
    assert (its.time, its.until) == (pytest.approx(2.0), pytest.approx(5.0))
    assert codes_of(*everything, timed=False) == []


CYCLES = drive((0, ENABLED), (2.99, OFF), end=3.0, control=[(0, "0f00"), (2.98, "0000")])
"""SYNC every 10 ms, with each the status word and the control word, for 3 s."""


def pdos(*but, shift=0.0):
    """These frames with the status words of some SYNCs (their numbers) left out or moved."""
    kept = []
    for each in CYCLES:
        k = round((each.timestamp - 0.0005) / 0.01)
        if each.arbitration_id != 0x185 or k not in but:
            kept.append(each)
        elif shift:
            kept.append(frame(each.timestamp + shift, 0x185, each.data.hex()))
    return kept


def test_a_pdo_that_is_missing_for_its_sync_is_a_warning_several_in_a_row_a_failure():
    assert codes_of(*pdos()) == []
    (its,) = assessed(*pdos(100)).findings
    assert (its.code, its.severity, its.node) == ("pdo-missing", Severity.WARNING, 5)
    assert its.text == "TPDO1: missing for 1 of 300 SYNCs"
    assert its.time == pytest.approx(1.0)
    (its,) = assessed(*pdos(100, 101, 102, 200)).findings
    assert its.severity is Severity.RECOVERED
    assert its.text == "TPDO1: missing for 4 of 300 SYNCs, at worst for 3 in a row"


def test_a_pdo_after_the_next_sync_is_late_and_not_missing():
    (its,) = assessed(*pdos(100, shift=0.0098)).findings
    assert (its.code, its.severity) == ("pdo-late", Severity.WARNING)
    heard = sorted(pdos(100, shift=0.0098), key=lambda each: each.timestamp)
    assert [heard[each - 1].arbitration_id for each in its.frames] == [0x185]
    assert codes_of(*pdos(100, shift=0.008)) == []  # before the next SYNC
    one_after_another = pdos(*range(100, 105), shift=0.0098)  # the last catches up
    assert codes_of(*one_after_another) == ["pdo-late"]


def test_a_pdo_that_ends_is_unresolved_unless_it_was_stopped():
    gone = pdos(*range(200, 300))
    its = one("pdo-missing", *gone, *every(0.1, 0, 3, 0x705, "05"))
    assert its.severity is Severity.UNRESOLVED
    assert its.text == "TPDO1: none to the end of the trace, for 1 s"
    stop = frame(1.995, 0x000, "8005")
    assert "pdo-missing" not in codes_of(*gone, stop, *every(0.1, 0, 3, 0x705, "05"))


def test_a_pdo_that_comes_twice_has_two_senders():
    again = [frame(each.timestamp + 0.003, 0x185, each.data.hex()) for each in CYCLES
             if each.arbitration_id == 0x185 and 1 < each.timestamp < 1.1]  # fmt: skip
    (its,) = assessed(*CYCLES, *again).findings
    assert (its.code, its.severity) == ("pdo-twice", Severity.UNRESOLVED)
    assert its.text == "TPDO1: twice for 10 of 300 SYNCs"


def test_a_pdo_that_needs_no_sync_is_missing_by_its_own_rhythm():
    words = every(0.05, 0.0, 6.0, 0x185, OFF)
    beats = every(0.1, 0.02, 6.0, 0x705, "05")
    assert codes_of(*words, *beats) == []
    its = one("pdo-missing", *without(words, 2.0, 2.5), *beats)
    assert its.text == "TPDO1: none 1 time, for 0.5 s at worst (usually every 50 ms)"


def test_a_pdo_of_another_length_is_found_where_the_others_fit():
    (its,) = assessed(*pdos(100), frame(1.0005, 0x185, "3702ff")).findings
    assert (its.code, its.severity) == ("pdo-length", Severity.RECOVERED)
    assert its.time == pytest.approx(1.0005)
    long = [frame(0.01 * k, 0x185, "3702ff") for k in range(20)]
    assert "pdo-length" not in codes_of(*long)


def test_what_several_pdos_of_a_node_have_is_one_finding():
    second = [frame(each.timestamp, 0x285, each.data.hex() + "03") for each in pdos(100, 101, 102)
              if each.arbitration_id == 0x185]  # fmt: skip
    (its,) = assessed(*pdos(100, 101, 102), *second).findings
    assert its.text == "TPDO1, TPDO2: missing for 3 of 300 SYNCs, at worst for 3 in a row"


def test_a_remote_request_for_sync_is_no_sync():
    asked = [frame(1.0, 0x080, is_remote_frame=True), frame(1.1, 0x185, is_remote_frame=True)]
    assert codes_of(*CYCLES, *asked) == []


def write(at, key, value, answer="60"):
    """Four bytes are written to an object of node 5; hex, least byte first."""
    asked = frame(at, 0x605, f"23{key}{value}")
    return [asked, frame(at + 0.001, 0x585, f"{answer}{key}00000000")] if answer else [asked]


def read(at, key, value=None):
    """An object of node 5 is read; None for no answer."""
    asked = frame(at, 0x605, f"40{key}00000000")
    return [asked, frame(at + 0.001, 0x585, f"43{key}{value}")] if value else [asked]


def refuse(at, key, code="00000206", command="40"):
    """A request for an object of node 5 is aborted."""
    asked = frame(at, 0x605, f"{command}{key}00000000")
    return [asked, frame(at + 0.001, 0x585, f"80{key}{code}")]


LIMIT, MODE = "7f6000", "5a6000"
"""Maximum profile velocity (607Fh) and quick stop option (605Ah), as in a frame."""


def test_a_request_without_an_answer_is_unresolved_until_it_is_answered():
    assert codes_of(*BEATS, *read(1.0, LIMIT, "01000000")) == []
    (its,) = assessed(*BEATS, *read(1.0, LIMIT), *read(2.0, LIMIT)).findings
    assert (its.code, its.severity, its.time) == ("sdo-timeout", Severity.UNRESOLVED, 1.0)
    assert its.text == "reading 607Fh Maximum profile velocity: without an answer, 2 times"
    its = one("sdo-timeout", *BEATS, *read(1.0, LIMIT), *read(2.0, LIMIT, "01000000"))
    assert (its.severity, its.until) == (Severity.RECOVERED, 2.0)
    assert codes_of(*BEATS, *read(5.8, LIMIT)) == []  # the trace ends before it may be answered


def test_a_transfer_that_the_host_gives_up_is_without_an_answer():
    given_up = [*read(1.0, LIMIT), frame(1.5, 0x605, f"80{LIMIT}00000405")]
    (its,) = assessed(*BEATS, *given_up).findings
    assert (its.code, its.severity) == ("sdo-timeout", Severity.UNRESOLVED)


def test_a_transfer_that_the_host_aborts_is_not_refused_by_the_device():
    given_up = [*read(1.0, LIMIT), frame(1.5, 0x605, f"80{LIMIT}00000305")]
    begun = frame(1.1, 0x585, f"41{LIMIT}0f000000")
    (its,) = assessed(*BEATS, given_up[0], begun, given_up[-1]).findings
    assert (its.code, its.severity) == ("sdo-unfinished", Severity.WARNING)
    assert its.text == (
        "reading 607Fh Maximum profile velocity: given up by the host, code 05030000h, "
        "toggle bit not alternated"
    )


def test_a_refused_write_is_unresolved_and_a_refused_read_a_warning():
    (its,) = assessed(*BEATS, *refuse(1.0, LIMIT, "30000906", "23")).findings
    assert (its.code, its.severity) == ("sdo-refused", Severity.UNRESOLVED)
    assert its.text == (
        "writing 607Fh Maximum profile velocity: refused, code 06090030h, value out of range"
    )
    assert one("sdo-refused", *BEATS, *refuse(1.0, LIMIT)).severity is Severity.WARNING
    again = write(2.0, LIMIT, "01000000") + read(2.1, LIMIT, "01000000")
    refused = refuse(1.0, LIMIT, command="23")
    assert one("sdo-refused", *BEATS, *refused, *again).severity is Severity.RECOVERED


def test_an_answer_after_the_next_request_is_an_overlap():
    first, second = read(1.0, LIMIT, "01000000"), read(1.0005, MODE, "02000000")
    (its,) = assessed(*BEATS, *first, *second).findings
    assert (its.code, its.severity) == ("sdo-overlap", Severity.WARNING)
    assert its.text.startswith("reading 607Fh Maximum profile velocity: answered after the next")


def test_an_answer_to_no_request_is_found():
    stray = read(1.0, LIMIT, "01000000")[1]
    (its,) = assessed(*BEATS, *read(0.5, MODE, "02000000"), stray).findings
    assert (its.code, its.severity) == ("sdo-stray", Severity.WARNING)
    assert its.text == "1 answer that nobody asked for: 607Fh Maximum profile velocity"


def test_a_transfer_that_is_begun_and_not_finished_is_found():
    begun = [frame(1.0, 0x605, f"40{LIMIT}00000000"), frame(1.1, 0x585, f"41{LIMIT}0f000000")]
    begun += [frame(1.2, 0x605, "6000000000000000"), frame(1.3, 0x585, "0020202020202020")]
    (its,) = assessed(*BEATS, *begun, *read(2.0, MODE, "02000000")).findings
    assert (its.code, its.severity, its.time) == ("sdo-unfinished", Severity.WARNING, 1.0)
    assert its.text == "reading 607Fh Maximum profile velocity: begun, not finished"
    rest = [frame(1.4, 0x605, "7000000000000000"), frame(1.5, 0x585, "1120202020202020")]
    assert codes_of(*BEATS, *begun, *rest, *read(2.0, MODE, "02000000")) == []
    begun = [frame(1.0, 0x605, f"21{LIMIT}0f000000"), frame(1.1, 0x585, f"60{LIMIT}00000000")]
    its = one("sdo-unfinished", *BEATS, *begun, *read(2.0, MODE, "02000000"))
    assert its.severity is Severity.UNRESOLVED


def test_a_short_frame_of_a_transfer_is_read_and_found():
    short = [frame(1.0, 0x605, f"40{LIMIT}"), frame(1.001, 0x585, f"43{LIMIT}01000000")]
    (its,) = assessed(*BEATS, *short).findings
    assert (its.code, its.severity, its.frames) == ("sdo-length", Severity.WARNING, (12,))
    assert its.text == "1 SDO frame of fewer than 8 bytes"
    seen = Conversation(sorted([*BEATS, *short], key=lambda each: each.timestamp))
    assert [each.text for each in seen.events if each.kind == "SDO"] == [
        "reads 607Fh Maximum profile velocity of node 5: 1"
    ]


RAW = [
    frame(0.00, 0x080, "cafdbdfe90ffceff"),
    frame(0.01, 0x084, "f9ffcffe9affbeff"),
    frame(0.02, 0x185, "1800"),
    frame(0.03, 0x602, "a511030077000000"),
]
"""Frames of no CANopen: without its length for SYNC, and as of a request for no object."""


def test_a_bus_of_a_different_protocol_is_left_alone():
    verdict = assessed(*RAW)
    assert not verdict.findings
    assert verdict.headline.startswith("no CANopen recognised: 4 frames without network")
    seen = Conversation(RAW)
    assert (seen.nodes, seen.events, seen.series) == ({}, [], {})
    assert seen.strangers.total() == 4
    errors = frame(0.04, 0x40, "", is_error_frame=True)
    assert [each.code for each in assessed(*RAW, errors).findings] == ["bus-off"]


@pytest.mark.parametrize(
    "sign",
    [
        frame(1.0, 0x705, "05"),
        frame(1.0, 0x000, "0105"),
        frame(1.0, 0x080, "07"),
        frame(1.0, 0x605, "4000100000000000"),
    ],
    ids=["heartbeat", "network management", "SYNC with a counter", "request"],
)
def test_one_sign_of_canopen_is_enough(sign):
    assert "emergency" in codes_of(*RAW[:3], sign)


def test_emergencies_alone_are_read_if_nothing_contradicts_them():
    assert codes_of(frame(0.0, 0x085, "1023010000000000")) == ["emergency"]


def test_a_setting_that_is_read_back_otherwise_is_unresolved_until_it_is_right():
    wrong = [*write(1.0, LIMIT, "e8030000"), *read(1.1, LIMIT, "f4010000")]
    (its,) = assessed(*BEATS, *wrong).findings
    assert (its.code, its.severity, its.axis) == ("setting-differs", Severity.UNRESOLVED, 1)
    assert its.text == "607Fh Maximum profile velocity: 1000 written, 500 read"
    right = [*write(2.0, LIMIT, "e8030000"), *read(2.1, LIMIT, "e8030000")]
    assert one("setting-differs", *BEATS, *wrong, *right).severity is Severity.RECOVERED
    assert codes_of(*BEATS, *right) == []


def test_settings_that_nobody_reads_back_are_a_warning_and_commands_are_none():
    (its,) = assessed(*BEATS, *write(1.0, LIMIT, "e8030000")).findings
    assert (its.code, its.severity) == ("setting-unread", Severity.WARNING)
    assert its.text.startswith("1 setting written and never read back: 607Fh Maximum")
    assert codes_of(*BEATS, *write(1.0, "406000", "0f000000")) == []


def enabled(*words, end=4.0, control=(), mode=None, **how):
    """A drive that is enabled, with some status words later; its mode if one is displayed."""
    shown = read(0.01, "616000", f"{mode:02x}000000") if mode is not None else []
    return [*drive((0, ENABLED), *words, end=end, control=[(0, "0f00"), *control], **how), *shown]


def test_a_drive_that_leaves_operation_without_a_command_lost_its_torque():
    (its,) = assessed(*enabled((1, OFF))).findings
    assert (its.code, its.severity) == ("torque-lost", Severity.UNRESOLVED)
    assert its.text == "left operation enabled without a command, is switch on disabled"
    (its,) = assessed(*enabled((1, "1702"), (2, ENABLED))).findings
    assert (its.code, its.severity) == ("torque-lost", Severity.RECOVERED)
    assert its.text.endswith("is quick stop active")
    assert codes_of(*enabled((1, OFF), control=[(0.99, "0000")])) == []
    assert codes_of(*enabled((1, OFF)), frame(0.99, 0x000, "8005")) == []


@pytest.mark.parametrize(
    ("status", "control", "words"),
    [
        (OFF, "0f00", "enable operation without effect for 1.99 s: switch on disabled, needs shut"),
        (OFF, "0600", "shutdown without effect for 1.99 s: switch on disabled, the drive is not"),
        (READY, "0f00", "enable operation without effect for 1.99 s: ready to switch on, needs sw"),
    ],
)
def test_a_command_in_the_wrong_state_is_found(status, control, words):
    frames = drive((0, status), end=3.0, control=[(0, "0000"), (1.0, control)])
    (its,) = assessed(*frames).findings
    assert (its.code, its.severity) == ("wrong-state", Severity.UNRESOLVED)
    assert its.text.startswith(words)


def test_a_command_that_is_followed_late_is_recovered_and_soon_is_nothing():
    def frames(at):
        return drive((0, ON), (at, ENABLED), end=6.0, control=[(0, "0700"), (1.0, "0f00")])

    assert codes_of(*frames(1.5)) == []
    later = drive((0, ON), (4, ENABLED), end=6.0,
                  control=[(0, "0700"), (1, "0f00"), (3, "0700"), (3.9, "0f00")])  # fmt: skip
    assert one("wrong-state", *later).severity is Severity.RECOVERED


def test_a_mode_that_is_not_the_given_one_is_found():
    given = write(0.02, "606000", "03000000")
    assert codes_of(*enabled(mode=3), *given) == []
    (its,) = assessed(*enabled(mode=3), *given, *read(1.0, "616000", "01000000")).findings
    assert (its.code, its.severity) == ("mode-differs", Severity.UNRESOLVED)
    assert its.text.startswith("is in profile position for 2.99 s, given is profile velocity")
    other, back = read(1.5, "616000", "01000000"), read(1.6, "616000", "03000000")
    its = one("mode-differs", *enabled(mode=3), *given, *other, *back)
    assert its.severity is Severity.RECOVERED


@pytest.mark.parametrize(
    ("mode", "word", "code", "severity"),
    [
        (None, "370a", "limit-active", Severity.WARNING),
        (None, "b702", "drive-warning", Severity.WARNING),
        (None, "2702", "no-voltage", Severity.UNRESOLVED),
        (None, "3700", "not-remote", Severity.UNRESOLVED),
        (1, "3722", "following-error", Severity.UNRESOLVED),
        (8, "3722", "following-error", Severity.UNRESOLVED),
        (3, "3722", "slippage", Severity.UNRESOLVED),
        (6, "3722", "homing-error", Severity.UNRESOLVED),
    ],
)
def test_what_a_bit_of_the_status_word_warns_of_is_found_by_the_mode(mode, word, code, severity):
    (its,) = assessed(*enabled((1, word), mode=mode)).findings
    assert (its.code, its.severity) == (code, severity)
    assert its.text.endswith("for 2.99 s")
    other = 9 if mode else None  # bit 13 is reserved there
    assert codes_of(*enabled((1, word), mode=other)) == ([] if mode else [code])
    assert codes_of(*enabled((1, OFF), (1.5, word[:1] + "1" + word[2:]), control=[(0.99, "0000")],
                          mode=mode)) == []  # fmt: skip


def test_a_following_error_beyond_the_window_of_the_drive_is_found():
    window = [*write(0.02, "656000", "64000000"), *read(0.03, "656000", "64000000")]
    mapping = [*write(0.04, "001a01", "2000f460"), *read(0.05, "001a01", "2000f460")]
    mapping += [*write(0.06, "001a00", "01000000"), *read(0.07, "001a00", "01000000")]
    beats = every(0.1, 0.0, 4.0, 0x705, "05")
    # node 5 is a drive, as its status word is read once
    status = read(0.08, "416000", "37020000")

    def errors(*counts):
        return [frame(1.0 + 0.1 * k, 0x185, struct.pack("<i", each).hex())
                for k, each in enumerate(counts)]  # fmt: skip

    setup = [*window, *mapping, *beats, *status]
    assert codes_of(*setup, *errors(5, -100, 100)) == []
    (its,) = assessed(*setup, *errors(5, -101, 3)).findings
    assert (its.code, its.severity) == ("following-error", Severity.RECOVERED)
    assert its.text == "following error up to 101, its window is 100"
    assert one("following-error", *setup, *errors(5, -101)).severity is Severity.UNRESOLVED


def test_without_times_nothing_is_late_and_faults_are_found():
    heard = [*enabled((1, FAULT), (2, ENABLED)), *without(BEATS, 1.0, 2.0)]
    heard.sort(key=lambda each: each.timestamp)
    numbered = [
        frame(float(number), each.arbitration_id, each.data.hex())
        for number, each in enumerate(heard)
    ]
    verdict = assessed(*numbered, timed=False)
    assert [each.code for each in verdict.findings] == ["drive-fault"]
    assert verdict.headline.startswith("recovered: node 5 in frame 3")
    assert "in fault for 3" in verdict.headline
    assert "frames, then left without a reset" in verdict.headline


def test_a_cyclic_mode_that_does_not_follow_is_found_unless_it_never_did():
    follows = (0.5, "3712")
    (its,) = assessed(*enabled(follows, (1, ENABLED), mode=8)).findings
    assert (its.code, its.severity) == ("not-following", Severity.UNRESOLVED)
    assert codes_of(*enabled(follows, (1, ENABLED), (1.05, "3712"), mode=8)) == []
    assert codes_of(*enabled(mode=8)) == []


NEW = [(1.0, "1f00"), (1.1, "0f00")]
"""A new set-point, by the control word."""


def test_a_set_point_that_is_not_acknowledged_or_not_reached_is_found():
    reached = [(1.02, "3712"), (1.12, ENABLED), (2.0, "3706")]
    assert codes_of(*enabled(*reached, mode=1, control=NEW)) == []
    assert codes_of(*enabled(*reached[:2], mode=1, control=NEW)) == ["target-missed"]
    assert codes_of(*enabled(mode=1, control=NEW)) == ["setpoint-ignored"]
    assert codes_of(*enabled(mode=3, control=NEW)) == []


def test_homing_that_is_not_attained_is_found():
    started = [(1.0, "1f00")]
    assert codes_of(*enabled((2, "3712"), mode=6, control=started)) == []
    (its,) = assessed(*enabled(mode=6, control=started)).findings
    assert (its.code, its.text) == ("target-missed", "homing is not attained within 2.99 s")


HOT, CLEAR = frame(1.0, 0x085, "1043080000000000"), frame(2.0, 0x085, "0000000000000000")


def test_an_emergency_is_unresolved_until_it_is_cleared_or_the_drive_works_on():
    (its,) = assessed(*BEATS, HOT).findings
    assert (its.code, its.severity) == ("emergency", Severity.UNRESOLVED)
    assert its.text == "emergency 4310h drive temperature too high"
    assert "cooling blocked" in its.causes
    (its,) = assessed(*BEATS, HOT, CLEAR).findings
    assert (its.severity, its.until) == (Severity.RECOVERED, 2.0)
    (its,) = assessed(*enabled(), HOT).findings
    assert its.severity is Severity.WARNING
    assert codes_of(*BEATS, CLEAR) == []


def test_an_emergency_of_a_fault_is_part_of_it():
    assert codes_of(*STUCK, BLOCKED) == ["drive-fault", "reset-failed"]


def error(at, classes, data="0000000000000000"):
    return frame(at, classes, data, is_error_frame=True)


def test_bus_off_is_unresolved_until_a_device_is_heard_again():
    answer = frame(0.01, 0x585, "4f00100000000000")
    beats = [*BEATS, answer]
    its = one("bus-off", *without(beats, 3.0), error(3.05, 0x40))
    assert (its.severity, its.time) == (Severity.UNRESOLVED, 3.05)
    assert one("bus-off", *beats, error(3.05, 0x40)).severity is Severity.RECOVERED


def test_other_error_frames_are_one_warning_with_their_kinds():
    (its,) = assessed(*BEATS, error(1.0, 0x80), error(1.1, 0x80), error(1.2, 0x20)).findings
    assert (its.code, its.severity) == ("error-frames", Severity.WARNING)
    assert its.text == "3 error frames: 2 bus error, 1 no acknowledge"
    assert len(its.frames) == 3


def sent(*frames):
    """The same frames, marked as sent by the recorder's own host."""
    for each in frames:
        each.is_rx = False
    return list(frames)


def test_a_frame_of_the_host_that_somebody_else_sends_means_two_hosts():
    own = sent(*every(0.01, 0.0, 3.0, 0x080))
    assert codes_of(*own, *BEATS) == []
    (its,) = assessed(*own, *BEATS, frame(1.5005, 0x080)).findings
    assert (its.code, its.severity, its.node) == ("two-hosts", Severity.UNRESOLVED, 0)
    assert its.time == 1.5005
    echoed = every(0.01, 0.001, 3.0, 0x080)  # the adapter hands back what it sends
    assert codes_of(*own, *echoed, *BEATS) == []
    (its,) = assessed(*own, *echoed, *BEATS, frame(1.5005, 0x080)).findings
    assert (its.code, its.time) == ("two-hosts", pytest.approx(1.5005, abs=0.001))
    heard = sorted([*own, *echoed, *BEATS], key=lambda each: each.timestamp)
    conversation = Conversation(heard)
    assert list_remarks(conversation) == ["left out: 300 frames that the adapter handed back"]
    assert len(conversation.sync) == 300


def test_sync_of_two_senders_is_seen_without_directions():
    one_of_them, other = every(0.01, 0.0, 3.0, 0x080), every(0.01, 0.0015, 3.0, 0x080)
    assert codes_of(*one_of_them, *other, *BEATS) == ["two-hosts"]
    late = [each for each in other if each.timestamp > 2.0]
    (its,) = assessed(*one_of_them, *late, *BEATS).findings
    assert (its.code, its.text) == ("two-hosts", "SYNC of two senders")
    assert its.time == pytest.approx(2.0, abs=0.011)


def test_a_control_word_that_comes_twice_for_a_sync_means_two_hosts():
    other = [frame(each.timestamp + 0.003, 0x205, "0000") for each in CYCLES
             if each.arbitration_id == 0x205 and 1 < each.timestamp < 1.1]  # fmt: skip
    assert "two-hosts" in codes_of(*CYCLES, *other)


def test_two_devices_with_a_number_are_seen_by_heartbeats_and_by_answers():
    other = every(0.1, 2.037, 6.0, 0x705, "05")
    (its,) = assessed(*BEATS, *other).findings
    assert (its.code, its.severity, its.node) == ("node-twice", Severity.UNRESOLVED, 5)
    asked = read(1.0, LIMIT, "01000000")
    second = frame(1.002, 0x585, f"43{LIMIT}02000000")
    (its,) = assessed(*BEATS, *asked, second).findings
    assert (its.code, its.text) == ("node-twice", "1 request answered twice")


def test_a_full_bus_is_a_warning_where_its_bit_rate_is_known():
    phi, theta = AxisConfig(name="phi", node=1), AxisConfig(name="theta", node=2)
    slow = AkdConfig(axes=(phi, theta), bus=BusConfig(bitrate=125_000), period=0.01)
    full = every(0.0011, 0.0, 1.0, 0x7F1, "0000000000000000")  # 135 bits each, stuffed
    its = one("bus-load", *full, rig=slow)
    assert its.severity is Severity.WARNING
    # 91 frames of 47 + 64 + 24 bits in the busiest 0.1 s
    assert its.text.startswith(f"up to {100 * 91 * 135 / 0.1 / 125_000:.0f} % of 125000 bit/s")
    half = every(0.0022, 0.0, 1.0, 0x7F1, "0000000000000000")
    assert codes_of(*half, rig=slow) == []
    assert codes_of(*full) == []  # the bit rate is not known


def guarded(*lost, stuck=()):
    """A node that is guarded every 0.1 s; requests without an answer, answers without a toggle."""
    toggle, frames = 0, []
    for k in range(60):
        frames.append(frame(0.1 * k, 0x705, is_remote_frame=True))
        if k in lost:
            continue
        frames.append(frame(0.1 * k + 0.001, 0x705, f"{toggle | 5:02x}"))
        toggle ^= 0 if k in stuck else 0x80
    return frames


def test_a_guard_request_without_an_answer_is_found():
    assert codes_of(*guarded()) == []
    its = one("guard-unanswered", *guarded(30))
    assert (its.severity, its.until) == (Severity.RECOVERED, pytest.approx(3.1))
    assert its.text == "1 of 60 guard requests without an answer"
    assert one("guard-unanswered", *guarded(*range(30, 60))).severity is Severity.UNRESOLVED


def test_a_guarded_node_that_nobody_asks_is_not_lost():
    """CiA 301: a guarded node answers remote requests, and sends nothing by itself."""
    asked = guarded()
    others = every(0.02, 0.0, 8.0, 0x707, "05")
    assert codes_of(*without(asked, 2.05, 4.05), *others) == []
    assert codes_of(*without(asked, 3.05), *others) == []
    told = Conversation(sorted([*asked, *others], key=lambda each: each.timestamp))
    assert told.nodes[5].frames == {"guard answer": 60}
    assert told.nodes[5].states == ["operational"]
    assert "heartbeat of node 5" not in summarise(told)["regular"]
    beats = [each for each in asked if not each.is_remote_frame]
    assert one("node-lost", *without(beats, 3.05), *others).node == 5


def test_a_toggle_bit_that_does_not_alternate_is_a_warning():
    (its,) = assessed(*guarded(stuck=[30])).findings
    assert (its.code, its.severity) == ("guard-toggle", Severity.WARNING)
    assert its.time == pytest.approx(3.101)


def test_a_clock_that_was_set_back_is_a_warning(tmp_path, capsys):
    lines = [f"({10 + 0.1 * k - (5 if k > 30 else 0):.6f}) can0 705#05" for k in range(60)]
    (tmp_path / "a.log").write_text("\n".join(lines))
    shown = json.loads(called(capsys, "trace", tmp_path / "a.log", "--json")[1])
    codes = [each["code"] for each in shown["findings"]]
    assert codes == ["time-back"]
    assert shown["findings"][0]["text"].startswith("time goes back")


@pytest.mark.parametrize(("status", "code"), [(FAULT, 1), (ENABLED, 0)])
def test_check_ends_with_1_if_a_problem_is_unresolved(tmp_path, capsys, status, code):
    with closing(TraceWriter(tmp_path / "a.log", "can0")) as writer:
        writer.write(drive((0, ENABLED), (1, status), end=2.0, control=[(0, "0f00")]))
    file = tmp_path / "a.log"
    assert called(capsys, "trace", file, "--check")[0] == code
    ended, out, _ = called(capsys, "trace", file, "--check", "--json")
    assert ended == code
    shown = json.loads(out)
    assert shown["verdict"]["unresolved"] == code
    assert [each["code"] for each in shown["findings"]] == ["drive-fault"] * code
    assert called(capsys, "trace", file)[0] == 0


def test_check_ends_with_1_if_no_node_is_heard(tmp_path, capsys):
    with closing(TraceWriter(tmp_path / "a.log", "can0")) as writer:
        writer.write([each for each in HEALTHY if each.arbitration_id == 0x80])
    assert called(capsys, "trace", tmp_path / "a.log")[0] == 0
    code, out, _ = called(capsys, "trace", tmp_path / "a.log", "--check")
    assert code == 1
    assert "no CANopen node heard" in out


def test_what_happened_comes_first_then_each_problem_and_tables_only_by_all(tmp_path, capsys):
    with closing(TraceWriter(tmp_path / "a.log", "can0")) as writer:
        writer.write(sorted([*STUCK, BLOCKED], key=lambda each: each.timestamp))
    _, out, _ = called(capsys, "trace", tmp_path / "a.log")
    lines = out.splitlines()
    assert lines[0].startswith("unresolved: node 5 at 1.000 s: in fault to the end")
    assert lines[1].endswith("frames on can0 in 2.991 s; 2 unresolved")
    assert lines[3].startswith(" 1. unresolved  drive-fault  1.000 s  node 5: in fault")
    assert "the axis is blocked" in lines[4]
    assert lines[5].startswith("      check ")
    assert lines[6].startswith("      frames  ")
    assert "operation enabled" not in out
    assert "operation enabled" in called(capsys, "trace", tmp_path / "a.log", "--all")[1]


@pytest.mark.parametrize(
    ("frames", "style"),
    [
        (drive((0, FAULT), end=1.0), "bold red"),
        (HEALTHY, "bold green"),
        ([each for each in HEALTHY if each.arbitration_id == 0x80], "bold yellow"),
    ],
)
def test_the_colour_of_the_first_line_is_that_of_the_worst(frames, style):
    first = next(iter(verdict_lines(assessed(*frames), "a trace", timed=True)))
    assert first.style == style


def test_the_load_of_the_bus_needs_its_bit_rate(tmp_path, capsys):
    full = every(0.0011, 0.0, 1.0, 0x7F1, "0000000000000000")
    with closing(TraceWriter(tmp_path / "a.log", "can0")) as writer:
        writer.write(full)
    for more, codes in (("--bitrate=125000", ["bus-load"]), ("--bitrate=500000", [])):
        shown = json.loads(called(capsys, "trace", tmp_path / "a.log", more, "--json")[1])
        assert [each["code"] for each in shown["findings"]] == codes
        assert shown["verdict"]["bus_load"] == pytest.approx(91 * 135 / 0.1)


def test_check_does_not_go_with_replay(tmp_path, capsys):
    with closing(TraceWriter(tmp_path / "a.log", "can0")) as writer:
        writer.write(HEALTHY)
    code, _, err = called(capsys, "trace", tmp_path / "a.log", "--check", "--replay")
    assert code == 2
    assert "--check: not allowed with --replay" in err
