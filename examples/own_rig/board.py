"""The board of `arduino.py`, emulated on a pseudo-terminal: try the class before there is a rig.

    uv run python examples/own_rig/board.py --write rig.toml
    uv run ballplate run hold --rig rig.toml --set duration=10

Ping-pong ball on a plate of 300 mm, hobby servos that go to a position, a camera of 60 frames/s
that is late. It is written without the twin: a second opinion on it. Its friction brakes each axis
by itself, as a first guess has it; a real ball, and the twin's, is braked against its way. So a law
against friction leaves an error here that its run on the twin does not have.
"""

import argparse
import math
import os
import random
import select
import time
import tty
from collections import deque
from pathlib import Path

G, HOLLOW = 9.81, 3 / 5
FRAME, LATE, LAG, SLEW = 1 / 60, 0.03, 0.06, math.radians(200)
STEP, NOISE, FRICTION, WATCHDOG = 0.002, 0.0003, 0.004, 0.3


class Board:
    """Plate, ball, servos, camera; angles in rad, positions in m."""

    def __init__(
        self,
        seed: int,
        *,
        lag: float = LAG,
        late: float = LATE,
        noise: float = NOISE,
        friction: float = FRICTION,
    ) -> None:
        self.random = random.Random(seed)
        self.lag, self.late, self.noise, self.friction = lag, late, noise, friction
        self.goal, self.angle = [0.0, 0.0], [0.0, 0.0]
        self.ball, self.speed = [0.03, -0.02], [0.0, 0.0]
        self.frames: deque[tuple[float, str]] = deque()
        self.heard = -math.inf
        self.due = 0.0

    def hear(self, line: bytes, now: float) -> None:
        """Take a command whose sum is right."""
        text, _, check = line.decode("ascii", "replace").strip().partition("*")
        if text.startswith("P ") and check == f"{sum(text.encode()) % 256:02X}":
            self.goal = [math.radians(float(each)) for each in text[2:].split()]
            self.heard = now

    def step(self, now: float) -> list[str]:
        """Go on by a step; the lines that the camera has ready then."""
        if now - self.heard > WATCHDOG:
            self.goal = [0.0, 0.0]
        for axis, sign in enumerate((1, -1)):
            way = (self.goal[axis] - self.angle[axis]) * STEP / self.lag
            self.angle[axis] += max(-SLEW * STEP, min(SLEW * STEP, way))
            push = sign * HOLLOW * G * math.sin(self.angle[axis])
            speed = self.speed[axis]
            held = abs(push) < self.friction * G and abs(speed) < 0.002
            drag = math.copysign(self.friction * G, speed) if speed else 0.0
            self.speed[axis] = 0.0 if held else speed + STEP * (push - drag)
            self.ball[axis] += STEP * self.speed[axis]
        if now >= self.due:
            self.due = now + FRAME
            seen = [1000 * (each + self.random.gauss(0, self.noise)) for each in self.ball]
            on = max(map(abs, self.ball)) < 0.15
            self.frames.append(
                (now + self.late, "B {:.1f} {:.1f}".format(*seen) if on else "B - -")
            )
        ready = []
        while self.frames and self.frames[0][0] <= now:
            ready.append(self.frames.popleft()[1])
        return ready


def main() -> None:
    """Serve the board until it is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", type=Path, help="write the rig file with its port")
    parser.add_argument("--lose", type=float, default=0.0, help="share of bytes that get lost")
    parser.add_argument("--reset-at", type=float, default=math.inf, help="s: the board is reset")
    parser.add_argument("--silent-at", type=float, default=math.inf, help="s: it says nothing more")
    given = parser.parse_args()
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    port = os.ttyname(theirs)
    if given.write:
        text = Path(__file__).with_name("rig.toml").read_text(encoding="utf-8")
        backend = Path(__file__).with_name("arduino.py").resolve()
        text = text.replace("/dev/ttyUSB0", port).replace('"arduino.py', f'"{backend}')
        given.write.write_text(text, encoding="utf-8")
    print(port, flush=True)
    board, start, steps, rest, up = Board(1), None, 0, b"", True
    begin = time.monotonic()
    while True:
        if select.select([ours], [], [], 0.001)[0]:
            *lines, rest = (rest + os.read(ours, 4096)).split(b"\n")
            now = time.monotonic() - begin
            start = now if start is None else start  # the clock of the faults: since the first line
            for line in lines:
                board.hear(line, now)
        now = time.monotonic() - begin
        passed = -1.0 if start is None else now - start
        said = []
        if up and passed > given.reset_at:
            up, said, board.goal = False, ["READY"], [0.0, 0.0]
        while steps * STEP < now:
            steps += 1
            said += board.step(steps * STEP)
        if passed > given.silent_at or start is None:
            continue
        for text in said:
            line = f"{text}*{sum(text.encode()) % 256:02X}\n".encode()
            os.write(ours, bytes(each for each in line if board.random.random() >= given.lose))


if __name__ == "__main__":
    main()
