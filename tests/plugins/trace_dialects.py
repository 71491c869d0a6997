"""The same frames of a CAN bus as each program writes them, by the documentation of its format."""

import gzip
import sqlite3
import struct
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from typing import NamedTuple

import can


class Dialect(NamedTuple):
    """A format of traces.

    Attributes:
        file: The name of a file.
        write: Makes text or bytes of frames, or writes them into a file and returns nothing.
        resolution: Of its times, s.
        timed: Whether it has times.
        remarks: The ends of the remarks that its reader makes.
    """

    file: str
    write: Callable
    resolution: float = 1e-6
    timed: bool = True
    remarks: tuple[str, ...] = ()


def write_dialect(dialect, folder, frames):
    """Write frames into a folder; the file."""
    file = folder / dialect.file
    content = dialect.write(frames)
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif isinstance(content, str):
        file.write_text(content, encoding="utf-8")
    else:
        content(file)
    return file


def pack(file):
    """The same file packed by gzip."""
    packed = file.with_name(file.name + ".gz")
    packed.write_bytes(gzip.compress(file.read_bytes(), 1))
    return packed


def hexadecimal(each, separator=" "):
    return separator.join(f"{byte:02X}" for byte in each.data)


def identifier(each):
    return f"{each.arbitration_id:08X}" if each.is_extended_id else f"{each.arbitration_id:03X}"


def since_first(frames):
    return [each.timestamp - frames[0].timestamp for each in frames]


def differences(times, digits=6):
    """Differences of rounded times, the first from 0."""
    rounded = [round(each, digits) for each in times]
    return [rounded[0], *(after - before for before, after in pairwise(rounded))]


# candump, as can-utils/candump.c and lib.c print


STAMPS = {
    "": lambda frames: [""] * len(frames),
    "a": lambda frames: [f"({each.timestamp:017.6f}) " for each in frames],
    "N": lambda frames: [f"({each.timestamp:020.9f}) " for each in frames],
    "z": lambda frames: [f"({each:010.6f}) " for each in since_first(frames)],
    "d": lambda frames: [f"({each:010.6f}) " for each in differences(since_first(frames))],
    "A": lambda frames: [
        f"({datetime.fromtimestamp(each.timestamp).isoformat(' ', 'microseconds')}) "
        for each in frames
    ],
}
"""The times of candump, by its option -t, and those of -N."""


def candump_log(mode="a", *, extra=False):
    return lambda frames: "".join(
        f"{stamp}can0 {identifier(each)}#{hexadecimal(each, '')}"
        f"{(' R' if each.is_rx else ' T') if extra else ''}\n"
        for stamp, each in zip(STAMPS[mode](frames), frames, strict=True)
    )


def candump_terminal(mode="", *, extra=False, body="[{count}] {data}", after=""):
    def line(each):
        way = ("  RX - -" if each.is_rx else "  TX - -") if extra else ""
        shown = body.format(
            count=len(each.data),
            data="".join(f" {byte:02X}" for byte in each.data),
            bits="".join(f" {byte:08b}" for byte in each.data),
            swapped="`".join(f"{byte:02X}" for byte in reversed(each.data)),
        )
        return f" can0{way}  {identifier(each):>8}   {shown}{after}\n"

    return lambda frames: "".join(
        f" {stamp}{line(each)}" for stamp, each in zip(STAMPS[mode](frames), frames, strict=True)
    )


# Vector's .asc, by "CAN, Log & Trigger ASC Logging Format" of Vector Informatik


def asc(
    base="hex", *, relative=False, long=False, others=(), day="Mon Nov 13 10:13:20.000 pm 2023"
):
    def text(frames):
        word = "relative" if relative else "absolute"
        found = f"date {day}\nbase {base}  timestamps {word}\ninternal events logged\n"
        found += f"// version 9.0.0\nBegin Triggerblock {day}\n   0.000000 Start of measurement\n"
        times = since_first(frames)
        lines = []
        for number, (time, each) in enumerate(zip(times, frames, strict=True)):
            lines.append((time, line(each)))
            if number % 20 == 0:
                lines.extend((time, other) for other in others)
        stamps = [time for time, _ in lines]
        shown = differences(stamps) if relative else stamps
        for stamp, (_, rest) in zip(shown, lines, strict=True):
            found += f"{stamp:11.6f} {rest}\n"
        return found + "End TriggerBlock\n"

    def line(each):
        digits = "d" if base == "dec" else "X"
        mark = f"{each.arbitration_id:{digits}}{'x' if each.is_extended_id else ''}"
        way = "Rx" if each.is_rx else "Tx"
        data = " ".join(f"{byte:{'d' if base == 'dec' else '02X'}}" for byte in each.data)
        count = len(each.data)
        if long:
            return (
                f"CANFD   1 {way}   {mark:>8}                                   0 0 "
                f"{count:x} {count:2d} {data}   102203  133   200000  4E5D 0 0 0 0"
            )
        tail = f"  Length = 236000 BitCount = 121 ID = {each.arbitration_id}"
        return f"1  {mark:<15} {way}   d {count} {data}{tail}"

    return text


ASC_OTHERS = (
    "1  Statistic: D 140 R 0 XD 0 XR 0 E 0 O 0 B 3.45%",
    "CAN 1 Status:chip status error active",
    "1  J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F DE 80 3E E6 80 3E FF 80",
    "SV: 2 0 1 ::Engine::Speed = 1500",
    "TFS: [0,0] Test module started",
)
"""Events that are no frames: statistics, state of the chip, J1939, a variable, a test."""


# PCAN-View's .trc, by "PEAK CAN TRC File Format" of PEAK-System


def trc(version):
    digits = {"1.0": 0, "1.1": 1}.get(version, 3)

    def text(frames):
        found = f";$FILEVERSION={version}\n;$STARTTIME={frames[0].timestamp / 86400 + 25569:.10f}\n"
        found = "" if version == "1.0" else found
        if version[0] == "2":
            columns = {"2.0": "N,O,T,I,d,l,D", "2.1": "N,O,T,B,I,d,R,L,D"}[version]
            found += f";$COLUMNS={columns}\n"
        found += ";\n;   C:\\TraceFile.trc\n;   Message Number\n;---+--   ----+----  --+--\n"
        for k, (time, each) in enumerate(zip(since_first(frames), frames, strict=True), 1):
            way, count, data = "Rx" if each.is_rx else "Tx", len(each.data), hexadecimal(each)
            mark = f"{each.arbitration_id:0{8 if each.is_extended_id else 4}X}"
            at = f"{1e3 * time:.{digits}f}"
            found += {
                "1.0": f"{k:6d}) {at:>9}  {mark:>8}  {count}  {data} \n",
                "1.1": f"{k:6d}) {at:>11}  {way}     {mark:>8}  {count}  {data} \n",
                "1.2": f"{k:6d}) {at:>13}  1  {way}     {mark:>8}  {count}  {data} \n",
                "1.3": f"{k:6d}) {at:>13} 1  {way}    {mark:>8} -  {count}    {data} \n",
                "2.0": f"{k:7d} {at:>13} DT {mark:>8} {way} {count}  {data} \n",
                "2.1": f"{k:7d} {at:>13} DT 1  {mark:>8} {way} -  {count}    {data} \n",
            }[version]
        return found

    return text


def busmaster(base="HEX", mode="SYSTEM MODE"):
    def text(frames):
        found = f"***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***{base}***\n***{mode}***\n"
        found += "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n"
        times = since_first(frames)
        if mode == "RELATIVE MODE":
            times = differences(times, 4)
        if mode == "SYSTEM MODE":
            times = [each + 86399.9 for each in times]  # midnight passes
        for time, each in zip(times, frames, strict=True):
            parts = round(1e4 * time) % 864000000
            clock = f"{parts // 36000000:02d}:{parts // 600000 % 60:02d}:"
            clock += f"{parts // 10000 % 60:02d}:{parts % 10000:04d}"
            kind, way = "x" if each.is_extended_id else "s", "Rx" if each.is_rx else "Tx"
            mark = f"0x{identifier(each)}" if base == "HEX" else f"{each.arbitration_id}"
            data = hexadecimal(each) if base == "HEX" else " ".join(map(str, each.data))
            found += f"{clock} {way} 1 {mark} {kind} {len(each.data)} {data} \n"
        return found + "***END DATE AND TIME 13:11:2023 22:13:20:000***\n"

    return text


# tables


def savvycan(*, way=True):
    def text(frames):
        found = f"Time Stamp,ID,Extended,{'Dir,' if way else ''}Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
        for time, each in zip(since_first(frames), frames, strict=True):
            cells = [
                f"{round(1e6 * time)}", f"{each.arbitration_id:08X}",
                str(each.is_extended_id).lower(),
                *(["Rx" if each.is_rx else "Tx"] if way else []), "0", f"{len(each.data)}",
                *(f"{byte:02X}" for byte in bytes(each.data).ljust(8, bytes(1))), "",
            ]  # fmt: skip
            found += ",".join(cells) + "\n"
        return found

    return text


def kvaser_table(base):
    def text(frames):
        numbers = ",".join(f"Data{k}" for k in range(8))
        found = f"Time,Channel,ID,Flags,DLC,{numbers},Counter\n"
        for k, (time, each) in enumerate(zip(since_first(frames), frames, strict=True)):
            digits = {16: "02X", 10: "d"}[base]
            data = [f"{byte:{digits}}" for byte in each.data] + [""] * (8 - len(each.data))
            flags = (4 if each.is_extended_id else 2) | (0 if each.is_rx else 0x40)
            mark = f"{each.arbitration_id:{digits}}"
            found += f"{time:.6f},1,{mark},{flags},{len(each.data)},{','.join(data)},{k}\n"
        return found

    return text


def canking(frames):
    found = "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
    for time, each in zip(since_first(frames), frames, strict=True):
        flag, way = "X" if each.is_extended_id else " ", "R" if each.is_rx else "T"
        found += f" 0    {identifier(each):>8} {flag}       {len(each.data)}  "
        found += f"{hexadecimal(each, '  ')}     {time:.6f} {way}\n"
    return found + "Logging stopped.\n"


# captures, by tcpdump.org/linktypes and the pcapng specification

SOCKETCAN, SLL, SLL2 = 227, 113, 276


def packet(each, link=SOCKETCAN, order=">"):
    """A frame as Linux hands it to a capture; of any device in the computer's byte order."""
    head = {
        SLL: struct.pack(">HHHQH", 1, 280, 0, 0, 0x000C),
        SLL2: struct.pack(">HHIHBBQ", 0x000C, 0, 3, 280, 1, 0, 0),
    }.get(link, b"")
    mark = each.arbitration_id | each.is_extended_id << 31 | each.is_error_frame << 29
    mark |= each.is_remote_frame << 30
    packed = struct.pack(f"{order if head else '>'}IBxxx", mark, each.dlc)
    return head + packed + bytes(each.data)


def pcap(order="<", magic=0xA1B2C3D4, link=SOCKETCAN, unit=1e-6):
    def made(frames):
        found = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, link)
        for each in frames:
            body = packet(each, link, order)
            seconds, parts = divmod(round(each.timestamp / unit), round(1 / unit))
            found += struct.pack(f"{order}4I", seconds, parts, len(body), len(body)) + body
        return found

    return made


def pcapng(order="<", power=None, link=SOCKETCAN, names=("",)):
    """Frames of interfaces that take turns; those with a name have it as an option."""

    def block(kind, body):
        body += bytes(-len(body) % 4)
        size = struct.pack(f"{order}I", len(body) + 12)
        return struct.pack(f"{order}I", kind) + size + body + size

    def made(frames):
        found = block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1))
        unit = struct.pack(f"{order}HHBxxx", 9, 1, power) if power is not None else b""
        for name in names:
            text = name.encode().ljust((len(name) + 3) // 4 * 4, b"\0")
            named = struct.pack(f"{order}HH", 2, len(name)) + text if name else b""
            found += block(1, struct.pack(f"{order}HHI", link, 0, 0) + named + unit + bytes(4))
        for number, each in enumerate(frames):
            body = packet(each, link, order)
            count = round(each.timestamp * 10 ** (6 if power is None else power))
            numbers = number % len(names), count >> 32, count & 0xFFFFFFFF, len(body), len(body)
            found += block(6, struct.pack(f"{order}5I", *numbers) + body)
        return found

    return made


# loggers and analysers


def cl2000(frames):
    """As the manual of CL1000 and CL2000 (CSS Electronics) has it, time format 4."""
    rows = ["# Logger type: CL2000", "# Time format: 4", '# Value separator: ";"']
    rows.append("Timestamp;Type;ID;Data")
    for each in frames:
        date = datetime.fromtimestamp(round(each.timestamp, 3), UTC)
        stamp = f"{date:%dT%H%M%S}{date.microsecond // 1000:03d}"
        kind = each.is_extended_id + 8 * (not each.is_rx)
        data = bytes(each.data).hex()
        rows.append(f"{stamp};{kind};{each.arbitration_id:x};{data}")
    return "\n".join(rows) + "\n"


def canedge(frames):
    """As its converter writes what a CANedge recorded."""
    rows = ["TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;ESI;RTR;DataBytes"]
    rows += [
        f"{each.timestamp:.6f};1;{each.arbitration_id:x};{each.is_extended_id:d};{each.dlc};"
        f"{each.dlc};{not each.is_rx:d};0;0;0;0;{bytes(each.data).hex()}"
        for each in frames
    ]
    return "\n".join(rows) + "\n"


def saleae(frames):
    """As Logic 2 exports the table of its analyser of CAN: each field of a frame in a row."""
    rows = ["name,type,start_time,duration,ack,crc,data,extended,identifier,num_data_bytes"]
    for each, time in zip(frames, since_first(frames), strict=True):
        extended = "true" if each.is_extended_id else ""
        rows.append(
            f'"CAN","identifier_field",{time:.9f},2e-05,,,,{extended},0x{each.arbitration_id:08X},'
        )
        rows.append(f'"CAN","control_field",{time + 1e-5:.9f},1e-05,,,,,,0x{each.dlc:02X}')
        rows += [f'"CAN","data_field",{time + 2e-5:.9f},8e-06,,,0x{b:02X},,,' for b in each.data]
        rows.append(f'"CAN","crc_field",{time + 9e-5:.9f},2e-05,,0x1234,,,,')
        rows.append(f'"CAN","ack_field",{time + 1e-4:.9f},2e-06,true,,,,,')
    return "\n".join(rows) + "\n"


def slcan(*, timed):
    """As adapters of Lawicel's protocol send frames, with a clock of 60 s or without."""

    def line(each):
        stamp = f"{round(1e3 * each.timestamp) % 60_000:04X}" if timed else ""
        kind = "T" if each.is_extended_id else "t"
        return f"{kind}{identifier(each)}{each.dlc}{hexadecimal(each, '')}{stamp}\r"

    return lambda frames: "".join(map(line, frames)) + "\n"


# python-can


def python_can(frames):
    """Written by python-can by the ending of the file."""

    def write(file):
        with can.Logger(file) as writer:
            for each in frames:
                writer(each)

    return write


def blf(frames):
    """A .blf in a file that is not called so."""

    def write(file):
        python_can(frames)(file.with_suffix(".blf"))
        file.with_suffix(".blf").rename(file)

    return write


def database(frames):
    """As python-can's writer makes it, which loses the last frames."""

    def write(file):
        connection = sqlite3.connect(file)
        columns = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, "
        columns += "error INTEGER, dlc INTEGER, data BLOB"
        connection.execute(f"CREATE TABLE messages ({columns})")
        rows = [
            (each.timestamp, each.arbitration_id, each.is_extended_id, 0, 0, each.dlc, each.data)
            for each in frames
        ]
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        connection.commit()
        connection.close()

    return write


ADDED_UP, NUMBERED = ("they are added up",), ("frames are numbered in their place",)
DIALECTS = {
    "candump -L": Dialect("a.log", candump_log()),
    "candump -L without its ending": Dialect("trace", candump_log()),
    "candump -L -x": Dialect("a.log", candump_log(extra=True)),
    "candump -L -N": Dialect("a.log", candump_log("N")),
    "candump -L -tz": Dialect("a.log", candump_log("z")),
    "candump -L -td": Dialect("a.log", candump_log("d"), remarks=ADDED_UP),
    "candump -L -tA -x": Dialect("a.log", candump_log("A", extra=True)),
    "candump -L without times": Dialect("a.log", candump_log(""), timed=False, remarks=NUMBERED),
    "candump": Dialect("a.log", candump_terminal(), timed=False, remarks=NUMBERED),
    "candump -x": Dialect("a.log", candump_terminal(extra=True), timed=False, remarks=NUMBERED),
    "candump -ta": Dialect("a.log", candump_terminal("a")),
    "candump -td": Dialect("a.log", candump_terminal("d"), remarks=ADDED_UP),
    "candump -tz": Dialect("a.log", candump_terminal("z")),
    "candump -tA": Dialect("a.txt", candump_terminal("A")),
    "candump -ta -x": Dialect("a.log", candump_terminal("a", extra=True)),
    "candump -td -x": Dialect("a.log", candump_terminal("d", extra=True), remarks=ADDED_UP),
    "candump -tA -x": Dialect("a.log", candump_terminal("A", extra=True)),
    "candump -ta -N": Dialect("a.log", candump_terminal("N")),
    "candump -ta -a": Dialect("a.log", candump_terminal("a", after="   '..1A.c..'")),
    "candump -ta -8": Dialect("a.log", candump_terminal("a", body="{{{count}}} {data}")),
    "candump -ta -i": Dialect("a.log", candump_terminal("a", body="[{count}] {bits}")),
    "candump -ta -S": Dialect("a.log", candump_terminal("a", body="[{count}]  {swapped}")),
    ".asc": Dialect("a.asc", asc()),
    ".asc, decimal": Dialect("a.asc", asc("dec")),
    ".asc, relative": Dialect("a.asc", asc(relative=True), remarks=ADDED_UP),
    ".asc, relative and decimal": Dialect("a.asc", asc("dec", relative=True), remarks=ADDED_UP),
    ".asc, German": Dialect("a.asc", asc(day="Mo Mär 13 22:13:20.000 2023")),
    ".asc, CANFD": Dialect("a.asc", asc(long=True)),
    ".asc, CANFD, relative": Dialect("a.asc", asc(long=True, relative=True), remarks=ADDED_UP),
    ".asc with other events": Dialect("a.asc", asc(others=ASC_OTHERS)),
    ".asc with other events, relative": Dialect(
        "a.asc", asc(others=ASC_OTHERS, relative=True), remarks=ADDED_UP
    ),
    ".asc without its ending": Dialect("a.txt", asc()),
    ".trc 1.0": Dialect("a.trc", trc("1.0"), 1e-3),
    ".trc 1.1": Dialect("a.trc", trc("1.1"), 1e-4),
    **{f".trc {each}": Dialect("a.trc", trc(each)) for each in ("1.2", "1.3", "2.0", "2.1")},
    ".trc without its ending": Dialect("a.log", trc("2.1")),
    "BUSMASTER": Dialect("a.log", busmaster(), 1e-4),
    "BUSMASTER, absolute": Dialect("a.log", busmaster(mode="ABSOLUTE MODE"), 1e-4),
    "BUSMASTER, decimal": Dialect("a.log", busmaster("DEC"), 1e-4),
    "BUSMASTER, relative": Dialect(
        "a.log", busmaster(mode="RELATIVE MODE"), 1e-4, remarks=ADDED_UP
    ),
    "SavvyCAN": Dialect("a.csv", savvycan()),
    "SavvyCAN, older": Dialect("a.csv", savvycan(way=False)),
    "SavvyCAN without its ending": Dialect("a.log", savvycan()),
    "Kvaser": Dialect("a.csv", kvaser_table(16)),
    "Kvaser, decimal": Dialect("a.csv", kvaser_table(10)),
    "CanKing": Dialect("a.txt", canking),
    "CL2000": Dialect("a.txt", cl2000, 1e-3),
    "CANedge": Dialect("a.csv", canedge),
    "Saleae": Dialect("a.csv", saleae),
    "slcan": Dialect("a.txt", slcan(timed=True), 1e-3),
    "slcan without times": Dialect("a.log", slcan(timed=False), timed=False, remarks=NUMBERED),
    "pcap": Dialect("a.pcap", pcap()),
    "pcap without its ending": Dialect("a.log", pcap()),
    "pcap, other order, ns": Dialect("a.pcap", pcap(">", 0xA1B23C4D, unit=1e-9)),
    "pcap of any device": Dialect("a.pcap", pcap(link=SLL)),
    "pcap of any device, other order": Dialect("a.pcap", pcap(">", link=SLL)),
    "pcap of any device, SLL2": Dialect("a.pcap", pcap(link=SLL2)),
    "pcapng": Dialect("a.pcapng", pcapng()),
    "pcapng, other order, ns": Dialect("a.pcapng", pcapng(">", 9)),
    "pcapng of any device": Dialect("a.pcapng", pcapng(link=SLL)),
    "pcapng of any device, SLL2": Dialect("a.pcapng", pcapng(">", link=SLL2)),
    "python-can .asc": Dialect("a.asc", python_can),
    "python-can .blf": Dialect("a.blf", python_can),
    "python-can .blf without its ending": Dialect("trace", blf),
    "python-can .csv": Dialect("a.csv", python_can),
    "python-can .db": Dialect("a.db", database, remarks=("of the bus may be missing",)),
    "python-can .log": Dialect("a.log", python_can),
    "python-can .trc": Dialect("a.trc", python_can),
    "python-can .txt": Dialect("a.txt", python_can),
    "python-can .mf4": Dialect("a.mf4", python_can),
}
"""Every format that is read."""
