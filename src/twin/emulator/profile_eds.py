"""The electronic data sheet (EDS, CiA 306) of the emulated plain CiA 402 drive."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from twin.emulator.drive_objects import PDO_ENTRIES, DriveObject, read_objects
from twin.emulator.profile_objects import profile_table

FILE_NAME = "ballplate-cia402.eds"

_CIA301_TYPE_CODES = {"I8": 2, "I16": 3, "I32": 4, "U8": 5, "U16": 6, "U32": 7, "S": 9}
"""Data types of CiA 301."""
_ARRAY, _RECORD = 8, 9
_MANDATORY_OBJECTS = {0x1000, 0x1001, 0x1018}
_RATES_KBIT_S = (10, 20, 50, 125, 250, 500, 800, 1000)
_DATE, _TIME = "11-29-2026", "12:00AM"


def eds_text() -> str:
    """The text of the EDS, from the table of the drive's objects."""
    objects = read_objects(profile_table(), 0)
    indices = sorted({index for index, _ in objects})
    kinds = {
        "MandatoryObjects": [each for each in indices if each in _MANDATORY_OBJECTS],
        "OptionalObjects": [
            each
            for each in indices
            if each not in _MANDATORY_OBJECTS and not 0x2000 <= each < 0x6000
        ],
        "ManufacturerObjects": [each for each in indices if 0x2000 <= each < 0x6000],
    }
    lines = list(_head())
    for name, members in kinds.items():
        listed = [f"{number}=0x{index:04X}" for number, index in enumerate(members, 1)]
        lines += [f"[{name}]", f"SupportedObjects={len(members)}", *listed, ""]
        for index in members:
            lines += _index(
                index, {sub: each for (at, sub), each in objects.items() if at == index}
            )
    return "\n".join(lines)


def _head() -> Iterator[str]:
    yield from _section(
        "FileInfo",
        FileName=FILE_NAME,
        FileVersion=1,
        FileRevision=0,
        EDSVersion="4.0",
        Description="Emulated plain CiA 402 drive",
        CreationTime=_TIME,
        CreationDate=_DATE,
        CreatedBy="ballplate",
        ModificationTime=_TIME,
        ModificationDate=_DATE,
        ModifiedBy="ballplate",
    )
    yield from _section(
        "DeviceInfo",
        VendorName="ballplate",
        VendorNumber="0x0",
        ProductName="Emulated CiA 402 drive",
        ProductNumber="0x402",
        RevisionNumber="0x10000",
        OrderCode="none",
        **{f"BaudRate_{rate}": 1 for rate in _RATES_KBIT_S},
        SimpleBootUpMaster=0,
        SimpleBootUpSlave=1,
        Granularity=8,
        DynamicChannelsSupported=0,
        GroupMessaging=0,
        NrOfRXPDO=4,
        NrOfTXPDO=4,
        LSS_Supported=0,
    )
    yield from _section("DummyUsage", **{f"Dummy{number:04d}": 0 for number in range(1, 8)})
    yield from _section(
        "Comments", Lines=1, Line1="Counts, counts/s, counts/s^2; 65536 counts per revolution."
    )


def _index(index: int, entries: dict[int, DriveObject]) -> Iterator[str]:
    """The sections of an index with its subindices."""
    for kind, number in (("arrays", _ARRAY), ("records", _RECORD)):
        if name := profile_table()[kind].get(f"{index:04X}"):
            section = {"ParameterName": name, "ObjectType": f"0x{number:X}"}
            yield from _section(f"{index:04X}", **section, SubNumber=len(entries))
            for sub, each in sorted(entries.items()):
                yield from _variable(f"{index:04X}sub{sub:X}", index, sub, each)
            return
    yield from _variable(f"{index:04X}", index, 0, entries[0])


def _variable(section: str, index: int, sub: int, entry: DriveObject) -> Iterator[str]:
    limits = {}
    if entry.low is not None:
        limits["LowLimit"] = entry.low
    if entry.high is not None:
        limits["HighLimit"] = entry.high
    if f"{index:04X}" in profile_table()["mappings"] and sub == 0:
        limits = {"LowLimit": 0, "HighLimit": PDO_ENTRIES}
    yield from _section(
        section,
        ParameterName=entry.text,
        ObjectType="0x7",
        DataType=f"0x{_CIA301_TYPE_CODES[entry.type]:04X}",
        AccessType=entry.access,
        DefaultValue=_default(index, sub, entry),
        PDOMapping=int(entry.pdo),
        **limits,
    )


def _default(index: int, sub: int, entry: DriveObject) -> str:
    if entry.type == "S":
        return entry.content
    row = profile_table()["objects"].get(f"{index:04X}:{sub}")
    given = row[3] if row else entry.default
    if isinstance(given, str):
        return f"$NODEID+{given.removeprefix('node+')}"
    return str(given) if index >= 0x2000 else f"0x{given:X}"


def _section(name: str, **lines: object) -> Iterable[str]:
    return [f"[{name}]", *(f"{key}={value}" for key, value in lines.items()), ""]
