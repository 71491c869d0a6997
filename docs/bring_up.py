"""Writes bring-up.md and bring-up-report.md of this folder: python docs/bring_up.py.

The text is bring-up.template.md; a line ``{{ command | pattern }}`` stands for what a command says
on the virtual rig, all of it or only the lines that a pattern finds. On a busy machine the
emulated drives answer late, and the page is not written.
"""

import os
import re
import subprocess
import sys
from functools import cache
from tempfile import TemporaryDirectory

from docs.pages import HERE, write

PLACE = re.compile(r"^\{\{ (?P<command>[^|}]+?)(?: \| (?P<pattern>.+?))? \}\}$", re.MULTILINE)
PORTS = ((r"/tmp/\S*slcan", "/dev/ttyACM0"), (r"/tmp/\S*lumio", "/dev/ttyUSB0"))
TRIES = 5


@cache
def said(command: str) -> str:
    """What a command says on the virtual rig, standard output and error; it must succeed.

    Raises:
        SystemExit: It fails however often it is tried.
    """
    for _ in range(TRIES):
        with TemporaryDirectory() as folder:
            for each in command.split(" && "):
                done = subprocess.run(
                    [sys.executable, "-m", "twin", *each.split()],
                    cwd=folder,
                    env={**os.environ, "COLUMNS": "100", "NO_COLOR": "1"},
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    check=False,
                )
                if done.returncode:
                    break
        if done.returncode == 0 and "fault at" not in done.stdout:
            text: str = done.stdout
            for pattern, port in PORTS:
                text = re.sub(pattern, port, text)
            return text
    raise SystemExit(f"{command}: {done.stdout}")


def shown(place: re.Match[str]) -> str:
    """The lines that stand in a place of the page."""
    lines = said(place["command"]).splitlines()
    found = [line for line in lines if re.search(place["pattern"] or "", line)]
    if not found:
        raise SystemExit(f"{place['command']}: no line with {place['pattern']!r}")
    return "\n".join(found)


def main() -> None:
    """Run the commands and write the page."""
    text = (HERE / "bring-up.template.md").read_text(encoding="utf-8")
    write(HERE / "bring-up.md", PLACE.sub(shown, text))


if __name__ == "__main__":
    main()
