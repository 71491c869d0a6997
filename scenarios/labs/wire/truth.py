"""What is to be found in the trace of a rig."""

from collections.abc import Mapping
from pathlib import Path
from runpy import run_path

CYCLE, HEARTBEAT = 0.002, 0.02
"""How often PDOs and heartbeats come, s."""
DEMANDED = 20.0
"""Time within which a silent drive must be found, ms."""
Point = Mapping[str, float | str]


def node(point: Point, folder: Path) -> str:
    """The node whose drive has the fault."""
    return f"{point['wire.node']:g}"


def begins(point: Point, folder: Path) -> float:
    """Time of the first frame that is wrong, or ought to have come, s."""
    return _found(point)[0]


def detected_ms(point: Point, folder: Path) -> float:
    """From then to the first command that stops a drive, ms."""
    begun, stopped = _found(point)
    return 1000 * (stopped - begun)


def pause_ms(point: Point, folder: Path) -> float:
    """The longest time between two PDOs while all was well, ms: so many were lost in a row."""
    return 1000 * CYCLE * (float(point["wire.lost"]) + 1)


def watch_ms(point: Point, folder: Path) -> float:
    """Half way from the longest pause to what the demand leaves when one looks every cycle, ms."""
    return (pause_ms(point, folder) + DEMANDED - 1000 * CYCLE) / 2


def _found(point: Point) -> tuple[float, float]:
    """Times of the first frame that is wrong or missing, and of the command that stops, s."""
    trace = run_path(str(Path(__file__).with_name("trace.py")))["recorded"](point)
    said = list(zip(trace.times, trace.frames, strict=True))
    number, fault, after = int(point["wire.node"]), point["wire.fault"], point["wire.begins"]
    stopped = next(
        time
        for time, frame in said
        if time > after and frame.cob_id in {0x201, 0x202} and frame.data[0] != 0x0F
    )
    pdos = [each for each in said if each[1].cob_id == 0x180 + number]
    beats = [each for each in said if each[1].cob_id == 0x700 + number]
    if fault == "drive fault":
        return next(time for time, frame in pdos if time > after and frame.data[0] & 8), stopped
    if fault == "reboot":
        return next(time for time, frame in beats if time > after and frame.data[0] == 0), stopped
    watched, every = (beats, HEARTBEAT) if fault == "heartbeat" else (pdos, CYCLE)
    return max(time for time, _ in watched if time < stopped) + every, stopped
