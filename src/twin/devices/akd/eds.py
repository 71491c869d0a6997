"""Electronic data sheets of CANopen devices (EDS), and files of configured ones (DCF), of CiA 306.

Both are text in sections with ``key=value`` lines. What cannot be read (a line, a section, an
object or a value) is left out with a remark; the rest is used.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from twin.base.errors import LogError, list_first
from twin.base.foreign import HEAD_BYTES, decode_text, file_kind, with_article
from twin.devices.akd.protocol import PDO_PARAMETER_INDICES, Key, Object

_CIA301_TYPES = {
    0x01: "U1", 0x02: "I8", 0x03: "I16", 0x04: "I32", 0x05: "U8", 0x06: "U16", 0x07: "U32",
    0x08: "F32", 0x09: "S0", 0x0A: "B0", 0x0B: "B0", 0x0C: "B48", 0x0D: "B48", 0x0F: "B0",
    0x10: "I24", 0x11: "F64", 0x12: "I40", 0x13: "I48", 0x14: "I56", 0x15: "I64", 0x16: "U24",
    0x18: "U40", 0x19: "U48", 0x1A: "U56", 0x1B: "U64",
}  # fmt: skip
"""Data types of CiA 301 as `Object` has them."""
_DEFAULTS_USED = frozenset((*PDO_PARAMETER_INDICES, 0x1000, 0x1018))
"""Objects of which the default is used: parameters and mappings of PDOs, profile, identity."""
_MAX_SHOWN_REMARKS = 5
"""Remarks about single lines and values that are shown; of more the number is."""

_LARGEST_NUMBERS = {"VendorNumber": 0xFFFF_FFFF, "NodeID": 127}
"""Largest numbers of a vendor and of a node."""

_BLANKS = " \t\r\n\0\x1a"
"""Characters around a line that mean nothing; the last was the end of a file in DOS."""
_NODE_ID = re.compile(r"\$?\(?node[-_ ]?id\)?")
"""``$NODEID`` in small letters, as different editors write it."""

_Section = dict[str, str]


@dataclass(frozen=True)
class Value:
    """An object as the file describes it.

    Attributes:
        number: The number.
        relative: Whether the number of the node is to be added (``$NODEID``).
    """

    number: int
    relative: bool

    def of_node(self, node: int) -> int:
        """The number in a given node."""
        return self.number + node * self.relative


@dataclass(frozen=True)
class DataSheet:
    """The content of an EDS or DCF of a device.

    Attributes:
        objects: Its objects by index and subindex, with name and type.
        defaults: What `_DEFAULTS_USED` hold before anybody writes them.
        values: What the objects of a configured device hold (``ParameterValue`` of a DCF).
        node: Node that has these values; None if the file names no node.
        vendor: Number of the vendor; None if the file has none.
        remarks: What was left out, in a line each.
    """

    objects: dict[Key, Object] = field(default_factory=dict)
    defaults: dict[Key, Value] = field(default_factory=dict)
    values: dict[Key, Value] = field(default_factory=dict)
    node: int | None = None
    vendor: int | None = None
    remarks: tuple[str, ...] = ()

    def held_by(self, node: int) -> dict[Key, int]:
        """What the objects of a node hold by this file, as far as it may be such a device.

        The values of a configured device hold for its node alone. An identifier without ``$NODEID``
        belongs to the node that the file names; if it names none, to the node with the number in
        the identifier.

        Args:
            node: Number of the node.
        """
        held: dict[Key, int] = {}
        for key, value in self.defaults.items():
            if value.relative or not _is_cob_id(key) or value.number & 0x7F == node:
                held[key] = value.of_node(node)
        if self.node not in (None, node):
            return held
        for key, value in self.values.items():
            own = value.relative or self.node == node
            if own or not _is_cob_id(key) or value.number & 0x7F == node:
                held[key] = value.of_node(node)
        return held


def _is_cob_id(key: Key) -> bool:
    """Whether an object is the identifier of a PDO."""
    return key[0] in PDO_PARAMETER_INDICES and not key[0] & 0x200 and key[1] == 1


def read_data_sheet(path: Path) -> DataSheet:
    """Read an EDS or DCF file.

    Args:
        path: The file.

    Raises:
        LogError: If it cannot be opened, or has no object at all.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LogError(f"--eds {path}: cannot be read: {error.strerror or error}") from error
    text = decode_text(raw)
    left_out: list[str] = []
    sections = _split(text, left_out)
    objects: dict[Key, Object] = {}
    defaults: dict[Key, Value] = {}
    values: dict[Key, Value] = {}
    arrays = dict[int, tuple[int, _Section]]()
    for name, section in sections.items():
        match = re.fullmatch(r"([0-9a-f]{1,4})(?:sub([0-9a-f]{1,2}))?", name)
        if match is None or (match[2] is None and int(match[1], 16) < 0x1000):
            continue  # a list, a comment, what belongs to an array, or the definition of a type
        key = int(match[1], 16), int(match[2] or "0", 16)
        compact = _number(section.get("compactsubobj", "0")) or 0
        entries = f"{name}sub0" in sections or f"{name}sub1" in sections
        entries |= "subnumber" in section and "datatype" not in section
        if match[2] is None and entries and not compact:
            continue  # a record or an array: its entries have sections of their own
        if compact:
            arrays[key[0]] = min(compact, 0xFE), section
            continue
        its_type = _type(section, sections, name, left_out)
        if its_type is None:
            continue
        objects[key] = Object(*key, _name(key, section, sections), its_type)
        _hold(key, section, name, defaults, values, left_out)
    for index, (count, section) in arrays.items():
        _expand(index, count, section, sections, objects, defaults, values, left_out)
    if not objects:
        why = (
            f"it is {with_article(kind)}"
            if (kind := file_kind(raw[:HEAD_BYTES]))
            else "it has no object"
        )
        raise LogError(f"--eds {path}: not a readable EDS file: {why}")
    vendor = _read_number("VendorNumber", sections.get("deviceinfo", {}), left_out)
    identity = values.get((0x1018, 1), defaults.get((0x1018, 1)))
    commissioning = sections.get("devicecomissioning", sections.get("devicecommissioning", {}))
    return DataSheet(
        objects,
        defaults,
        values,
        _read_number("NodeID", commissioning, left_out),
        vendor or (identity and identity.number) or None,
        _remarks(path.name, left_out),
    )


def _split(text: str, left_out: list[str]) -> dict[str, _Section]:
    """The sections of a file by their names, both and the keys in small letters."""
    sections: dict[str, _Section] = {}
    section: _Section | None = None
    for number, each in enumerate(text.splitlines(), 1):
        line = each.strip(_BLANKS)
        if not line or line[0] in ";#":
            continue
        if match := re.match(r"\[\s*([^\]]*?)\s*\]", line):
            name = re.sub(r"\s|^0x|(?<=sub)0+(?=[0-9a-f])", "", match[1].casefold())
            if name in sections:
                left_out.append(f"line {number}: [{_short(match[1])}] comes again")
            section = sections.setdefault(name, {})
            continue
        if line[0] == "[":  # what follows belongs to no section that is known
            left_out.append(f"line {number}: '{_short(line)}'")
            section = {}
            continue
        key, equals, value = line.partition("=")
        if not equals or not key.strip() or section is None:
            left_out.append(f"line {number}: '{_short(line)}'")
            continue
        value = re.sub(r"(^|\s);.*$", "", value).strip()
        section.setdefault(key.strip().casefold(), _printable(value))
    return sections


def _short(text: str) -> str:
    """A text for a message: at most 30 characters, all of them printable."""
    shown = _printable(text)
    return shown if len(shown) <= 30 else f"{shown[:29]}..."


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _plain(text: str) -> str:
    """A number in small letters without what is written around it: comments, quotes, brackets."""
    bare = re.sub(r"\s*(;|//|/\*).*$|(?<=\w)\s+[#(].*$", "", text)
    return bare.strip(' \t"()').casefold()


def _number(text: str) -> int | None:
    """A number as CiA 306 writes it, in any case of letters, or as ``280h``; None if it is none.

    A leading zero means octal in CiA 306; ``001`` and the like are read so, ``08`` as decimal.
    """
    text = re.sub(r"[ul]+$", "", _plain(text))
    try:
        if re.fullmatch(r"[0-9a-f]+h", text):
            return int(text[:-1], 16)
        if re.fullmatch(r"0[0-7]+", text):
            return int(text, 8)
        return int(text, 10) if text.isdecimal() else int(text, 0)
    except ValueError:
        return None


def _read_number(key: str, section: _Section, left_out: list[str]) -> int | None:
    """A number of a section; a text that is none is left out."""
    text = section.get(key.casefold())
    if text is None:
        return None
    number = _number(text)
    octal = key == "VendorNumber" and re.fullmatch(r"0\d+", _plain(text))  # 001 names nobody
    if number is None or octal or not 0 <= number <= _LARGEST_NUMBERS[key]:
        left_out.append(f"{key}='{_short(text)}'")
        return None
    return number


def _type(
    section: _Section, sections: dict[str, _Section], name: str, left_out: list[str]
) -> str | None:
    """The type of an object; None if it is left out."""
    text = section.get("datatype", "")
    number = _number(text) if text else None
    if number is not None and number > 0x1B and f"{number:x}sub1" in sections:
        # CANFestival's editor: the type is the default of entry 1 of an object of that index
        number = _number(sections[f"{number:x}sub1"].get("defaultvalue", ""))
    kind = _number(section.get("objecttype", "7"))
    if kind == 2:  # DOMAIN
        return "B0"
    if number in _CIA301_TYPES:
        return _CIA301_TYPES[number]
    if not text:
        if "parametername" not in section:
            left_out.append(f"[{name}]: it has no DataType and no ParameterName")
            return None
        return "U0" if kind == 7 else None
    if number is not None:
        return "B0"
    left_out.append(f"[{name}] DataType='{_short(text)}'")
    return "U0" if "parametername" in section else None


def _name(key: Key, section: _Section, sections: dict[str, _Section]) -> str:
    """Name of an object; an entry of a record or array is preceded by the name of the object."""
    own = section.get("denotation") or section.get("parametername", "")
    around = sections.get(f"{key[0]:x}", {})
    whole = "" if around is section else around.get("parametername", "")
    return ": ".join(part for part in (whole, own) if part)


def _hold(
    key: Key,
    section: _Section,
    name: str,
    defaults: dict[Key, Value],
    values: dict[Key, Value],
    left_out: list[str],
) -> None:
    """Note the default of an object, and its value in a configured device."""
    for entry, kept in (("DefaultValue", defaults), ("ParameterValue", values)):
        text = section.get(entry.casefold(), "")
        if not text or (kept is defaults and key[0] not in _DEFAULTS_USED):
            continue
        if (value := _value(text)) is not None:
            kept[key] = value
        elif key[0] in _DEFAULTS_USED:
            left_out.append(f"[{name}] {entry}='{_short(text)}'")


def _value(text: str) -> Value | None:
    """A value: numbers, and ``$NODEID`` once at most, added in any order and case of letters."""
    parts = [part.strip() for part in _plain(text).split("+")]
    others = [_number(part) for part in parts if not _NODE_ID.fullmatch(part)]
    count = len(parts) - len(others)
    numbers = [number for number in others if number is not None]
    if count > 1 or len(numbers) < len(others) or not 0 <= sum(numbers) < 1 << 64:
        return None
    return Value(sum(numbers), relative=count == 1)


def _expand(
    index: int,
    count: int,
    section: _Section,
    sections: dict[str, _Section],
    objects: dict[Key, Object],
    defaults: dict[Key, Value],
    values: dict[Key, Value],
    left_out: list[str],
) -> None:
    """The entries of an array that is described as one (``CompactSubObj``).

    Their names are in a section ``[1003Name]``, in a configured device in ``[1003Denotation]``, and
    their values in ``[1003Value]``; one without a name there is called by its number.
    """
    name = f"{index:x}"
    kind = _type(section, sections, name, left_out)
    if kind is None:
        return
    called = section.get("parametername", "")
    objects[index, 0] = Object(index, 0, f"{called}: number of entries", "U8")
    names = sections.get(f"{name}name", {}) | sections.get(f"{name}denotation", {})
    own_values = sections.get(f"{name}value", {})
    for sub in range(1, count + 1):
        own = names.get(f"{sub}") or f"{sub}"
        objects[index, sub] = Object(index, sub, f"{called}: {own}", kind)
        its = {"defaultvalue": section.get("defaultvalue", "")}
        its["parametervalue"] = own_values.get(f"{sub}", "")
        _hold((index, sub), its, name, defaults, values, left_out)
    if index in PDO_PARAMETER_INDICES and index & 0x200:
        defaults.setdefault((index, 0), Value(count, relative=False))


def _remarks(file: str, left_out: list[str]) -> tuple[str, ...]:
    """The parts that were left out, in one line."""
    if not left_out:
        return ()
    shown = list_first(left_out, _MAX_SHOWN_REMARKS, "; ")
    return (f"{file}: not readable and left out: {shown}",)
