"""Programs that have a controller, or fail to: scripts that speak the frames by themselves."""

import sys

SCRIPT = """#!{python} -IS
import binascii, math, os, struct, sys, time

def frame(number, *content):
    body = struct.pack(f"<BH{{len(content)}}d", number, 8 * len(content), *content)
    return b"\\xb5" + body + struct.pack("<H", binascii.crc_hqx(body, 0))

def say(text):
    os.write(1, text)

def rest():
    time.sleep(60)

say({hello})
count = 0
while heard := sys.stdin.buffer.read(142):
    number, count = heard[1], count + 1
    measured = struct.unpack("<17d", heard[4:140])
    rate = {rate}
    answer = [*rate, 0.25, -0.25, *([0.5] * 8), 1.0, {instructions}]
    if count == {at}:
        {act}
    else:
        say(frame(number, *answer))
"""


def program(
    folder,
    *,
    hello="frame(0, 1.0, 0.002)",
    act="rest()",
    at=0,
    rate="(0.0, 0.0)",
    instructions="1000.0",
    name="program",
):
    """The file of a program that answers each measurement with a rate, and acts at one of them."""
    given = {"hello": hello, "act": act, "at": at, "rate": rate, "instructions": instructions}
    file = folder / name
    file.write_text(SCRIPT.format(python=sys.executable, **given), "utf-8")
    file.chmod(0o755)
    return file
