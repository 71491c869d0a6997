"""`twin.devices.akd.trace_files`.

One conversation in the form of every program: the same frames come back, to its times."""

import gzip
import re
import struct
from datetime import UTC, datetime
from itertools import pairwise

import can
import pytest
from command_line import called

from twin.base.errors import LogError
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.traces import TraceWriter, read_trace

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


def lines(text):
    """Makes a writer of one that gives a frame's line."""
    return lambda frames: "".join(f"{text(each)}\n" for each in frames)


def hexadecimal(each, separator=" "):
    return separator.join(f"{byte:02X}" for byte in each.data)


def name(each):
    return f"{each.arbitration_id:08X}" if each.is_extended_id else f"{each.arbitration_id:03X}"


def passed(each):
    return each.timestamp - BEGIN


def candump_log(frames):
    return "".join(
        f"({each.timestamp:.6f}) can0 {name(each)}#{hexadecimal(each, '')}\n" for each in frames
    )


def terminal(time, way=""):
    def text(frames):
        last, found = frames[0].timestamp, ""
        for each in frames:
            stamp = time(each, each.timestamp - last)
            last = each.timestamp
            rest = f"{way}{name(each):>8}   [{len(each.data)}]  {hexadecimal(each)}"
            found += f" {stamp} can0  {rest}\n"
        return found

    return text


def local(each, _):
    return f"({datetime.fromtimestamp(each.timestamp).isoformat(' ', 'microseconds')})"


def asc(base="hex", relative=False, long=False, day="Mon Nov 13 22:13:20.000 2023"):
    def text(frames):
        word = "relative" if relative else "absolute"
        found = f"date {day}\nbase {base}  timestamps {word}\nno internal events logged\n"
        found += f"// version 9.0.0\nBegin Triggerblock {day}\n   0.000000 Start of measurement\n"
        last = 0.0
        for each in frames:
            at = passed(each) - (last if relative else 0.0)
            last = passed(each)
            digits = "d" if base == "dec" else "X"
            mark = f"{each.arbitration_id:{digits}}{'x' if each.is_extended_id else ''}"
            way = "Rx" if each.is_rx else "Tx"
            data = " ".join(f"{byte:{'d' if base == 'dec' else '02X'}}" for byte in each.data)
            if long:
                found += (
                    f"{at:11.6f} CANFD   1 {way}   {mark:>8}                                   0 0 "
                    f"{len(each.data):x} {len(each.data):2d} {data}   102203  133   200000  4E5D"
                    " 0 0 0 0\n"
                )
            else:
                found += f"{at:11.6f} 1  {mark:<15} {way}   d {len(each.data)} {data}\n"
        return found + "End TriggerBlock\n"

    return text


def trc(version):
    def text(frames):
        found = f";$FILEVERSION={version}\n;$STARTTIME={BEGIN / 86400 + 25569:.10f}\n"
        found = "" if version == "1.0" else found
        if version[0] == "2":
            columns = {"2.0": "N,O,T,I,d,L,D", "2.1": "N,O,T,B,I,d,R,L,D"}[version]
            found += f";$COLUMNS={columns}\n"
        found += ";   Message Number\n"
        for k, each in enumerate(frames, 1):
            way, count = "Rx" if each.is_rx else "Tx", len(each.data)
            mark = f"{each.arbitration_id:0{8 if each.is_extended_id else 4}X}"
            at = f"{1e3 * passed(each):.3f}"
            data = hexadecimal(each)
            found += {
                "1.0": f"{k:6d}) {at} {mark} {count} {data}\n",
                "1.1": f"{k:6d}) {at} {way} {mark} {count} {data}\n",
                "1.2": f"{k:6d}) {at} 1 {way} {mark} {count} {data}\n",
                "1.3": f"{k:6d}) {at} 1 {way} {mark} - {count} {data}\n",
                "2.0": f"{k:6d} {at} DT {mark} {way} {count} {data}\n",
                "2.1": f"{k:6d} {at} DT 1 {mark} {way} - {count} {data}\n",
            }[version]
        return found

    return text


def busmaster(base="HEX", mode="SYSTEM MODE"):
    def text(frames):
        found = f"***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***{base}***\n***{mode}***\n"
        found += "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n"
        last = 0.0
        for each in frames:
            at = passed(each) - (last if mode == "RELATIVE MODE" else -86399.9)
            last = passed(each)
            tenths = round(1e4 * at) % (864000000)
            clock = f"{tenths // 36000000:02d}:{tenths // 600000 % 60:02d}:"
            clock += f"{tenths // 10000 % 60:02d}:{tenths % 10000:04d}"
            kind, way = "x" if each.is_extended_id else "s", "Rx" if each.is_rx else "Tx"
            mark = f"0x{name(each)}" if base == "HEX" else f"{each.arbitration_id}"
            data = hexadecimal(each) if base == "HEX" else " ".join(map(str, each.data))
            found += f"{clock} {way} 1 {mark} {kind} {len(each.data)} {data} \n"
        return found + "***END DATE AND TIME 13:11:2023 22:13:20:000***\n"

    return text


def savvycan(frames, *, way=True):
    head = f"Time Stamp,ID,Extended,{'Dir,' if way else ''}Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    for each in frames:
        cells = [
            f"{round(1e6 * passed(each))}", f"{each.arbitration_id:08X}",
            str(each.is_extended_id).lower(),
            *(["Rx" if each.is_rx else "Tx"] if way else []), "0", f"{len(each.data)}",
            *(f"{byte:02X}" for byte in bytes(each.data).ljust(8, bytes(1))), "",
        ]  # fmt: skip
        head += ",".join(cells) + "\n"
    return head


def kvaser_table(base):
    def text(frames):
        found = (
            "Time,Channel,ID,Flags,DLC,Data0,Data1,Data2,Data3,Data4,Data5,Data6,Data7,Counter\n"
        )
        for k, each in enumerate(frames):
            digits = {16: "02X", 10: "d"}[base]
            data = [f"{byte:{digits}}" for byte in each.data] + [""] * (8 - len(each.data))
            mark = f"{each.arbitration_id:{digits}}"
            found += f"{passed(each):.6f},1,{mark},2,{len(each.data)},{','.join(data)},{k}\n"
        return found

    return text


def canking(frames):
    found = "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
    for each in frames:
        flag, way = "X" if each.is_extended_id else " ", "R" if each.is_rx else "T"
        found += f" 0    {name(each):>8} {flag}       {len(each.data)}  {hexadecimal(each, '  ')}"
        found += f"     {passed(each):.6f} {way}\n"
    return found + "Logging stopped.\n"


def raw(each):
    flags = each.is_extended_id << 31 | each.is_error_frame << 29 | each.is_remote_frame << 30
    return struct.pack(">IBxxx", each.arbitration_id | flags, each.dlc) + bytes(each.data)


def pcap(order, magic, link, unit):
    def made(frames):
        found = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, link)
        for each in frames:
            body = (struct.pack(">HHHQH", 4, 280, 0, 0, 12) if link == 113 else b"") + raw(each)
            seconds = int(each.timestamp)
            parts = round((each.timestamp - seconds) / unit)
            found += struct.pack(f"{order}4I", seconds, parts, len(body), len(body)) + body
        return found

    return made


def pcapng(order, power=None):
    def block(kind, body):
        body += bytes(-len(body) % 4)
        size = struct.pack(f"{order}I", len(body) + 12)
        return struct.pack(f"{order}I", kind) + size + body + size

    def made(frames):
        found = block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
        option = struct.pack(f"{order}HHBxxxI", 9, 1, power, 0) if power is not None else b""
        found += block(1, struct.pack(f"{order}HHI", 227, 0, 0) + option)
        for each in frames:
            body, count = raw(each), round(each.timestamp * 10 ** (6 if power is None else power))
            head = struct.pack(f"{order}5I", 0, count >> 32, count & 0xFFFFFFFF, *[len(body)] * 2)
            found += block(6, head + body)
        return found

    return made


FORMS = {
    "candump -L": ("a.log", candump_log, 2e-6),
    "candump -L without ending": ("trace", candump_log, 2e-6),
    "candump -ta": ("a.log", terminal(lambda each, _: f"({each.timestamp:.6f})"), 2e-6),
    "candump -td": ("a.log", terminal(lambda _, since: f"({since:010.6f})"), 5e-5),
    "candump -tz": ("a.log", terminal(lambda each, _: f"({passed(each):010.6f})"), 2e-6),
    "candump -tA": ("a.txt", terminal(local), 2e-6),
    "candump -x": ("a.log", terminal(lambda each, _: f"({each.timestamp:.6f})", "RX - -  "), 2e-6),
    ".asc": ("a.asc", asc(), 2e-6),
    ".asc, decimal": ("a.asc", asc("dec"), 2e-6),
    ".asc, relative": ("a.asc", asc(relative=True), 5e-5),
    ".asc, relative and decimal": ("a.asc", asc("dec", relative=True), 5e-5),
    ".asc, German": ("a.asc", asc(day="Mo Mär 13 22:13:20.000 2023"), 2e-6),
    ".asc, long lines": ("a.asc", asc(long=True), 2e-6),
    ".asc, long lines, relative": ("a.asc", asc(long=True, relative=True), 5e-5),
    ".asc without its ending": ("a.txt", asc(), 2e-6),
    **{f".trc {version}": ("a.trc", trc(version), 2e-5) for version in ("1.0", "1.1", "1.2")},
    **{f".trc {version}": ("a.trc", trc(version), 2e-5) for version in ("1.3", "2.0", "2.1")},
    "BUSMASTER": ("a.log", busmaster(), 2e-4),
    "BUSMASTER, decimal": ("a.log", busmaster("DEC"), 2e-4),
    "BUSMASTER, relative": ("a.log", busmaster(mode="RELATIVE MODE"), 5e-3),
    "SavvyCAN": ("a.csv", savvycan, 2e-6),
    "SavvyCAN, older": ("a.csv", lambda frames: savvycan(frames, way=False), 2e-6),
    "Kvaser": ("a.csv", kvaser_table(16), 2e-6),
    "Kvaser, decimal": ("a.csv", kvaser_table(10), 2e-6),
    "CanKing": ("a.txt", canking, 2e-6),
    "pcap": ("a.pcap", pcap("<", 0xA1B2C3D4, 227, 1e-6), 2e-6),
    "pcap, other order, ns": ("a.pcap", pcap(">", 0xA1B23C4D, 227, 1e-9), 1e-6),
    "pcap of any device": ("a.pcap", pcap("<", 0xA1B2C3D4, 113, 1e-6), 2e-6),
    "pcapng": ("a.pcapng", pcapng("<"), 2e-6),
    "pcapng, other order, ns": ("a.pcapng", pcapng(">", 9), 1e-6),
}
"""A file's name, what writes it, and how near its times come back, s."""


def written(tmp_path, form, frames=HEARD):
    file, write, near = FORMS[form]
    content = write(frames)
    if isinstance(content, bytes):
        (tmp_path / file).write_bytes(content)
    else:
        (tmp_path / file).write_text(content, encoding="utf-8")
    return tmp_path / file, near


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_frames(tmp_path, form):
    file, near = written(tmp_path, form)
    found = read_trace(file)
    assert [each.arbitration_id for each in found.frames] == [x.arbitration_id for x in HEARD]
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD]
    assert [each.is_extended_id for each in found.frames] == [x.is_extended_id for x in HEARD]
    begin = found.frames[0].timestamp
    times = [each.timestamp - begin for each in found.frames]
    assert times == pytest.approx([passed(each) for each in HEARD], abs=near)
    assert found.timed
    added = ["added up"] if "relative" in form or form == "candump -td" else []
    assert [each.rpartition(" are ")[2] for each in found.remarks] == added


@pytest.mark.parametrize("form", FORMS)
def test_every_form_tells_the_same(tmp_path, form):
    file, _ = written(tmp_path, form)
    one, other = (Conversation(frames) for frames in (read_trace(file).frames, HEARD))
    assert [each.text for each in one.events] == [each.text for each in other.events]
    assert one.nodes == other.nodes


@pytest.mark.parametrize("form", ["candump -L", ".asc", ".trc 1.1", "SavvyCAN", "BUSMASTER"])
def test_a_line_at_fault_costs_itself(tmp_path, form):
    file, _ = written(tmp_path, form)
    text = file.read_text()
    whole = text.splitlines()
    k = next(i for i, line in enumerate(whole) if "37" in line and "02" in line)
    bad = whole[k].replace("02", "0?", 1).replace("37", "3z", 1)
    file.write_text("\n".join([*whole[:k], bad, *whole[k + 1 :]]) + "\n")
    found = read_trace(file)
    assert len(found.frames) == len(HEARD) - 1
    assert len(found.remarks) == 1
    assert "left out: 1 lines that are no classic frame of" in found.remarks[0]


def test_a_terminal_without_times_numbers_the_frames(tmp_path):
    (tmp_path / "a.log").write_text(terminal(lambda *_: "")(HEARD))
    found = read_trace(tmp_path / "a.log")
    assert not found.timed
    assert [each.timestamp for each in found.frames] == list(range(len(HEARD)))
    assert found.remarks == ["a.log: has no times: frames are numbered in their place"]


def test_without_times_none_is_told(tmp_path, capsys):
    (tmp_path / "a.log").write_text(terminal(lambda *_: "")(HEARD))
    _, out, _ = called(capsys, "trace", str(tmp_path / "a.log"))
    assert f"{len(HEARD)} frames on can0, without times" in " ".join(out.split())
    assert "time [s]" not in out
    code, _, err = called(capsys, "trace", str(tmp_path / "a.log"), "--replay")
    assert code == 2
    assert "has no times" in err


def test_differences_of_time_that_are_all_the_same_are_added_up(tmp_path):
    even = [frame(0.002 * k, 0x185, f"3702{k:02x}") for k in range(30)]
    (tmp_path / "a.log").write_text(terminal(lambda _, since: f"({since:010.6f})")(even))
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
        ("1.0", "  9) 12.5 FFFFFFFF 4 00 00 00 10 BUSOFF", "bus off"),
        ("1.3", "  9) 12.5 1 Error 0008 - 4 00 19 08 08", "bus error"),
        ("2.0", "  9 12.5 ER - Rx 4 00 19 08 08", "bus error"),
        ("2.0", "  9 12.5 ST - Rx 4 00 00 00 10", "bus off"),
    ],
)
def test_rows_of_errors_of_pcan_are_told(tmp_path, version, row, words):
    (tmp_path / "a.trc").write_text(trc(version)(HEARD) + row + "\n")
    told = Conversation(read_trace(tmp_path / "a.trc").frames)
    assert told.errors == {words: 1}


def test_an_error_frame_of_asc_is_told(tmp_path):
    (tmp_path / "a.asc").write_text(asc()(HEARD) + "   0.300000 1  ErrorFrame\n")
    assert sum(Conversation(read_trace(tmp_path / "a.asc").frames).errors.values()) == 1


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
    (tmp_path / "a.log").write_text(candump_log(moved(HEARD, {20: -0.03})))
    found = read_trace(tmp_path / "a.log")
    assert [bytes(each.data) for each in found.frames] == [bytes(each.data) for each in HEARD]
    begin = found.frames[0].timestamp
    off = [each.timestamp - begin - passed(x) for each, x in zip(found.frames, HEARD, strict=True)]
    assert max(map(abs, off)) < 0.003
    (remark,) = found.remarks
    assert "time goes back once, by up to 0.0282 s" in remark


def test_times_that_go_back_again_and_again_do_not_order_the_frames(tmp_path):
    again = moved(HEARD, dict.fromkeys(range(5, 45, 5), -0.02))
    (tmp_path / "a.log").write_text(candump_log(again))
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
        words = "no classic frame of candump -L"
    with pytest.raises(LogError, match=words) as caught:
        read_trace(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_capture_of_another_link_is_named(tmp_path):
    (tmp_path / "a.pcap").write_bytes(pcap("<", 0xA1B2C3D4, 1, 1e-6)(HEARD))
    with pytest.raises(LogError, match=r"another kind of link \(1\) than CAN"):
        read_trace(tmp_path / "a.pcap")


def test_of_python_cans_database_what_may_be_missing_is_said(tmp_path):
    writer = can.SqliteWriter(tmp_path / "a.db")
    for each in HEARD:
        writer(each)
    writer.stop()
    found = read_trace(tmp_path / "a.db")
    assert found.frames
    assert "the end of what was heard may be missing" in found.remarks[0]


@pytest.mark.parametrize("cut", [1, 9, 20, 300])
@pytest.mark.parametrize("form", ["pcap", "pcapng", ".asc, long lines", "SavvyCAN", ".trc 2.1"])
def test_of_a_cut_file_what_is_left_is_read(tmp_path, form, cut):
    file, _ = written(tmp_path, form)
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
    assert found.remarks == ["a.asc: left out: 2 lines that are no classic frame of Vector's ASC"]


def test_the_day_of_pcan_is_kept(tmp_path):
    file, _ = written(tmp_path, ".trc 1.1")
    begin = datetime.fromtimestamp(read_trace(file).frames[0].timestamp, UTC)
    assert begin.isoformat(timespec="seconds")[:16] == "2023-11-14T22:13"


def rows(start="", end="", time="{:.6f}", data=hexadecimal, identifier=name, between=";"):
    """Lines of a frame each, of the 11-bit frames of ``HEARD``."""
    return "".join(
        start + between.join((time.format(passed(each)), identifier(each), data(each))) + end + "\n"
        for each in HEARD
        if not each.is_extended_id
    )


def seconds(text, separator=";"):
    return "\n".join(
        separator.join((cells[0].replace(".", ","), *cells[1:]))
        for cells in (line.split(separator) for line in text.splitlines())
    )


@pytest.mark.parametrize(
    "text",
    [
        "time [s];id;data\n" + seconds(rows()),
        "timestamp;id;data\n" + rows(start="2024-01-01T10:00:0"),
        '"Time";"Identifier (hex)";"Data (hex)"\n' + rows(start="00:00:0"),
        "timestamp_ns;id;data\n"
        + "".join(
            f"{passed(each) * 1e9:.0f};{name(each)};{hexadecimal(each)}\n"
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
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(candump_log(HEARD[:8]).encode())[:-30])
    found = read_trace(tmp_path / "a.log.gz")
    assert 2 < len(found.frames) < 8
    assert "cannot be read on after line" in found.remarks[0]


def test_colours_of_a_terminal_are_no_part_of_a_line(tmp_path):
    plain = terminal(lambda each, _: f"({each.timestamp:.6f})")(HEARD)
    (tmp_path / "a.txt").write_text(re.sub("^(.*)$", "\x1b[31m\\1\x1b[0m", plain, flags=re.M))
    assert len(read_trace(tmp_path / "a.txt").frames) == len(HEARD)


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "it is empty"), (b"\n\r\r\n" + b"\xff" * 60, "it has none")],
)
def test_why_nothing_can_be_read_is_said(tmp_path, content, words):
    (tmp_path / "a.log").write_bytes(content)
    with pytest.raises(LogError, match=f"no frame can be read: {words}"):
        read_trace(tmp_path / "a.log")


def test_frames_that_are_no_canopen_are_counted(tmp_path, capsys):
    text = "(1.0) can0 00000705#05\n(1.1) can0 7E5#04\n(1.2) can0 705#05\n"
    (tmp_path / "a.log").write_text(text)
    code, shown, _ = called(capsys, "trace", tmp_path / "a.log")
    assert code == 0
    assert "not decoded: 1 frames with 29-bit identifiers, no CANopen (705h)" in shown
    assert "not decoded: 1 frames of no known service (7E5h)" in shown
