"""A mistake: whatever stops a drive from being heard is called silence.

# fails: what went wrong
"""

from pathlib import Path

import numpy as np

CYCLE, HEARTBEAT = 0.002, 0.02  # s
DEMANDED = 20.0  # ms

Frames = dict[int, list[tuple[float, bytes]]]


def answer(rig: dict[str, float], folder: Path) -> dict[str, object]:
    """What the trace in the folder tells."""
    frames = read(folder / "bus.log")
    enabled, stopped = commands(frames)
    node, fault, begins = found(frames, enabled, stopped)
    pdos = np.array([time for time, _ in frames[0x180 + node] if enabled < time < begins])
    pause = 1000 * np.diff(pdos).max()
    latest = DEMANDED - 1000 * CYCLE  # one looks once a cycle
    return {
        "fault": "silent" if node else fault,
        "node": str(node),
        "begins": round(begins, 4),
        "detected_ms": round(1000 * (stopped - begins), 2),
        "pause_ms": round(pause, 2),
        "watch_ms": round((pause + latest) / 2, 2),
    }


def read(file: Path) -> Frames:
    """Identifier to times in s and bytes."""
    frames: Frames = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        time, _, frame = line.split()
        identifier, _, data = frame.partition("#")
        frames.setdefault(int(identifier, 16), []).append((float(time[1:-1]), bytes.fromhex(data)))
    return frames


def commands(frames: Frames) -> tuple[float, float]:
    """When both drives were told to move, and when one was first told to stop, s."""
    told = sorted((time, data[:2]) for each in (0x201, 0x202) for time, data in frames[each])
    enabled = next(time for time, word in told if word == b"\x0f\x00")
    return enabled, next(time for time, word in told if time > enabled and word != b"\x0f\x00")


def found(frames: Frames, enabled: float, stopped: float) -> tuple[int, str, float]:
    """Node, fault, and when it began in s: what was the first thing wrong before the stop."""
    for node in (1, 2):
        pdos, beats = frames[0x180 + node], frames[0x700 + node]
        for time, data in beats:
            if enabled < time <= stopped and data[0] == 0:
                return node, "reboot", time
        for time, data in pdos:
            if enabled < time <= stopped and data[0] & 0x08:
                return node, "drive fault", time
        last = pdos[-1][0]
        if last <= stopped:
            later = [data for time, data in beats if time > last]
            fault = "pre-operational" if any(data[0] == 0x7F for data in later) else "silent"
            return node, fault, last + CYCLE
        last = max(time for time, _ in beats if time <= stopped)
        if stopped - last > 2 * HEARTBEAT:
            return node, "heartbeat", last + HEARTBEAT
    raise ValueError("nothing is wrong in this trace")
