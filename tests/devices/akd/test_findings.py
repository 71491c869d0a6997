"""`twin.devices.akd.findings`.

What is wrong in a trace is found where it is, and nowhere else: frames by CiA 301 and CiA 402."""

import json
import math
import struct
from contextlib import closing

import can
import pytest
from command_line import called

from twin.cli.trace_report import verdict_lines
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.findings import Severity, assess, kinds
from twin.devices.akd.traces import TraceWriter

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


def found(*frames, **how):
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
    assert verdict.headline.startswith("nothing wrong: 1 node for 1.99 s")


def test_every_code_has_causes_and_a_first_check():
    for code, kind in kinds().items():
        assert kind.causes, code
        assert kind.check, code


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
    assert its.motion == "the plate coasted 3.1 deg, and stood after 0.18 s"


def test_the_headline_is_the_worst_finding_and_counts_the_others():
    headline = assessed(*STUCK).headline
    assert headline.startswith("unresolved: node 5 at 1.000 s: in fault to the end of the trace")
    assert headline.endswith("(and 1 unresolved)")


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
    ("frames", "style"), [(drive((0, FAULT), end=1.0), "bold red"), (HEALTHY, "bold green")]
)
def test_the_colour_of_the_first_line_is_that_of_the_worst(frames, style):
    first = next(iter(verdict_lines(assessed(*frames), "a trace", timed=True)))
    assert first.style == style


def test_check_does_not_go_with_replay(tmp_path, capsys):
    with closing(TraceWriter(tmp_path / "a.log", "can0")) as writer:
        writer.write(HEALTHY)
    code, _, err = called(capsys, "trace", tmp_path / "a.log", "--check", "--replay")
    assert code == 2
    assert "--check: not with --replay" in err
