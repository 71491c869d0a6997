"""Files of other programs: what their first bytes say that they are, and the text in them."""

from __future__ import annotations

import re
import zipfile
from contextlib import suppress
from pathlib import Path

HEAD_BYTES = 512
"""Number of bytes at the beginning of a file that identify its kind."""
_FILE_KINDS: tuple[tuple[bytes, int, str], ...] = (
    (b"MATLAB 5.0 MAT-file", 0, "MATLAB file"),
    (b"\x89HDF\r\n\x1a\n", 0, "HDF5 file"),
    (b"HDF", 1, "HDF5 file"),
    (b"\x89HDF\r\n\x1a\n", 512, "HDF5 file"),
    (b"\x93NUMPY", 0, "NumPy array"),
    (b"PAR1", 0, "Parquet file"),
    (b"ARROW1", 0, "Arrow file"),
    (b"\xff\xff\xff\xff", 0, "Arrow stream"),
    (b"\x89MCAP0\r\n", 0, "MCAP file"),
    (b"#ROSBAG", 0, "ROS bag"),
    (b"SQLite format 3\0", 0, "SQLite database"),
    (b"PK\x03\x04", 0, "ZIP archive"),
    (b"PK\x05\x06", 0, "ZIP archive"),
    (b"\x1f\x8b", 0, "gzip file"),
    (b"BZh", 0, "bzip2 file"),
    (b"\xfd7zXZ\0", 0, "xz file"),
    (b"7z\xbc\xaf\x27\x1c", 0, "7-Zip archive"),
    (b"\x28\xb5\x2f\xfd", 0, "Zstandard file"),
    (b"Rar!", 0, "RAR archive"),
    (b"ustar", 257, "tar archive"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", 0, "Excel file (.xls)"),
    (b"RRF", 0, "Rerun recording"),
    (b"%PDF", 0, "PDF file"),
    (b"\x89PNG\r\n", 0, "PNG picture"),
    (b"\xff\xd8\xff", 0, "JPEG picture"),
    (b"RIFF", 0, "RIFF file (.avi or .wav)"),
    (b"ftyp", 4, "MP4 film"),
    (b"LOGG", 0, "CAN trace of Vector (.blf)"),
    (b"MDF     ", 0, "measurement file (.mf4)"),
    (b"UnFinMF ", 0, "measurement file (.mf4)"),
    (b"\x0a\x0d\x0d\x0a", 0, "pcapng capture"),
    (b"\xd4\xc3\xb2\xa1", 0, "pcap capture"),
    (b"\xa1\xb2\xc3\xd4", 0, "pcap capture"),
    (b"\x4d\x3c\xb2\xa1", 0, "pcap capture"),
    (b"\xa1\xb2\x3c\x4d", 0, "pcap capture"),
    (b"TDSm", 0, "LabVIEW file (.tdms)"),
    (b"# Created by Octave", 0, "text file of Octave"),
    (b"\x80\x02", 0, "Python pickle"),
    (b"\x80\x03", 0, "Python pickle"),
    (b"\x80\x04\x95", 0, "Python pickle"),
    (b"\x80\x05\x95", 0, "Python pickle"),
)
"""First bytes of a kind of file, their offset, and the name of the kind."""
_IN_ZIP = (
    (b"xl/", "Excel file (.xlsx)"),
    (b"[Content_Types].xml", "Excel file (.xlsx)"),
    (b".npy", "NumPy archive (.npz)"),
    (b"mimetype", "OpenDocument file (.ods)"),
)
_BYTE_ORDER_MARKS = {
    b"\xff\xfe\0\0": "utf-32",
    b"\0\0\xfe\xff": "utf-32",
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
    b"\xef\xbb\xbf": "utf-8-sig",
}
"""Marks at the beginning of a text, and its encoding."""
_MIN_WIDE_SHARE = 0.7
"""Share of zeros in every second byte above which a text without a mark is UTF-16."""
_CONTROL_BYTES = bytes({*range(32)} - {*b"\a\t\n\v\f\r\x1a\x1b"})
"""Bytes that are in no text of eight bits."""
_MOST_UNPRINTED = 0.02
"""Share of such bytes that a text may have by mishap."""


def file_kind(head: bytes) -> str:
    """Kind of a file by its first bytes; empty for text and for unknown kinds.

    Args:
        head: Its first ``HEAD_BYTES`` bytes or more; all of a shorter file.
    """
    for mark, at, kind in _FILE_KINDS:
        if head[at : at + len(mark)] == mark:
            if kind == "ZIP archive":
                return next((what for name, what in _IN_ZIP if name in head), kind)
            return kind
    encoding = encoding_of(head)
    if encoding not in {"utf-8", "utf-8-sig"}:
        head = head.decode(encoding, errors="replace").encode()
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if re.match(rb"\{|\[\s*[\[{\"]|\[\s*\n", text):
        return "JSON file"
    if text[:9].lower().startswith((b"<?xml", b"<!doctype", b"<html")):
        return "XML or HTML file"
    unprinted = sum(byte in _CONTROL_BYTES for byte in head)
    if unprinted > _MOST_UNPRINTED * len(head):
        return "binary file of a kind not known here"
    return ""


def with_article(kind: str) -> str:
    """A kind of file with its article."""
    return f"an {kind}" if kind[0] in "AEHOX" or kind.startswith("MCAP") else f"a {kind}"


def kind_of(path: Path) -> str:
    """Kind of a file by its first bytes, as in ``file_kind``.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES + 16)
    kind = file_kind(head)
    if kind == "ZIP archive":  # which entry is the first differs between programs
        with suppress(zipfile.BadZipFile, NotImplementedError), zipfile.ZipFile(path) as archive:
            return file_kind(head + "".join(archive.namelist()[:1000]).encode())
    return kind


def encoding_of(head: bytes) -> str:
    """Encoding of a text by the mark at its beginning, of UTF-16 also by its zeros; else UTF-8."""
    for mark, name in _BYTE_ORDER_MARKS.items():
        if head.startswith(mark):
            return name
    even, odd = head[:HEAD_BYTES:2], head[1:HEAD_BYTES:2]
    for zeros, others, name in ((odd, even, "utf-16-le"), (even, odd, "utf-16-be")):
        if zeros.count(0) > _MIN_WIDE_SHARE * len(head[:HEAD_BYTES]) / 2 and not others.count(0):
            return name
    return "utf-8"


def decode_text(raw: bytes) -> str:
    """Text in UTF-8, or UTF-16 or UTF-32 by its beginning, else as Windows writes it.

    The encoding of this computer plays no part.
    """
    try:
        return raw.decode(encoding_of(raw))
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")
