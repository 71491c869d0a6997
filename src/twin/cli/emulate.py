"""The command emulate: a virtual rig that other programs can open, on two ports."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twin.cli import completion as tab
from twin.cli.options import SETTING
from twin.cli.output import console
from twin.emulator.screen_bytes import Protocol
from twin.shipped import find
from twin.writing import write_whole

if TYPE_CHECKING:
    from twin.emulator.serve import VirtualRig


@click.command()
@click.argument("scenario", default="circle", shell_complete=tab.scenarios)
@SETTING
@click.option(
    "--protocol",
    type=click.Choice([str(protocol) for protocol in Protocol]),
    default=str(Protocol.MICROTOUCH),
    help="Protocol of the touch screen [microtouch].",
)
@click.option(
    "--write",
    "file",
    type=click.Path(path_type=Path),
    default=Path("emulated.toml"),
    help="Where to write the rig file [emulated.toml].",
)
def emulate(scenario: str, overrides: tuple[str, ...], protocol: str, file: Path) -> int:
    """Serve a virtual rig: two AKD drives on a USB-CAN adapter and a touch screen, both on ptys.

    It simulates a scenario's plant in real time. Type sto and release for its STO button, lift
    and put for the ball, touch X Y (mm) for a finger, unplug and plug for the screen, lag for how
    far it is behind the clock; Ctrl-C ends it.
    """
    find(scenario)  # a wrong name is told before anything heavy is imported
    from twin.emulator.process import come_forward
    from twin.emulator.serve import VirtualRig
    from twin.scenario import load

    with VirtualRig(load(scenario, overrides), Protocol(protocol)) as rig:
        text = toml(rig.tables())
        write_whole(file, lambda path: path.write_text(text, encoding="utf-8"))
        console.print(text, markup=False)
        console.print(f"written to {file}; use it with: ballplate run circle --rig {file}")
        come_forward()
        threading.Thread(target=_listen, args=(rig,), daemon=True).start()
        try:
            rig.server.run()
        except KeyboardInterrupt:
            console.print("ended")
    return 0


def toml(tables: dict[str, Any]) -> str:
    """A rig file's text; its values are texts, numbers and tables of those."""
    plain = [f"{key} = {json.dumps(v)}" for key, v in tables.items() if not isinstance(v, dict)]
    for key, table in tables.items():
        if isinstance(table, dict):
            plain += ["", f"[{key}]"]
            plain += [f"{name} = {_value(value)}" for name, value in table.items()]
    return "\n".join(plain) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        inner = ", ".join(f"{name} = {_value(each)}" for name, each in value.items())
        return f"{{ {inner} }}"
    return json.dumps(value)


def _listen(rig: VirtualRig) -> None:
    for line in sys.stdin:
        if line.strip():
            console.print(rig.obey(line.strip()))
