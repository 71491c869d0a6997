"""The board of `arduino.py`, emulated on a pseudo-terminal: try the class before there is a rig.

    uv run python examples/own_rig/board.py --write rig.toml
    uv run ballplate run hold --rig rig.toml --set duration=10

`--wire udp` is the board of `udp.py`; `--wire tcp` is that of `arduino.py` at `socket://HOST:PORT`.

Ping-pong ball on a plate of 300 mm, hobby servos that go to a position, a camera of 60 frames/s
that is late. It is written without the twin: a second opinion on it. Its friction brakes each axis
by itself, as a first guess has it; a real ball, and the twin's, is braked against its way. So a law
against friction leaves an error here that its run on the twin does not have.
"""

import argparse
import contextlib
import math
import os
import random
import select
import socket
import time
import tty
from collections import deque
from pathlib import Path

G, HOLLOW = 9.81, 3 / 5
FRAME, LATE, LAG, SLEW = 1 / 60, 0.03, 0.06, math.radians(200)
STEP, NOISE, FRICTION, WATCHDOG = 0.002, 0.0003, 0.004, 0.3


def with_sum(text: str) -> bytes:
    """A line with its check sum."""
    return f"{text}*{sum(text.encode()) % 256:02X}\n".encode()


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


class Pty:
    """A serial port."""

    backend, numbered = "arduino.py:Arduino", False

    def __init__(self) -> None:
        self.ours, theirs = os.openpty()
        tty.setraw(theirs)
        self.port = os.ttyname(theirs)
        self.options = f'{{ port = "{self.port}" }}'

    def fileno(self) -> int:
        """What `select` waits for."""
        return self.ours

    def hear(self) -> bytes:
        """What has arrived."""
        return os.read(self.ours, 4096)

    def say(self, line: bytes, lost: float, chance: random.Random) -> None:
        """Send a line of which a share of the bytes gets lost."""
        os.write(self.ours, bytes(each for each in line if chance.random() >= lost))


class Tcp(Pty):
    """A stream over a network, to whoever connected last; what waits too long is left out."""

    def __init__(self) -> None:
        self.door = socket.create_server(("127.0.0.1", 0))
        self.line: socket.socket | None = None
        self.port = f"socket://127.0.0.1:{self.door.getsockname()[1]}"
        self.options = f'{{ port = "{self.port}" }}'

    def fileno(self) -> int:
        """The connection, or the door while there is none."""
        return (self.line or self.door).fileno()

    def hear(self) -> bytes:
        """What has arrived; nothing from who has just connected or left."""
        if self.line is None:
            self.line, _ = self.door.accept()
            self.line.setblocking(False)
            return b""
        with contextlib.suppress(ConnectionError):
            if heard := self.line.recv(4096):
                return heard
        self.line = None
        return b""

    def say(self, line: bytes, lost: float, chance: random.Random) -> None:
        """Send a line, or lose it."""
        if self.line and chance.random() >= lost:
            with contextlib.suppress(ConnectionError, BlockingIOError):
                self.line.send(line)


class Udp(Pty):
    """Datagrams, to whoever spoke last; each may get lost, and one in twenty comes late."""

    backend, numbered = "udp.py:Esp32", True

    def __init__(self) -> None:
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind(("127.0.0.1", 0))
        self.peer: tuple[str, int] | None = None
        self.late = b""
        host, port = self.line.getsockname()
        self.port = f"{host}:{port}"
        self.options = f'{{ host = "{host}", port = {port} }}'

    def fileno(self) -> int:
        """The socket."""
        return self.line.fileno()

    def hear(self) -> bytes:
        """A datagram; its sender is who is answered."""
        with contextlib.suppress(ConnectionRefusedError):  # who spoke last has gone
            heard, self.peer = self.line.recvfrom(64)
            return heard
        return b""

    def say(self, line: bytes, lost: float, chance: random.Random) -> None:
        """Send a line, lose it, or send it after the next."""
        if self.peer is None:
            return
        if not self.late and chance.random() < 0.05:
            self.late = line
            return
        for each in (line, self.late):
            if each and chance.random() >= lost:
                self.line.sendto(each, self.peer)
        self.late = b""


WIRES = {"pty": Pty, "tcp": Tcp, "udp": Udp}


def main() -> None:
    """Serve the board until it is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", type=Path, help="write the rig file with its port")
    parser.add_argument("--wire", choices=WIRES, default="pty", help="how it is connected [pty]")
    parser.add_argument("--lose", type=float, default=0.0, help="share that gets lost on the wire")
    parser.add_argument("--reset-at", type=float, default=math.inf, help="s: the board is reset")
    parser.add_argument("--silent-at", type=float, default=math.inf, help="s: it says nothing more")
    given = parser.parse_args()
    wire = WIRES[given.wire]()
    if given.write:
        text = Path(__file__).with_name("rig.toml").read_text(encoding="utf-8")
        backend = Path(__file__).with_name(wire.backend.partition(":")[0]).resolve()
        text = text.replace('{ port = "/dev/ttyUSB0" }', wire.options)
        text = text.replace("arduino.py:Arduino", f"{backend}:{wire.backend.partition(':')[2]}")
        given.write.write_text(text, encoding="utf-8")
    print(wire.port, flush=True)
    board, start, steps, rest, up, number = Board(1), None, 0, b"", True, 0
    begin = time.monotonic()
    while True:
        if select.select([wire], [], [], 0.001)[0]:
            heard = wire.hear()
            *lines, rest = (rest + heard).split(b"\n")
            now = time.monotonic() - begin
            if heard and start is None:
                start = now  # the clock of the faults: since the first line
            for line in lines:
                board.hear(line, now)
        now = time.monotonic() - begin
        passed = -1.0 if start is None else now - start
        said = []
        if up and passed > given.reset_at:
            up, said, board.goal, number = False, ["READY"], [0.0, 0.0], 0
        while steps * STEP < now:
            steps += 1
            said += board.step(steps * STEP)
        if passed > given.silent_at or start is None:
            continue
        for text in said:
            number += 1
            line = text.replace("B", f"B {number}") if wire.numbered else text
            wire.say(with_sum(line), given.lose, board.random)


if __name__ == "__main__":
    main()
