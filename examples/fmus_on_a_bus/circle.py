"""A rig, its two drives and its controller as four FMUs, the drives on one simulated CAN bus.

    uv run python examples/fmus_on_a_bus/circle.py FOLDER [SECONDS]
    uv run ballplate trace FOLDER/bus.log

It exports the FMUs into FOLDER, lets the ball follow the circle over the bus, and compares that
with the same rig and controller connected directly. FOLDER/bus.log has the frames.

Node 1 is the drive of phi, node 2 the drive of theta (FMI-LS-BUS 1.0, low cut). A CANopen master
sets them up, sends them velocities and receives plate angles with every SYNC. The position of the
ball comes from the touch screen by a line of its own, as on the rig.
"""

from __future__ import annotations

import argparse
import struct
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Slave

import ballplate as bp

PERIOD_S = 0.002
"""Of control and SYNC."""
STEP_S = 0.0002
"""Of the bus: frames of one step are received at its end."""
STEPS = round(PERIOD_S / STEP_S)
BIT_RATE = 1_000_000
MASTER, AXES = 127, {1: "phi", 2: "theta"}
"""Nodes on the bus."""
PLATE_PER_MOTOR = 0.2
VELOCITY_COUNT = 0.001 * 2 * np.pi / 60 * PLATE_PER_MOTOR
"""Plate rate of one count of the target velocity (60FFh), rad/s."""
ANGLE_COUNT = 2 * np.pi / 245_760
"""Plate angle of one count of the second encoder (2050h), rad."""
RATES = ("rate_phi", "rate_theta")
ANGLES = ("measured_phi", "measured_theta")
SCREEN = ("measured_x", "measured_y", "age")

Array = np.ndarray[Any, np.dtype[Any]]


class Frame(NamedTuple):
    """A CAN frame with an 11-bit identifier."""

    cob_id: int
    data: bytes = b""

    @property
    def seconds(self) -> float:
        """How long it takes on the bus, with as many stuff bits as there can be."""
        bits = 34 + 8 * len(self.data)
        return (bits + 13 + (bits - 1) // 4) / BIT_RATE


# ---- FMUs ----------------------------------------------------------------------------------------


class Unit:
    """The rig or the controller, an FMU of FMI 2.0; variables by their names."""

    def __init__(self, file: Path, **values: float) -> None:
        about = fmpy.read_model_description(str(file))
        self._known = {each.name: each for each in about.modelVariables}
        self._fmu: Any = fmpy.instantiate_fmu(fmpy.extract(str(file)), about, "CoSimulation")
        self._time = 0.0
        self.put(values, values.values())
        self._fmu.setupExperiment(startTime=0.0)
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()

    def put(self, names: Sequence[str] | dict[str, float], values: Any) -> None:
        """Set variables."""
        for name, value in zip(names, values, strict=True):
            kind = self._known[name]
            getattr(self._fmu, f"set{kind.type}")([kind.valueReference], [value])

    def get(self, *names: str) -> Array:
        """Values of variables."""
        each = (self._known[name] for name in names)
        return np.array([getattr(self._fmu, f"get{k.type}")([k.valueReference])[0] for k in each])

    def step(self) -> None:
        """One control period."""
        self._fmu.doStep(self._time, PERIOD_S)
        self._time += PERIOD_S


class DriveNode:
    """A drive, an FMU of FMI 3.0 that is a node of the bus; in event mode between two steps."""

    def __init__(self, file: Path, node: int) -> None:
        about = fmpy.read_model_description(str(file))
        self._at = {each.name: [each.valueReference] for each in about.modelVariables}
        name = about.coSimulation.modelIdentifier
        self._fmu = FMU3Slave(
            guid=about.guid,
            unzipDirectory=fmpy.extract(str(file)),
            modelIdentifier=name,
            instanceName=f"drive{node}",
        )
        self._fmu.instantiate(eventModeUsed=True)
        self._fmu.setInt32(self._at["node"], [node])
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()
        self._sent = self._transmissions()

    @property
    def plate_angle(self) -> float:
        """The plate angle that the motor has turned to, rad."""
        return float(PLATE_PER_MOTOR * self._fmu.getFloat64(self._at["angle"])[0])

    def exchange(self, time: float, received: Sequence[Frame]) -> list[Frame]:
        """Receive frames at a time in s; the frames that are sent then; go on by one step."""
        sent = self._sent
        if received:
            data = b"".join(map(transmission, received))
            self._fmu.setClock(self._at["can.Rx_Clock"], [True])
            self._fmu.setBinary(self._at["can.Rx_Data"], [data])
        self._fmu.updateDiscreteStates()
        self._fmu.enterStepMode()
        self._fmu.doStep(time, STEP_S)
        self._fmu.enterEventMode()
        self._sent = self._transmissions()
        return sent

    def _transmissions(self) -> list[Frame]:
        if not self._fmu.getClock(self._at["can.Tx_Clock"])[0]:
            return []
        return list(transmitted(bytes(self._fmu.getBinary(self._at["can.Tx_Data"])[0])))


def transmission(frame: Frame) -> bytes:
    """The operation CAN Transmit of FMI-LS-BUS for a frame."""
    head = struct.pack("<IIIBBH", 0x10, 16 + len(frame.data), frame.cob_id, 0, 0, len(frame.data))
    return head + frame.data


def transmitted(data: bytes) -> Iterator[Frame]:
    """The frames in the operations of a node; a bus without errors needs no others of them."""
    while data:
        code, length = struct.unpack_from("<II", data)
        if code == 0x10:
            yield Frame(struct.unpack_from("<I", data, 8)[0], data[16:length])
        data = data[length:]


# ---- Bus and master ------------------------------------------------------------------------------


class Bus:
    """A CAN bus of some nodes: the waiting frame with the lowest identifier goes first.

    Attributes:
        log: Time in s and frame, as they ended.
    """

    def __init__(self, nodes: dict[int, Callable[[float, list[Frame]], list[Frame]]]) -> None:
        self.log: list[tuple[float, Frame]] = []
        self._nodes = nodes
        self._waiting: dict[int, deque[Frame]] = {node: deque() for node in nodes}
        self._received: dict[int, list[Frame]] = {node: [] for node in nodes}
        self._free = 0.0

    def step(self, time: float) -> None:
        """One step from a time in s: nodes receive and send, then frames go over the bus."""
        for node, exchange in self._nodes.items():
            self._waiting[node] += exchange(time, self._received[node])
            self._received[node] = []
        self._free = max(self._free, time)
        while heads := [(row[0].cob_id, node) for node, row in self._waiting.items() if row]:
            _, sender = min(heads)
            ends = self._free + self._waiting[sender][0].seconds
            if ends > time + STEP_S:
                return  # what does not fit waits for the next step
            frame, self._free = self._waiting[sender].popleft(), ends
            self.log.append((ends, frame))
            for node, row in self._received.items():
                if node != sender:
                    row.append(frame)


RAMP = 20_000_000
"""Ramps of the drives (6083h, 6084h) in 0.001 rpm/s: 60 times what the plate may accelerate, so
that a rate is reached within a step of the bus."""
SETTINGS = (
    (0x6060, 0, "b", 3),  # profile velocity
    (0x6083, 0, "I", RAMP),
    (0x6084, 0, "I", RAMP),
    (0x1017, 0, "H", 20),  # heartbeat, ms
    (0x1016, 1, "I", MASTER << 16 | 60),  # stop where the master is silent for 60 ms
)
PDOS = (
    (0x1400, 0x200, (0x6040_00_10, 0x60FF_00_20)),  # control word, target velocity
    (0x1800, 0x180, (0x6041_00_10, 0x2050_00_20)),  # status word, plate angle
)
CONTROL_WORDS = {0x40: 0x06, 0x21: 0x07, 0x23: 0x0F, 0x27: 0x0F}
"""What is to be commanded on the way to operation enabled, by the state in the status word."""
OPERATION_ENABLED = 0x27
ENABLED_WITHIN_S = 1.0


def settings_of(node: int) -> Iterator[tuple[int, int, str, int]]:
    """Index, subindex, format and value of all that is written to a drive."""
    yield from SETTINGS
    for parameters, cob_id, entries in PDOS:
        yield parameters, 1, "I", 1 << 31 | cob_id + node
        yield parameters, 2, "B", 1  # with every SYNC
        yield parameters + 0x200, 0, "B", 0
        yield from ((parameters + 0x200, i, "I", each) for i, each in enumerate(entries, 1))
        yield parameters + 0x200, 0, "B", len(entries)
        yield parameters, 1, "I", cob_id + node


class Master:
    """A CANopen master: sets the drives up, then exchanges velocities and angles with every SYNC.

    Attributes:
        angles: Plate angles (phi, theta) that the drives sent last, rad.
        velocities: Plate rates that they are to have, in their counts.
        enables: Whether the drives are to have torque.
    """

    def __init__(self) -> None:
        self.angles, self.velocities = np.zeros(2), np.zeros(2, int)
        self.enables = True
        self._states = dict.fromkeys(AXES, 0)
        self._answer: bytes | None = None
        self._setting_up: Generator[Frame, bytes, None] | None = self._set_up()
        self._begun = self._operational = False
        self._step = 0

    @property
    def enabled(self) -> bool:
        """Whether both drives obey velocities."""
        return set(self._states.values()) == {OPERATION_ENABLED}

    def exchange(self, _: float, received: Sequence[Frame]) -> list[Frame]:
        """Receive frames; the frames that are sent."""
        for frame in received:
            self._receive(frame)
        sent = list(self._requests())
        phase, self._step = self._step % STEPS, self._step + 1
        if self._step % (10 * STEPS) == 1:
            sent.append(Frame(0x700 + MASTER, b"\x05"))
        if self._operational and phase == STEPS - 1:  # received as the period begins
            sent.append(Frame(0x080))
        if self._operational and phase == STEPS // 2:
            sent += map(self._command, AXES, self.velocities.tolist())
        return sent

    def _receive(self, frame: Frame) -> None:
        service, node = frame.cob_id & 0x780, frame.cob_id & 0x7F
        if service == 0x580:
            self._answer = frame.data
        elif service == 0x180:
            status, count = struct.unpack("<Hi", frame.data)
            self._states[node] = status & 0x6F
            self.angles[node - 1] = count * ANGLE_COUNT
        elif service == 0x080:
            raise RuntimeError(f"emergency of node {node}: {frame.data.hex()}")

    def _command(self, node: int, velocity: int) -> Frame:
        word = CONTROL_WORDS.get(self._states[node], 0x06) if self.enables else 0x00
        return Frame(0x200 + node, struct.pack("<Hi", word, velocity))

    def _requests(self) -> Iterator[Frame]:
        """The next request of the set-up, once the last one is answered."""
        if self._setting_up is None or (self._begun and self._answer is None):
            return
        try:
            answer, self._answer = self._answer, None
            yield self._setting_up.send(answer if self._begun else None)  # type: ignore[arg-type]
            self._begun = True
        except StopIteration:
            self._setting_up, self._operational = None, True
            yield from (Frame(0, bytes((1, node))) for node in AXES)

    def _set_up(self) -> Generator[Frame, bytes, None]:
        """SDO requests that write each setting and read it back; receives the answers."""
        for node in AXES:
            for index, sub, form, value in settings_of(node):
                data = struct.pack(f"<{form}", value)
                key = struct.pack("<HB", index, sub)
                code = 0x23 | (4 - len(data)) << 2
                yield Frame(0x600 + node, bytes((code,)) + key + data.ljust(4, b"\0"))
                answer = yield Frame(0x600 + node, b"\x40" + key + bytes(4))
                if answer[4 : 4 + len(data)] != data:
                    raise RuntimeError(f"node {node} keeps {index:04X}h:{sub} otherwise")


# ---- Loops ---------------------------------------------------------------------------------------


def over_the_bus(files: dict[str, Path], periods: int) -> tuple[Array, Bus]:
    """Ball and reference (x, y, x, y) at each period over the bus, and the bus with its log."""
    rig, controller = Unit(files["rig"], noise=False), Unit(files["controller"])
    drives = [DriveNode(files["drive"], node) for node in AXES]
    master = Master()
    nodes = {node: drive.exchange for node, drive in zip(AXES, drives, strict=True)}
    bus = Bus({MASTER: master.exchange, **nodes})
    path, step = [], 0

    def pass_steps(count: int) -> None:
        nonlocal step
        for _ in range(count):
            bus.step(step * STEP_S)
            step += 1

    while not master.enabled:
        if step * STEP_S > ENABLED_WITHIN_S:
            raise RuntimeError(f"the drives are not enabled within {ENABLED_WITHIN_S:g} s")
        pass_steps(STEPS)
    for _ in range(periods):
        path.append(rig.get("true_x", "true_y", "reference_x", "reference_y"))
        before = np.array([drive.plate_angle for drive in drives])
        pass_steps(STEPS // 2)  # the angles of this period have come
        controller.put(SCREEN, rig.get(*SCREEN))
        controller.put(("touched",), map(bool, rig.get("touched")))
        controller.put(ANGLES, master.angles)
        controller.step()
        master.velocities = np.rint(controller.get(*RATES) / VELOCITY_COUNT).astype(int)
        pass_steps(STEPS - STEPS // 2)
        rig.put(RATES, ([drive.plate_angle for drive in drives] - before) / PERIOD_S)
        rig.step()
    master.velocities, master.enables = np.zeros(2, int), False
    pass_steps(20 * STEPS)
    return np.array(path), bus


def connected_directly(
    files: dict[str, Path],
    periods: int,
    *,
    late: bool = False,
    counted: bool = False,
    ramped: bool = False,
) -> Array:
    """The same without bus and drives.

    Args:
        files: The FMUs.
        periods: Number of control periods.
        late: Whether each command acts a period later.
        counted: Whether rates and angles go in the counts of the drives.
        ramped: Whether a rate changes evenly within a step of the bus, as the drives do it.
    """
    rig, controller = Unit(files["rig"], noise=False), Unit(files["controller"])
    path, turned, before, newest = [], np.zeros(2), np.zeros(2), np.zeros(2)
    for _ in range(periods):
        path.append(rig.get("true_x", "true_y", "reference_x", "reference_y"))
        seen = np.floor(turned / ANGLE_COUNT) * ANGLE_COUNT if counted else rig.get(*ANGLES)
        controller.put(SCREEN, rig.get(*SCREEN))
        controller.put(("touched",), map(bool, rig.get("touched")))
        controller.put(ANGLES, seen)
        controller.step()
        wanted = controller.get(*RATES)
        if counted:
            wanted = np.rint(wanted / VELOCITY_COUNT) * VELOCITY_COUNT
        now, newest = (newest if late else wanted), wanted
        mean = now + ramped * (before - now) * STEP_S / (2 * PERIOD_S)
        before = now
        rig.put(RATES, mean)
        turned = turned + PERIOD_S * mean
        rig.step()
    return np.array(path)


def make_fmus(folder: Path, seconds: float) -> dict[str, Path]:
    """Rig, controller and drive as FMUs, by name."""
    length = {"duration": seconds}
    return {
        "rig": bp.fmu("circle", folder / "rig.fmu", length, with_reference=True),
        "controller": bp.controller_fmu("circle", folder / "controller.fmu", length),
        "drive": bp.drive_fmu("akd", folder / "drive.fmu"),
    }


def main(folder: Path, seconds: float) -> None:
    """Make the FMUs, run them in each way, print what came of it, write the trace."""
    folder.mkdir(parents=True, exist_ok=True)
    files = make_fmus(folder, seconds)
    periods = round(seconds / PERIOD_S)
    on_bus, bus = over_the_bus(files, periods)
    one, two = {"late": True}, {"counted": True}
    runs = {
        "connected directly": connected_directly(files, periods),
        "commands a period late": connected_directly(files, periods, **one),
        "also in counts of the drives": connected_directly(files, periods, **one, **two),
        "also ramped within 0.2 ms": connected_directly(files, periods, **one, **two, ramped=True),
        "over the bus": on_bus,
    }
    print(f"{'':30}rms from the circle   largest from the run over the bus")
    for name, run in runs.items():
        error = np.sqrt(np.mean(np.sum((run[:, :2] - run[:, 2:]) ** 2, axis=1)))
        apart = np.linalg.norm(run[:, :2] - on_bus[:, :2], axis=1).max()
        print(f"{name:30}{1e3 * error:16.3f} mm {1e6 * apart:30.3f} um")
    lines = (
        f"({time:.6f}) can0 {frame.cob_id:03X}#{frame.data.hex().upper()}\n"
        for time, frame in bus.log
    )
    trace = folder / "bus.log"
    trace.write_text("".join(lines), encoding="ascii")
    load = sum(frame.seconds for _, frame in bus.log) / bus.log[-1][0]
    print(f"{len(bus.log)} frames, {100 * load:.0f} % load: {trace}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="A circle over a simulated CAN bus.")
    parser.add_argument("folder", type=Path, help="where FMUs and trace are written")
    parser.add_argument("seconds", type=float, nargs="?", default=10.0, help="simulated time")
    main(**vars(parser.parse_args()))
