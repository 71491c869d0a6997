"""The trace of a rig on which something goes wrong: emulated drives in bus time, no hardware."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from twin.emulator.can_bus import Towards
from twin.emulator.drive_objects import Frame
from twin.emulator.lockstep import LockstepRig
from twin.run.controller_building import build_controller
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario.load import load

BEFORE, LAST = 0.5, 3.0
"""How long before the fault PDOs are lost for a moment, and how long the run lasts, s."""


class Trace(NamedTuple):
    """What was said on a bus, oldest first: bus times in s, and frames."""

    times: list[float]
    frames: list[Frame]


def recorded(point: Mapping[str, float | str]) -> Trace:
    """The trace of a rig: it follows a circle, loses frames for a moment, and then has a fault.

    Args:
        point: ``wire.fault``, ``wire.node``, ``wire.begins`` in s, and ``wire.lost``, how many
            PDOs of that node are lost before.
    """
    scenario = load(str(Path(__file__).with_name("circle.toml")))
    rig = LockstepRig(scenario)
    bus, trace = rig.lockstep.bus, Trace([], [])
    sent, received, moved = bus.from_host, bus.to_host, bus.moved

    def note(frames: list[Frame]) -> list[Frame]:
        trace.times.extend([bus.time] * len(frames))
        trace.frames.extend(frames)
        return frames

    def from_host(frame: Frame) -> bool:
        note([frame])
        return sent(frame)

    node, begins = int(point["wire.node"]), float(point["wire.begins"])
    waiting = [(begins - BEFORE, lambda: lose(rig, node, int(point["wire.lost"])))]
    waiting.append((begins, lambda: fail(rig, node, str(point["wire.fault"]))))

    def move(dt: float) -> None:
        moved(dt)
        while waiting and bus.time >= waiting[0][0]:
            waiting.pop(0)[1]()

    bus.from_host, bus.to_host, bus.moved = from_host, lambda: note(received()), move
    record = Recorder(round(LAST / rig.period), 1, rig.period)
    drive(rig, build_controller(scenario), LAST, record)
    rig.sleep(0.3)  # what drives say of it afterwards
    return trace


def lose(rig: LockstepRig, node: int, count: int) -> None:
    """Lose so many PDOs of a node in a row."""
    rig.lockstep.bus.faults.drop(0x180 + node, lasting=count * rig.period)


def fail(rig: LockstepRig, node: int, fault: str) -> None:
    """Let a fault begin."""
    faulty, faults = rig.lockstep.drives[node - 1], rig.lockstep.bus.faults
    if fault == "silent":
        faults.silence(node)
    elif fault == "heartbeat":
        faults.drop(0x700 + node, towards=Towards.HOST)
    elif fault == "drive fault":
        faulty.fail(235)
    elif fault == "reboot":
        faulty.reboot()
    elif fault == "pre-operational":
        faulty.nmt = 127


def written(point: Mapping[str, float | str], folder: Path) -> None:
    """Write the trace of a rig as ``bus.log``, in the form of candump."""
    times, frames = recorded(point)
    lines = (
        f"({time:017.6f}) can0 {frame.cob_id:03X}#{frame.data.hex().upper()}\n"
        for time, frame in zip(times, frames, strict=True)
    )
    (folder / "bus.log").write_text("".join(lines), encoding="utf-8")
