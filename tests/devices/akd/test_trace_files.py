"""`twin.devices.akd.trace_files`.

One conversation in the form of every program: the same frames come back, to its times."""

import gc
import gzip
import json
import re
import struct
import sys
from datetime import UTC, datetime
from itertools import pairwise

import can
import pytest
from command_line import called
from trace_dialects import (
    DIALECTS,
    SLL,
    SLL2,
    asc,
    busmaster,
    candump_log,
    candump_terminal,
    hexadecimal,
    identifier,
    packet,
    pcap,
    pcapng,
    trc,
    write_dialect,
)

from twin.base.errors import LogError
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.recording import TraceWriter
from twin.devices.akd.traces import read_trace

BEGIN = 1_700_000_000.0


def frame(at, identifier, data="", *, sent=False, **more):
    return can.Message(
        timestamp=BEGIN + at,
        arbitration_id=identifier,
        is_extended_id=more.pop("is_extended_id", False),
        data=bytes.fromhex(data),
        is_rx=not sent,
        channel="can0",
        **more,
    )


HEARD = [
    frame(0.0, 0x000, "0105", sent=True),
    frame(0.01025, 0x705, "05"),
    *(frame(0.02 + 0.002 * k + 1e-4 * (k % 3), 0x185, f"3702{k:02x}1000ff") for k in range(40)),
    frame(0.13, 0x605, "4018100100000000", sent=True),
    frame(0.1325, 0x585, "431810016a000000"),
    frame(0.15, 0x080, "", sent=True),
    frame(0.16, 0x1ABCDE, "0102", is_extended_id=True),
    frame(0.2, 0x705, "7f"),
]


UNDIRECTED = re.compile(
    r"candump(?!.* -x)|\.trc 1\.0|SavvyCAN, older|pcap|python-can \.(csv|db)|Saleae|slcan"
)
"""Formats that do not state whether a frame was sent or received."""


def passed(each):
    return each.timestamp - BEGIN


def write_trace(tmp_path, name, frames=HEARD):
    return write_dialect(DIALECTS[name], tmp_path, frames)


@pytest.mark.parametrize("name", [each for each in DIALECTS if not each.endswith(".mf4")])
def test_every_form_gives_the_same_frames(tmp_path, name):
    found = read_trace(write_trace(tmp_path, name))
    assert [each.arbitration_id for each in found.frames] == [x.arbitration_id for x in HEARD]
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD]
    assert [each.is_extended_id for each in found.frames] == [x.is_extended_id for x in HEARD]
    directed = not UNDIRECTED.match(name)
    assert [each.is_rx for each in found.frames] == [x.is_rx or not directed for x in HEARD]
    if found.timed:
        begin = found.frames[0].timestamp
        times = [each.timestamp - begin for each in found.frames]
        near = 1.1 * DIALECTS[name].resolution + 1e-6
        assert times == pytest.approx([passed(each) for each in HEARD], abs=near)


def test_an_error_in_a_table_of_saleae_is_on_the_channel_of_its_frames(tmp_path):
    file = write_trace(tmp_path, "Saleae")
    with file.open("a") as text:
        text.write('"CAN","can_error",9.0,1e-05,,,,,,\n')
    found = read_trace(file)
    assert [each.is_error_frame for each in found.frames] == [*(False for _ in HEARD), True]
    assert not any("others" in each for each in found.remarks)


@pytest.mark.parametrize(
    ("kind", "place"), [("identifier_field", 8), ("control_field", 9), ("data_field", 6)]
)
def test_a_bad_row_in_a_table_of_saleae_costs_its_own_frame(tmp_path, kind, place):
    file = write_trace(tmp_path, "Saleae")
    rows = file.read_text().splitlines()
    k = next(i for i, row in enumerate(rows) if kind in row)
    cells = rows[k].split(",")
    rows[k] = ",".join([*cells[:place], "?", *cells[place + 1 :]])
    file.write_text("\n".join(rows) + "\n")
    found = read_trace(file)
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD[1:]]
    assert "left out: 1 line" in found.remarks[0]


@pytest.mark.parametrize("form", ["candump -L", ".asc", ".trc 1.1", "SavvyCAN", "BUSMASTER"])
def test_a_line_at_fault_costs_itself(tmp_path, form):
    file = write_trace(tmp_path, form)
    text = file.read_text()
    whole = text.splitlines()
    k = next(i for i, line in enumerate(whole) if "37" in line and "02" in line)
    bad = whole[k].replace("02", "0?", 1).replace("37", "3z", 1)
    file.write_text("\n".join([*whole[:k], bad, *whole[k + 1 :]]) + "\n")
    found = read_trace(file)
    assert len(found.frames) == len(HEARD) - 1
    assert len(found.remarks) == 1
    assert "left out: 1 line without a classic frame of" in found.remarks[0]


def test_a_terminal_without_times_numbers_the_frames(tmp_path):
    (tmp_path / "a.log").write_text(candump_terminal()(HEARD))
    found = read_trace(tmp_path / "a.log")
    assert not found.timed
    assert [each.timestamp for each in found.frames] == list(range(len(HEARD)))
    assert found.remarks == ["a.log: has no times: frames are numbered in their place"]


def test_without_times_every_place_is_the_number_of_a_frame_from_1(tmp_path, capsys):
    lines = ["701#00", "701#7F", "701#7F", "081#2173200000000000", "701#7F"]
    (tmp_path / "a.log").write_text("".join(f"can0 {line}\n" for line in lines))
    _, out, _ = called(capsys, "trace", str(tmp_path / "a.log"), "--all", "--json")
    found = json.loads(out)
    (fault,) = found["nodes"]["1"]["faults"]
    assert fault["time"] == 4
    assert "in frame 4:" in found["verdict"]["headline"]
    shown = " ".join(called(capsys, "trace", str(tmp_path / "a.log"), "--all")[1].split())
    assert "4.000 s" not in shown
    assert "frame 4 7321h" in shown


def test_without_times_none_is_told(tmp_path, capsys):
    (tmp_path / "a.log").write_text(candump_terminal()(HEARD))
    _, out, _ = called(capsys, "trace", str(tmp_path / "a.log"))
    assert f"{len(HEARD)} frames on can0, without times" in " ".join(out.split())
    assert "time [s]" not in out
    code, _, err = called(capsys, "trace", str(tmp_path / "a.log"), "--replay")
    assert code == 2
    assert "has no times" in err


def test_differences_of_time_that_are_all_the_same_are_added_up(tmp_path):
    even = [frame(0.002 * k, 0x185, f"3702{k:02x}") for k in range(30)]
    (tmp_path / "a.log").write_text(candump_terminal("d")(even))
    found = read_trace(tmp_path / "a.log").frames
    assert found[-1].timestamp - found[0].timestamp == pytest.approx(0.058)


def test_parts_of_a_second_may_lack_their_zeros(tmp_path):
    text = busmaster()(HEARD)
    bare = re.sub(r"(\d\d:\d\d:\d\d:)0*(\d+)", r"\1\2", text)
    assert bare != text
    (tmp_path / "a.log").write_text(bare)
    found = read_trace(tmp_path / "a.log")
    assert not found.remarks
    begin = found.frames[0].timestamp
    times = [each.timestamp - begin for each in found.frames]
    assert times == pytest.approx([passed(each) for each in HEARD], abs=2e-4)


ERRORS = "(1.0) can0 20000040#0000000000000000\n(1.1) can0 20000088#0000000000000000\n"
ERRORS += "(1.2) can0 20000004#0010000000000000\n(1.3) can0 701#05\n"


def test_error_frames_of_candump_are_told(tmp_path, capsys):
    (tmp_path / "a.log").write_text(ERRORS)
    found = read_trace(tmp_path / "a.log")
    assert not found.remarks
    told = Conversation(found.frames)
    assert [each.text for each in told.events if each.kind == "bus"] == [
        "error frame: bus off",
        "error frame: protocol violated, bus error",
        "error frame: controller, receive errors: passive",
    ]
    assert not told.strangers
    _, out, _ = called(capsys, "trace", str(tmp_path / "a.log"), "--all")
    assert "3 error frames" in " ".join(out.split())


def test_error_frames_on_a_terminal_are_told(tmp_path):
    text = " (1.0)  can0  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME\n\tbus-off\n"
    text += " (1.1)  can0  123   [2]  remote request\n (1.2)  can0  701   [1]  05   '.'\n"
    (tmp_path / "a.log").write_text(text)
    found = read_trace(tmp_path / "a.log")
    assert not found.remarks
    assert [each.is_remote_frame for each in found.frames] == [False, True, False]
    told = Conversation(found.frames)
    assert told.errors == {"bus off": 1}
    assert told.nodes[1].states == ["operational"]


def test_the_class_of_an_error_frame_is_kept_in_a_trace_of_ours(tmp_path):
    writer = TraceWriter(tmp_path / "a.log", "can0")
    error = frame(0.1, 0x040, "0000000000000000", is_error_frame=True)
    writer.write([HEARD[0], error, HEARD[-1]])
    writer.close()
    found = read_trace(tmp_path / "a.log")
    assert [each.is_error_frame for each in found.frames] == [False, True, False]
    assert Conversation(found.frames).errors == {"bus off": 1}


@pytest.mark.parametrize(
    ("version", "row", "words"),
    [
        ("1.1", "  9) 12.5 Error 0008 4 00 19 08 08", "bus error"),
        ("1.1", "  9) 12.5 Warng FFFFFFFF 4 00 00 00 10 BUSOFF", "bus off"),
        ("1.1", "  9) 12.5 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY", "controller"),
        ("1.0", "  9) 12 FFFFFFFF 4 00 00 00 10 BUSOFF", "bus off"),
        ("1.0", "  9) 12 0008 4 ERROR 00 19 08 08", "bus error"),
        ("1.3", "  9) 12.5 1 Error 0008 - 4 00 19 08 08", "bus error"),
        ("2.0", "  9 12.5 ER - Rx 4 00 19 08 08", "bus error"),
        ("2.0", "  9 12.5 ST - Rx 4 00 00 00 10", "bus off"),
        ("2.0", "  9 12.5 ER          Rx    04 00 02 00 00", "bus error"),
        ("2.0", "  9 12.5 ST          Rx    00 00 00 10", "bus off"),
        ("2.1", "  9 12.5 ER 1         - Rx -  5    04 00 02 00 00", "bus error"),
    ],
)
def test_rows_of_errors_of_pcan_are_told(tmp_path, version, row, words):
    (tmp_path / "a.trc").write_text(trc(version)(HEARD) + row + "\n")
    told = Conversation(read_trace(tmp_path / "a.trc").frames)
    assert told.errors == {words: 1}


def test_an_error_frame_of_asc_is_told(tmp_path):
    (tmp_path / "a.asc").write_text(asc()(HEARD) + "   0.300000 1  ErrorFrame\n")
    assert sum(Conversation(read_trace(tmp_path / "a.asc").frames).errors.values()) == 1


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ("error active", []),
        ("error passive - TxErr: 132 RxErr: 0", ["controller"]),
        ("busoff", ["bus off"]),
        ("bus off - TxErr: 248 RxErr: 0", ["bus off"]),
    ],
)
def test_the_state_of_the_controller_in_asc_is_an_event(tmp_path, state, words):
    line = f"   0.300000 CAN 1 Status:chip status {state}\n"
    (tmp_path / "a.asc").write_text(asc()(HEARD).replace("End", line + "End"))
    assert [*Conversation(read_trace(tmp_path / "a.asc").frames).errors] == words


ASC = "date Tue Nov 14 10:13:20 pm 2023\nbase hex  timestamps absolute\n"
ASC_TAIL = "  Length = 240000 BitCount = 124 ID = 1794"


def kinds(file):
    """What a trace has of each frame, and its remarks."""
    found = read_trace(file)
    every = [
        (each.arbitration_id, each.is_remote_frame, each.dlc, each.is_rx) for each in found.frames
    ]
    return every, found.remarks


@pytest.mark.parametrize(
    ("row", "length"),
    [("r", 0), ("r 1", 1), (f"r 1{ASC_TAIL}", 1), (f"r{ASC_TAIL}", 0), (f"r 8{ASC_TAIL}", 8)],
)
def test_remote_frames_of_asc_are_read_with_and_without_length(tmp_path, row, length):
    (tmp_path / "a.asc").write_text(
        f"{ASC}// 1 Rx in a remark\n 0.1 1  702  Tx   {row}\n 0.2 1  702  Rx   d 1 85{ASC_TAIL}\n"
    )
    found = [(0x702, True, length, False), (0x702, False, 1, True)]
    assert kinds(tmp_path / "a.asc") == (found, [])


def test_a_request_to_send_in_asc_is_no_frame(tmp_path):
    line = " {} CANFD   1 {:4} 701    0 0 1  1 05   130000  130        0 a1234567 0 0 0 0\n"
    rows = [line.format(0.1, "TxRq"), line.format(0.2, "Tx"), line.format(0.3, "Rx")]
    (tmp_path / "a.asc").write_text(ASC + "".join(rows))
    found = [(0x701, False, 1, False), (0x701, False, 1, True)]
    assert kinds(tmp_path / "a.asc") == (found, [])


@pytest.mark.parametrize("link", [SLL, SLL2])
def test_a_capture_of_any_device_shows_who_sent_a_frame(tmp_path, link):
    one, other = HEARD[:2]
    content = pcap("<", link=link)([one, other])
    place = 24 + 16 + (1 if link == SLL else 10)
    content = content[:place] + b"\x04" + content[place + 1 :]
    (tmp_path / "a.pcap").write_bytes(content)
    assert [each.is_rx for each in read_trace(tmp_path / "a.pcap").frames] == [False, True]


def test_what_python_can_prints_is_read_with_the_kind_of_each_frame(tmp_path):
    more = [
        frame(0.3, 0x705, is_remote_frame=True, dlc=1, sent=True),
        frame(0.4, 0x80, "00" * 8, is_error_frame=True, is_extended_id=True),
    ]
    long = can.Message(timestamp=BEGIN + 1, arbitration_id=5, is_fd=True, data=bytes(12))
    printed = [f"{each}\n" for each in (*HEARD, *more, long)]
    (tmp_path / "a.log").write_text("".join(printed))
    found = read_trace(tmp_path / "a.log")
    assert found.remarks == [
        "a.log: left out: 1 line without a classic frame of python-can's print"
    ]
    for each, known in zip(found.frames, [*HEARD, *more], strict=True):
        assert each.timestamp == known.timestamp
        assert each.arbitration_id == known.arbitration_id
        assert bytes(each.data) == bytes(known.data)
        assert each.is_extended_id == known.is_extended_id
        assert each.is_remote_frame == known.is_remote_frame
        assert each.is_error_frame == known.is_error_frame
        assert (each.is_rx, each.dlc) == (known.is_rx, known.dlc)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("t7011 05", None),
        ("t701105", (0x701, False, 1, True)),
        ("t701105EA5F", (0x701, False, 1, True)),
        ("r7021", (0x702, True, 1, True)),
        ("T18FEF10020102", (0x18FEF100, False, 2, True)),
        ("t8011FF", None),
        ("t70110512", None),
        ("t7019" + "00" * 9, None),
    ],
)
def test_lines_of_a_serial_adapter(tmp_path, line, found):
    (tmp_path / "a.txt").write_text(f"t0802AABB\rz\r{line}\rZ\r\a\n")
    every, remarks = kinds(tmp_path / "a.txt")
    assert every[1:] == ([found] if found else [])
    assert ("left out: 1 line" in "".join(remarks)) is (found is None)


def test_the_clock_of_a_serial_adapter_begins_anew_each_minute(tmp_path):
    (tmp_path / "a.txt").write_text("t0800EA00\nt0800EA50\nt080000A0\n")
    times = [each.timestamp for each in read_trace(tmp_path / "a.txt").frames]
    assert times == pytest.approx([0.0, 0.08, 0.256])


@pytest.mark.parametrize(
    ("time", "seconds"),
    [("22231683", 8551.683), ("01T022231683", 8551.683), ("20170102T022231683", 1483323751.683)],
)
def test_times_of_a_logger_are_days_and_not_microseconds(tmp_path, time, seconds):
    (tmp_path / "a.txt").write_text(
        f"# Logger type: CL2000\nTimestamp;Type;ID;Data\n{time};9;18fef100;0102\n{time};0;701;05\n"
    )
    found = read_trace(tmp_path / "a.txt").frames
    assert [each.timestamp for each in found] == pytest.approx([seconds] * 2, abs=1e-3)
    assert [(each.is_extended_id, each.is_rx) for each in found] == [(True, False), (False, True)]


def test_lines_without_a_time_are_left_out_where_others_have_one(tmp_path):
    text = candump_log()(HEARD)
    (tmp_path / "a.log").write_text(text + "can0 701#05\n701#05\n")
    found = read_trace(tmp_path / "a.log")
    assert found.timed
    assert len(found.frames) == len(HEARD)
    assert found.remarks[0].startswith("a.log: left out: 2 lines")


def test_flags_of_kvaser_are_read(tmp_path):
    text = "Time,Channel,ID,Flags,DLC,Data0,Data1,Data2,Data3,Data4,Data5,Data6,Data7,Counter\n"
    text += "0.1,1,1797,2,1,5,,,,,,,,1\n0.2,1,385,4,1,255,,,,,,,,2\n"
    text += "0.3,1,386,3,2,,,,,,,,,3\n0.4,1,0,32,0,,,,,,,,,4\n"
    (tmp_path / "a.csv").write_text(text)
    found = read_trace(tmp_path / "a.csv")
    assert not found.remarks
    assert [each.arbitration_id for each in found.frames] == [0x705, 0x181, 0x182, 0]
    assert [each.is_extended_id for each in found.frames] == [False, True, False, False]
    assert [each.is_remote_frame for each in found.frames] == [False, False, True, False]
    assert [each.is_error_frame for each in found.frames] == [False, False, False, True]


@pytest.mark.parametrize("name", ["candump -L", "candump -td"])
def test_frames_that_candump_dropped_are_reported(tmp_path, name):
    file = write_trace(tmp_path, name)
    line = "DROPCOUNT: dropped {} CAN frame{} on 'can0' socket (total drops {})\n"
    first, rest = file.read_text().split("\n", 1)
    text = line.format(1, "", 1) + f"{first}\n" + line.format(4, "s", 5) + rest
    file.write_text(text)
    found = read_trace(file)
    assert len(found.frames) == len(HEARD)
    assert found.remarks[-1] == "a.log: candump reports 5 dropped frames (DROPCOUNT)"


@pytest.mark.parametrize(
    ("data", "shown"),
    [
        ("01020304", "[4]  04`03`02`01"),
        ("0102", "[2]  00000001 00000010"),
        ("0F", "[1]  0F"),
        ("0102030405060708", "{B}  01 02 03 04 05 06 07 08"),
        ("", "{0}"),
    ],
)
def test_bytes_on_a_terminal_may_be_binary_or_swapped(tmp_path, data, shown):
    (tmp_path / "a.log").write_text(f" (1.0)  can0  185   {shown}\n (1.1)  can0  185   [2]  1 2\n")
    found = read_trace(tmp_path / "a.log")
    assert [each.data.hex().upper() for each in found.frames] == [data]
    assert found.remarks == [
        "a.log: left out: 1 line without a classic frame of candump on a terminal"
    ]


@pytest.mark.parametrize("name", ["candump -L", ".asc", ".trc 2.1", "SavvyCAN", "BUSMASTER"])
def test_a_last_line_without_its_end_is_left_out(tmp_path, name):
    text = write_trace(tmp_path, name).read_text()
    last = text.rindex("705") if "BUS" not in name else text.rindex("0x705")
    file = tmp_path / DIALECTS[name].file
    file.write_text(text[: text.index("\n", last) - 2].rstrip())
    found = read_trace(file)
    assert len(found.frames) == len(HEARD) - 1
    assert len(found.remarks) == 1
    assert re.fullmatch(rf"{file.name}: ends within line \d+, which is left out", found.remarks[0])


def test_packets_of_can_fd_and_xl_are_left_out(tmp_path):
    short = bytearray(packet(HEARD[1]))
    short[5] = 0x04
    large = bytearray(packet(HEARD[1]))
    large[4] = 0x81
    others = [bytes(short), packet(HEARD[1]).ljust(72, b"\0"), bytes(large)]
    head = pcap()(HEARD)
    head += b"".join(struct.pack("<4I", 1, 0, len(each), len(each)) + each for each in others)
    (tmp_path / "a.pcap").write_bytes(head)
    found = read_trace(tmp_path / "a.pcap")
    assert len(found.frames) == len(HEARD)
    assert found.remarks == ["a.pcap: left out: 3 lines without a classic frame of pcap"]


def moved(frames, changes):
    """The frames with some seconds added to their times, from some frames on."""
    found, add = [], 0.0
    for k, each in enumerate(frames):
        add += changes.get(k, 0.0)
        found.append(can.Message(
            timestamp=each.timestamp + add, arbitration_id=each.arbitration_id, data=each.data,
            is_extended_id=each.is_extended_id,
        ))  # fmt: skip
    return found


def test_a_clock_that_steps_back_does_not_mix_the_frames(tmp_path):
    (tmp_path / "a.log").write_text(candump_log()(moved(HEARD, {20: -0.03})))
    found = read_trace(tmp_path / "a.log")
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD]
    begin = found.frames[0].timestamp
    off = [each.timestamp - begin - passed(x) for each, x in zip(found.frames, HEARD, strict=True)]
    assert max(map(abs, off)) < 0.003
    (remark,) = found.remarks
    assert "time goes back once, by up to 0.0282 s" in remark


def test_times_that_go_back_again_and_again_do_not_order_the_frames(tmp_path):
    again = moved(HEARD, dict.fromkeys(range(5, 45, 5), -0.02))
    (tmp_path / "a.log").write_text(candump_log()(again))
    found = read_trace(tmp_path / "a.log")
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD]
    assert all(b.timestamp >= a.timestamp for a, b in pairwise(found.frames))
    (remark,) = found.remarks
    assert "order of their lines" in remark


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"PK\x03\x04" + bytes(60), "is a ZIP archive"),
        (b"%PDF-1.7\n", "is a PDF file"),
        (b'{"frames": []}', "is a JSON file"),
        (bytes(range(32)) * 9, "is a binary file of a kind not known here"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "is a MATLAB file"),
        (b"time,x,u\n0,1,2\n", "has no header that names time, identifier and data"),
    ],
)
@pytest.mark.parametrize("name", ["a.csv", "a.log"])
def test_what_is_no_trace_is_named(tmp_path, content, words, name):
    (tmp_path / name).write_bytes(content)
    if name == "a.log" and words.startswith("has no header"):
        words = "without a classic frame of candump -L"
    with pytest.raises(LogError, match=words) as caught:
        read_trace(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_capture_of_another_link_is_named(tmp_path):
    (tmp_path / "a.pcap").write_bytes(pcap(link=1)(HEARD))
    with pytest.raises(LogError, match=r"kind of link \(1\) that is not CAN"):
        read_trace(tmp_path / "a.pcap")


def test_interfaces_of_a_capture_are_channels(tmp_path):
    (tmp_path / "a.pcapng").write_bytes(pcapng(names=("can0", "", "can0"))(HEARD))
    found = read_trace(tmp_path / "a.pcapng")
    assert found.channel == "can0"
    own = [each for k, each in enumerate(HEARD) if k % 3 != 1]
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in own]
    remark = f"channel can0 is shown ({len(own)} frames); others: interface 1 "
    assert found.remarks == [f"{remark}({len(HEARD) - len(own)})"]

    content = bytearray(pcap(link=SLL2)(HEARD))
    content[24 + 16 + 7] = 9  # of the first packet
    (tmp_path / "a.pcap").write_bytes(content)
    found = read_trace(tmp_path / "a.pcap")
    assert found.channel == "interface 3"
    assert len(found.frames) == len(HEARD) - 1


def test_a_block_of_no_size_ends_a_capture(tmp_path):
    content = pcapng()(HEARD[:3])
    (tmp_path / "a.pcapng").write_bytes(content + bytes(64))
    found = read_trace(tmp_path / "a.pcapng")
    assert len(found.frames) == 3
    assert found.remarks == ["a.pcapng: ends within a block, which is left out"]


def test_of_python_cans_database_what_may_be_missing_is_said(tmp_path):
    writer = can.SqliteWriter(tmp_path / "a.db")
    for each in HEARD:
        writer(each)
    writer.stop()
    found = read_trace(tmp_path / "a.db")
    assert found.frames
    assert "the last frames of the bus may be missing" in found.remarks[0]


@pytest.mark.parametrize("cut", [1, 9, 20, 300])
@pytest.mark.parametrize("form", ["pcap", "pcapng", ".asc, CANFD", "SavvyCAN", ".trc 2.1"])
def test_of_a_cut_file_what_is_left_is_read(tmp_path, form, cut):
    file = write_trace(tmp_path, form)
    file.write_bytes(file.read_bytes()[:-cut])
    found = read_trace(file).frames
    assert len(found) >= len(HEARD) - (8 if cut < 300 else 14)
    for each, own in zip(found, HEARD, strict=False):
        assert each.arbitration_id == own.arbitration_id


def test_frames_of_can_fd_are_left_out(tmp_path):
    fd = (
        "   0.300000 CANFD   1 Rx   185   1 0 8 8 01 02 03 04 05 06 07 08  10 13 303000 0 0 0 0 0\n"
    )
    (tmp_path / "a.asc").write_text(asc()(HEARD) + fd + fd.replace("1 0 8", "0 0 8"))
    found = read_trace(tmp_path / "a.asc")
    assert len(found.frames) == len(HEARD)
    assert found.remarks == ["a.asc: left out: 2 lines without a classic frame of Vector's ASC"]


def test_the_day_of_pcan_is_kept(tmp_path):
    file = write_trace(tmp_path, ".trc 1.1")
    begin = datetime.fromtimestamp(read_trace(file).frames[0].timestamp, UTC)
    assert begin.isoformat(timespec="seconds")[:16] == "2023-11-14T22:13"


def rows(start="", end="", time="{:.6f}", data=hexadecimal, identifier=identifier, between=";"):
    """Lines of a frame each, of the 11-bit frames of ``HEARD``."""
    return "".join(
        start + between.join((time.format(passed(each)), identifier(each), data(each))) + end + "\n"
        for each in HEARD
        if not each.is_extended_id
    )


def seconds(text, separator=";"):
    return "\n".join(
        separator.join((cells[0].replace(".", ","), *cells[1:]))
        for cells in (line.split(separator) for line in f"{text}\n".split("\n")[:-1])
    )


@pytest.mark.parametrize(
    "text",
    [
        "time [s];id;data\n" + seconds(rows()),
        "timestamp;id;data\n" + rows(start="2024-01-01T10:00:0"),
        '"Time";"Identifier (hex)";"Data (hex)"\n' + rows(start="00:00:0"),
        "timestamp_ns;id;data\n"
        + "".join(
            f"{passed(each) * 1e9:.0f};{identifier(each)};{hexadecimal(each)}\n"
            for each in HEARD
            if not each.is_extended_id
        ),
        "time;id;data\n" + rows(data=lambda each: " ".join(f"0x{byte:02X}" for byte in each.data)),
        "Line;Abs Time(Sec);Arb ID;B1;B2;B3;B4;B5;B6;B7;B8\n"
        + rows(
            start="1;",
            data=lambda each: ";".join([hexadecimal(each, ";"), *[""] * (7 - len(each.data))]),
        ),
    ],
    ids=["decimal comma", "date", "time of day", "nanoseconds", "0x", "Vehicle Spy"],
)
def test_columns_as_other_programs_write_them(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    found = read_trace(tmp_path / "a.csv")
    short = [each for each in HEARD if not each.is_extended_id]
    assert [each.arbitration_id for each in found.frames] == [each.arbitration_id for each in short]
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in short]
    assert found.frames[-1].timestamp - found.frames[0].timestamp == pytest.approx(0.2, abs=1e-5)
    assert not found.remarks


def test_whole_numbers_without_a_unit_are_told_as_seconds(tmp_path):
    (tmp_path / "a.csv").write_text("time,id,data\n1000,705,05\n2000,705,7f\n")
    assert "taken as seconds" in read_trace(tmp_path / "a.csv").remarks[0]


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("a.csv", "time,id,data\n1.0,705,05\nnan,705,7f\ninf,705,7f\n1e999,705,7f\n"),
        (
            "a.asc",
            "base hex\n1.0 1 705 Rx d 1 05\n" + 3 * "inf 1 705 Rx d 1 7F\n",
        ),
        ("a.log", "(1.0) can0 705#05\n" + f"({400 * '9'}.0) can0 705#7F\n" * 3),
    ],
)
def test_a_time_that_is_no_number_costs_its_frame(tmp_path, file, text):
    (tmp_path / file).write_text(text)
    found = read_trace(tmp_path / file)
    assert [bytes(each.data) for each in found.frames] == [b"\x05"]
    assert "left out: 3" in found.remarks[0]


@pytest.mark.parametrize("start", ["yesterday", "nan", ""])
def test_a_beginning_that_is_no_day_costs_itself(tmp_path, start):
    text = trc("1.1")(HEARD)
    (tmp_path / "a.trc").write_text(re.sub("STARTTIME=.*", f"STARTTIME={start}", text))
    found = read_trace(tmp_path / "a.trc")
    assert len(found.frames) == len(HEARD)
    assert any("its beginning is no day" in each for each in found.remarks)


def test_of_a_small_packed_trace_that_is_cut_what_is_left_is_read(tmp_path):
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(candump_log()(HEARD[:8]).encode())[:-30])
    found = read_trace(tmp_path / "a.log.gz")
    assert 2 < len(found.frames) < 8
    assert "cannot be read on after line" in found.remarks[0]


def test_colours_of_a_terminal_are_no_part_of_a_line(tmp_path):
    plain = candump_terminal("a")(HEARD)
    (tmp_path / "a.txt").write_text(re.sub("^(.*)$", "\x1b[31m\\1\x1b[0m", plain, flags=re.M))
    assert len(read_trace(tmp_path / "a.txt").frames) == len(HEARD)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "it is empty"),
        (b"\n\r\n \n", "it has none"),
        (b"hello\n", "left out: 1 line without a classic frame"),
        (b"\x00\x01\xff", "is a binary file"),
    ],
)
def test_why_nothing_can_be_read_is_said(tmp_path, content, words):
    (tmp_path / "a.log").write_bytes(content)
    with pytest.raises(LogError, match=f"no frame can be read: {words}") as caught:
        read_trace(tmp_path / "a.log")
    assert str(caught.value).count("a.log") == 1


def test_frames_that_are_no_canopen_are_counted(tmp_path, capsys):
    text = "(1.0) can0 00000705#05\n(1.1) can0 7E5#04\n(1.2) can0 705#05\n"
    (tmp_path / "a.log").write_text(text)
    code, shown, _ = called(capsys, "trace", tmp_path / "a.log")
    assert code == 0
    assert "not decoded: 1 frame with 29-bit identifiers, no CANopen (705h)" in shown
    assert "not decoded: 1 frame of no known service (7E5h)" in shown


def test_a_broken_measurement_file_is_refused_without_a_traceback(tmp_path, monkeypatch):
    pytest.importorskip("asammdf")
    ignored = []
    monkeypatch.setattr(sys, "unraisablehook", ignored.append)
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    " + bytes(10))
    with pytest.raises(LogError, match="no frame can be read"):
        read_trace(tmp_path / "a.mf4")
    gc.collect()
    assert ignored == []
