"""What becomes of a rig of one's own when something goes wrong, for fault-matrix.md.

The class and the emulated board of ``examples/own_rig``, byte by byte, in virtual time: the same on
every run. Each fault is done while the ball tracks a circle; then the run goes on to its end. A row
is a row of the fault matrix, judged as that is.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from contextlib import nullcontext
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.devices import own
from twin.devices.own import OwnScreen, OwnServos, SeparateScreen
from twin.devices.own_config import OwnConfig, OwnScreenConfig, OwnServosConfig
from twin.devices.own_hardware import Reading
from twin.devices.realtime import RealTimeClock, Scheduling
from twin.devices.rig import HardwareRig
from twin.hal import agreement, supervisor
from twin.hal.cams import FixedRatio
from twin.hal.interface import Condition, Severity
from twin.hal.supervisor import Supervisor
from twin.run.controller_building import build_controller, build_limits
from twin.run.loop import drive
from twin.run.metrics import Ending, Outcome
from twin.run.record import Recorder
from twin.safety.fault_row import FaultRow
from twin.scenario.load import load
from twin.scenario.rig import read_rig

EXAMPLE = Path(__file__).parents[1] / "examples" / "own_rig"
BEGIN, AFTER, LEFT, AGAIN = 4.0, 3.0, 1.5, 1.0
"""When a fault begins, how long the run goes on from then on, and is watched then, and for how long
it runs again, s."""
LEVEL, STILL = math.radians(0.3), 0.02
"""Plate angle in rad and rate in rad/s that count as level and standing."""


def module_of(file: Path) -> Any:
    """A program of the example, which is in no package, as a module."""
    about = spec_from_file_location(file.stem, file)
    if about is None or about.loader is None:
        raise ImportError(f"{file}: no Python file")
    found = module_from_spec(about)
    sys.modules[file.stem] = found  # its dataclasses find themselves there
    about.loader.exec_module(found)
    return found


MODULES = ("arduino", "board", "camera", "servos")
ARDUINO, BOARD, CAMERA, SERVOS = (module_of(EXAMPLE / f"{name}.py") for name in MODULES)


class Line:
    """The port of the board, in virtual time; its attributes are what goes wrong with it."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.board = BOARD.Board(1)
        self.board.ball = [0.0, 0.0]
        self.now, self.steps = 0.0, 0
        self.waiting, self.rest = b"", b""
        self.sent: list[tuple[float, bytes]] = []
        self.gone = False
        self.late, self.lose, self.between = 0.0, 0.0, b""
        self.says: Callable[[str], str] = lambda text: text
        self.told: Callable[[], Array] = lambda: np.zeros(2)
        """Where the host believes to have told the plate to be, rad."""
        self.trace: list[tuple[float, ...]] = []
        """Time, phi, theta, x, y, whether the board's watchdog has the plate, and by how much the
        plate is not where the host has told it to be, rad."""

    def say(self, text: str) -> None:
        """Send a line to the host; an empty one is none."""
        if not text or self.gone:
            return
        line = self.between + f"{text}*{sum(text.encode()) % 256:02X}\n".encode()
        chance = self.board.random.random
        self.waiting += bytes(each for each in line if not self.lose or chance() >= self.lose)

    def pass_time(self, seconds: float) -> None:
        """Let board, plate and ball go on."""
        self.now += seconds + 1e-9
        while (self.steps + 1) * BOARD.STEP <= self.now:
            self.steps += 1
            time = self.steps * BOARD.STEP
            while self.sent and self.sent[0][0] + self.late <= time:
                *lines, self.rest = (self.rest + self.sent.pop(0)[1]).split(b"\n")
                for line in lines:
                    self.board.hear(line, time)
            said = self.board.step(time)
            alone = time - self.board.heard > BOARD.WATCHDOG
            astray = float(np.abs(self.told() - self.board.angle).max())
            self.trace.append((time, *self.board.angle, *self.board.ball, alone, astray))
            for text in said:
                self.say(self.says(text))

    def write(self, data: bytes) -> None:
        """Take bytes of the host; as `serial.Serial`, as are the others."""
        self.there()
        self.sent.append((self.now, data))

    def there(self) -> None:
        """Fail as a port does whose cable was pulled."""
        if self.gone:
            raise OSError("device disconnected")

    def read(self, count: int) -> bytes:
        """What has arrived."""
        self.there()
        found, self.waiting = self.waiting[:count], self.waiting[count:]
        return found

    def read_until(self, end: bytes) -> bytes:
        """A line, waited for."""
        while end not in self.waiting:
            self.pass_time(0.001)
        at = self.waiting.index(end) + 1
        return self.read(at)

    def close(self) -> None:
        """Nothing to close."""


class OnLine:
    """An example's class on such a line, by its time."""

    line: Line
    levelled = True
    """Whether the plate had been told to be level before it was told to stop."""

    def stop(self) -> None:
        """Stop, and keep what was before."""
        self.levelled = max(map(abs, self.line.board.goal)) < LEVEL
        super().stop()  # type: ignore[misc]  # of the example's class

    def time(self) -> float:
        """Time of the line, s."""
        return self.line.now

    def wait(self, seconds: float) -> None:
        """Let it pass."""
        self.line.pass_time(seconds)


class Stepped(OnLine, ARDUINO.Arduino):  # type: ignore[name-defined,misc]
    """The example's class for both devices."""

    def __init__(self, *, encoder: bool) -> None:
        super().__init__("emulated")
        ARDUINO.serial = SimpleNamespace(serial_for_url=Line)
        self.line = Line()
        self._encoder = encoder
        self._angles = (-math.inf, 0.0, 0.0)

    def measure(self) -> Reading:
        """The newest measurement, with the plate angles of its arrival if there is an encoder."""
        found = super().measure()
        if not self._encoder:
            return found
        if found.at != self._angles[0]:
            self._angles = (found.at, *self.line.board.angle)
        return Reading(found.x, found.y, *self._angles)


class SteppedServos(OnLine, SERVOS.Servos):  # type: ignore[name-defined,misc]
    """The example's servos; their camera is a different class on the same line."""

    def __init__(self) -> None:
        super().__init__("emulated")
        line = self.line = Line()
        SERVOS.serial = CAMERA.serial = SimpleNamespace(Serial=lambda *_, **__: line)


class Rig(HardwareRig):
    """A rig whose time is virtual: none passes while a controller begins."""

    def meanwhile(self, work: Callable[[], None]) -> None:
        """Do it at once."""
        work()


class Row(NamedTuple):
    """One fault, and what must come of it.

    Attributes:
        name: What is done, in words.
        act: Does it.
        expected: The condition that must be reported; None if nothing may be.
        more: Time in s that may pass besides that of the condition.
        by: Who must level the plate; that of the condition's severity by default.
        begins: From when on it can be seen, of the rows of `Line.trace`; at once by default.
        leaves: Whether the ball may leave its area before the condition is reported.
        at: When it is done, s.
        encoder: Whether the plate has an encoder.
        apart: Whether servos and camera are two classes.
    """

    name: str
    act: Callable[[Line], None]
    expected: Condition | None = None
    more: float = 0.0
    by: str = ""
    begins: Callable[[Array], Any] = lambda trace: np.ones(len(trace), bool)
    leaves: bool = False
    at: float = BEGIN
    encoder: bool = False
    apart: bool = False


ENDED = {
    "nobody": "goes on",
    "host's levelling": "level",
    "`stop`": "commanded level",
    "board's watchdog": "level by itself",
}
"""What the plate is brought to, by who does it; the servos of this board keep their torque."""
NOBODY, HOST, STOP, WATCHDOG = "nobody", "host's levelling", "`stop`", "board's watchdog"


def sets(**values: Any) -> Callable[[Line], None]:
    """A fault that is attributes of the line."""

    def change(line: Line) -> None:
        for name, value in values.items():
            setattr(line, name, value)

    return change


def scaled(factor: float) -> Callable[[str], str]:
    """Positions in another unit."""

    def says(text: str) -> str:
        return " ".join(
            each if each in "B-" else f"{factor * float(each):.1f}" for each in text.split()
        )

    return says


def frozen(line: Line) -> None:
    """The same picture again and again."""
    x, y = (1000 * each for each in line.board.ball)
    line.says = lambda _: f"B {x:.1f} {y:.1f}"


def reset(line: Line) -> None:
    """The board begins anew: the servos go to level."""
    line.board.goal = [0.0, 0.0]
    line.say("READY")


def brief(line: Line) -> None:
    """No numbers for three frames."""
    left = [3]

    def says(text: str) -> str:
        left[0] -= 1
        return "B nan nan" if left[0] >= 0 else text

    line.says = says


FILE = read_rig(EXAMPLE / "rig.toml")
CONFIG = FILE.own
GIVEN = (
    *("parameters=hobby", f"duration={BEGIN + AFTER}", "metrics.start=0", "reference.omega=1.2"),
    "controller.gains=[60,54,30,8]",
)
SCENARIO = load("circle", GIVEN)
LIMITS = build_limits(FILE.limited(SCENARIO))
PERIOD = SCENARIO.rig.period
SEEN = BOARD.LATE + BOARD.FRAME + PERIOD
"""What passes in s until a picture arrives: its age, a frame, a period."""
EDGE = np.add(LIMITS.area, LIMITS.margin)


def outside(trace: Array) -> Any:
    """Where the ball is out of its area."""
    return (np.abs(trace[:, 3:5]) > EDGE).any(axis=1)


def astray(trace: Array) -> Any:
    """Where the plate is not where it was told to be."""
    return trace[:, 6] > math.radians(CONFIG.astray_deg)


def steep(trace: Array) -> Any:
    """From where on the plate is so steep for long enough that no ball rests on it."""
    level = np.abs(trace[:, 1:3]).max(axis=1) <= math.radians(CONFIG.steep_deg)
    behind = np.append(0, np.cumsum(level))
    long = round(OwnConfig().rest / BOARD.STEP)
    return behind[long:] == behind[: len(behind) - long]


ROWS = (
    Row("The board says nothing any more", sets(says=lambda _: ""), own.SILENT),
    Row(
        *("The board says nothing any more, and the plate has an encoder", sets(says=lambda _: "")),
        own.SILENT,
        encoder=True,
    ),
    Row("Of the board's bytes 3 % get lost", sets(lose=0.03)),
    Row("Lines without sense come between those of the board", sets(between=b"\xff\0*B 1\n")),
    Row("There are bytes without sense in every line", sets(between=b"\xffB 7"), own.SILENT),
    Row("The board is reset", reset, own.REPORTED),
    Row("The cable is pulled", sets(gone=True), own.FAILED, by=WATCHDOG),
    Row("Commands arrive 15 ms late", sets(late=0.015)),
    Row("Three pictures have no number", brief),
    Row(
        *("No picture has a number any more", sets(says=lambda _: "B nan nan")),
        *(supervisor.BALL_LOST, CONFIG.unseen + SEEN),
    ),
    Row("A picture lacks a number", sets(says=lambda _: "B 10"), own.FAILED, SEEN),
    Row(
        *("The camera no longer sees the ball", sets(says=lambda _: "B - -")),
        *(supervisor.BALL_LOST, CONFIG.unseen + SEEN),
    ),
    Row("The picture is frozen", frozen, own.FROZEN, SEEN, begins=steep),
    Row("Positions come ten times too large", sets(says=scaled(10)), supervisor.BALL_OUTSIDE, SEEN),
    Row("Positions come ten times too small", sets(says=scaled(0.1))),
    Row(
        *("Positions come with the wrong sign", sets(says=scaled(-1))),
        *(agreement.UPHILL, SEEN),
        leaves=True,
    ),
    Row("Nothing of the host arrives any more", sets(late=math.inf), by=WATCHDOG),
    Row(
        *(
            "Nothing of the host arrives any more, and the plate has an encoder",
            sets(late=math.inf),
        ),
        # what the plate is compared with follows the command with the lag of the servos
        *(own.ASTRAY, SEEN + CONFIG.plate_lag),
        by=WATCHDOG,
        begins=astray,
        encoder=True,
    ),
    Row("The plate has no encoder", sets(), own.LACKING, at=0.0),
    Row(
        *("A camera apart from the servos fails", sets(says=lambda _: "B 10")),
        *(own.SCREEN_FAILED, SEEN),
        apart=True,
    ),
    Row("A camera apart from the servos is restarted", reset, own.SCREEN_REPORTED, apart=True),
    Row(
        *("A camera apart from the servos says nothing any more", sets(says=lambda _: "")),
        own.SILENT,
        apart=True,
    ),
)
"""Every row."""


def way_to_level(by: str, patience: float) -> float:
    """Longest time in s from the detection to a plate that is level and stands.

    It is the servos' slew and lag; before that the host's braking, its way back and the time in
    which it takes in a drift, or the board's patience.

    Args:
        by: Who levels it.
        patience: Time in s after which the board does it by itself.
    """
    angle, rate, acceleration = (
        float(np.max(each)) for each in (LIMITS.angle, LIMITS.rate, LIMITS.acceleration)
    )
    servos = angle / BOARD.SLEW + BOARD.LAG * math.log(angle / min(LEVEL, BOARD.LAG * STILL))
    host = 2 * rate / acceleration + angle / rate + Supervisor.DRIFT_TIME_S
    return servos + {HOST: host, STOP: 2 * PERIOD, WATCHDOG: patience + PERIOD}.get(by, 0.0)


def switched_on(row: Row, board: Any = None) -> tuple[Any, Rig]:
    """Hardware and rig of a row, on a board that has been there before if one is given."""
    hardware: Any = SteppedServos() if row.apart else Stepped(encoder=row.encoder)
    servos, screen = devices(hardware)
    start = hardware.start

    def opened() -> None:
        start()
        if board is not None:
            hardware.line.board = board
            board.heard, board.due = -math.inf, 0.0
            board.frames.clear()
            board.ball, board.speed = [0.0, 0.0], [0.0, 0.0]
        hardware.line.told = lambda: servos.motor()[0]

    hardware.start = opened
    rig = Rig(
        servos=servos,
        screen=screen,
        clock=RealTimeClock(PERIOD, spin=0.0, now=hardware.time, sleep=hardware.wait),
        transmission=FixedRatio(),
        limits=LIMITS,
        patience=1.0,
        scheduling=lambda: nullcontext(Scheduling(False, False, ("virtual time",))),
    )
    return hardware, rig


def devices(hardware: Any) -> tuple[OwnServos, OwnScreen | SeparateScreen]:
    """Servos and screen of hardware, of which one class is both, or each one."""
    if not isinstance(hardware, SteppedServos):
        servos = OwnServos(hardware, CONFIG, LIMITS, PERIOD)
        return servos, OwnScreen(servos)
    half = OwnServosConfig(backend="", plate_lag=CONFIG.plate_lag)
    camera = CAMERA.Camera("emulated")
    camera.time = hardware.time
    watched = OwnScreenConfig(backend="", steep_deg=CONFIG.steep_deg)
    return OwnServos(hardware, half, LIMITS, PERIOD), SeparateScreen(camera, watched)


def run(rig: Rig, duration: float, *observers: Any) -> tuple[Outcome, Recorder]:
    """Track the circle."""
    record = Recorder(round(duration / PERIOD), 1, PERIOD)
    record.observers.extend(observers)
    (outcome,) = drive(rig, build_controller(SCENARIO), duration, record)
    return outcome, record


def recovers(row: Row, board: Any, switched_on: Callable[..., tuple[Any, Rig]]) -> bool:
    """Whether the program runs again on the board when the cause is gone."""
    _, rig = switched_on(row, board)
    outcome, _ = run(rig, AGAIN)
    serious = [note for _, note in rig.journal if note.condition.severity is not Severity.WARNING]
    return outcome.ending is Ending.FINISHED and not serious


def carried_out(
    row: Row,
    switched_on: Callable[..., tuple[Any, Rig]] = switched_on,
    patience: float = BOARD.WATCHDOG,
) -> FaultRow:
    """A row as measured and judged.

    Args:
        row: The row.
        switched_on: Gives hardware and rig of a row, on a board that has been there before if one
            is given.
        patience: Time in s after which the board levels the plate by itself.
    """
    hardware, rig = switched_on(row)
    begun: list[tuple[float, float]] = []

    def watch(time: float, _: object) -> None:
        if time >= row.at and not begun:
            begun.append((time, hardware.line.now))
            row.act(hardware.line)

    outcome, record = run(rig, SCENARIO.duration, watch)
    hardware.wait(LEFT)
    (begin, now), after = begun[0], np.array(hardware.line.trace)
    after = after[after[:, 0] >= now]
    notes = [(at, note.condition) for at, note in rig.journal if at >= begin]
    found = [at for at, condition in notes if condition is row.expected]
    serious = [each.name for _, each in notes if each.severity is not Severity.WARNING]
    shows = np.flatnonzero(row.begins(after))
    seen = after[shows[0], 0] - now if len(shows) else math.inf
    rate = np.gradient(after[:, 1:3], after[:, 0], axis=0)
    tilt = np.abs(after[:, 1:3]).max(axis=1)
    last = after[np.flatnonzero((tilt > LEVEL) | (np.abs(rate).max(axis=1) > STILL))[-1]]
    level = last[0] - now
    by = HOST if hardware.levelled else STOP
    if last[5]:
        by = WATCHDOG
    elif outcome.ending is Ending.FINISHED:
        by = NOBODY
    expected = row.expected
    levels = {Severity.LEVEL: HOST, Severity.STOP: STOP}
    wanted = row.by or (levels.get(expected.severity, NOBODY) if expected else NOBODY)
    allowed = expected.within + PERIOD + row.more if expected else 0.0
    limit = allowed + way_to_level(wanted, patience) if wanted != NOBODY else None
    until = math.inf if limit is None else limit
    ball = np.abs(after[after[:, 0] <= now + seen + min(until, AFTER), 3:5]).max(axis=0)
    ends = expected is not None and expected.severity is not Severity.WARNING
    reason = serious[0] if serious else ""
    # what the host makes of a board that it cannot reach is not what brings the plate level
    due = expected.name if ends and expected else "" if row.by != WATCHDOG else reason
    gaps = np.diff(record.time)
    return FaultRow(
        name=row.name,
        condition=expected.name if expected else "",
        severity=str(expected.severity) if expected else "",
        allowed=allowed,
        detected=max(0.0, found[0] - begin - seen) if found else None,
        ending=str(outcome.ending),
        line=outcome.reason,
        says=True,
        whole=bool((gaps > 0).all()) and record.end >= outcome.time - PERIOD,
        recovered=recovers(row, hardware.line.board, switched_on),
        reason=reason,
        reason_expected=due,
        stopped_by=(by, by),
        stopped_by_expected=(wanted, wanted),
        state=(ENDED[by],) * 2,
        state_expected=(ENDED[wanted],) * 2,
        standstill=None if limit is None else level - seen,
        standstill_limit=limit,
        torque_off=None,
        torque_off_limit=None,
        torque=False,
        tilt=float(tilt.max()),
        tilt_limit=float(np.max(LIMITS.angle)) + Supervisor.ANGLE_SLACK_RAD,
        ball=(float(ball[0]), float(ball[1])),
        ball_limit=(math.inf, math.inf)
        if row.leaves or row.begins is outside
        else tuple(EDGE.tolist()),
        ball_later=tuple(np.abs(after[:, 3:5]).max(axis=0).tolist()),
        held=True,
    )
