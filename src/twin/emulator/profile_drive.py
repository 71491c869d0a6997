"""An emulated plain CiA 402 drive on CANopen: frames in, frames out, time in steps.

It has the modes of ``profile_modes.py``, the objects of ``profile_objects.toml`` and an EDS of
just these. Not emulated: gear and feed other than 1, limit switches, searches for home (so that
6099h and 609Ah have no effect), brakes, LSS, node guarding, and the bus's own timing.
"""

from __future__ import annotations

import math
from collections import deque
from functools import partial
from typing import Generic, TypeVar

from twin.emulator.drive_objects import COB_ID_INVALID, AbortError, Frame, Heartbeats, Key
from twin.emulator.load import Inertia, InertiaLoad, ShaftLoad
from twin.emulator.node import OPERATIONAL, EmulatedNode
from twin.emulator.power_stage import MASTER_SILENT, Power
from twin.emulator.profile_modes import (
    MODE_BIT_13,
    NO_WINDOW,
    VELOCITY_MODES,
    Mode,
    ModesOfOperation,
    Motion,
)
from twin.emulator.profile_objects import (
    NO_DATA,
    EventPdos,
    ProfileObjects,
    SdoServer,
    emergency_code,
)

COUNTS_PER_TURN = 65536
"""Counts per motor revolution (608Fh)."""
COUNT_RAD = 2 * math.pi / COUNTS_PER_TURN
"""One count of 6064h in rad."""
RATED_TORQUE_NM = 1.0
"""Rated torque (6076h) in N m; 6072h and 6077h count thousandths of it."""
MAX_TORQUE = 3000
"""Largest torque, in thousandths of the rated one."""
FOLLOWING_ERROR = 0x8611
"""Emergency code of a following error."""
MAX_STEP_S = 0.001
"""Longest step in s of the drive's controllers."""

_HISTORY_LENGTH = 8
_COUNTER_WRAP = 1 << 32
_STANDSTILL_RATE_RAD_S = 0.05
_REMAINS, _ENDS = 6, 2
"""Quick stop options as the power stage has them: the state stays, or ends at standstill."""


Turned = TypeVar("Turned", InertiaLoad, ShaftLoad)
"""Load of a drive."""


class ProfileDrive(EmulatedNode, Generic[Turned]):
    """One plain CiA 402 drive with its load.

    Args:
        node: CANopen node, 1 to 127.
        load: What the motor turns.
    """

    store: ProfileObjects
    pdos: EventPdos

    def __init__(self, node: int, load: Turned) -> None:
        self.motor: Turned = load
        self._stored: dict[Key, int] = {}
        super().__init__(node)

    def power_on(self) -> None:
        """Begin as after power-up: stored parameters, position 0, boot-up message next."""
        store = ProfileObjects(self.node)
        store.load(self._stored)
        self._boot(store, EventPdos(store, self._written))
        self._sdo_server = SdoServer(store, self._written)
        self._origin = -self.motor.angle / COUNT_RAD
        self.modes = ModesOfOperation(store.get, self._set_position)
        self._errors: deque[int] = deque(maxlen=_HISTORY_LENGTH)
        self._following_failed = False
        self._beyond = 0.0
        self._take_load()
        self.modes.enter(Mode(store.get(0x6060)))
        self._connect()

    def _connect(self) -> None:
        """Join objects to what they show."""
        live, modes, motor = self.store.live, self.modes, self.motor
        live(0x1001, 0, self._register)
        live(0x1003, 0, lambda: len(self._errors))
        for place in range(_HISTORY_LENGTH):
            live(0x1003, place + 1, partial(self._error, place))
        live(0x1010, 1, lambda: 1)
        live(0x1011, 1, lambda: 1)
        live(0x603F, 0, lambda: emergency_code(self.power.faults[-1]) if self.power.faults else 0)
        live(0x6041, 0, lambda: self.status)
        live(0x6061, 0, lambda: int(modes.mode))
        live(0x6062, 0, lambda: _wrap_counts(modes.demand.position))
        live(0x6064, 0, lambda: _wrap_counts(self._actual().position))
        live(0x606B, 0, lambda: round(modes.demand.velocity))
        live(0x606C, 0, lambda: round(self._actual().velocity))
        live(0x6077, 0, lambda: round(1000 * motor.torque / RATED_TORQUE_NM))
        live(0x6079, 0, lambda: 48000 * self.power.dc_link)
        live(0x60F4, 0, lambda: _wrap_counts(self.following_error))
        live(0x60FD, 0, lambda: (not self.power.sto_closed) << 3)

    @property
    def rate(self) -> float:
        """Motor shaft rate in rad/s."""
        return self.motor.rate

    @property
    def following_error(self) -> float:
        """Demanded minus actual position in counts; 0 where no position is controlled."""
        if self.modes.mode in VELOCITY_MODES:
            return 0.0
        return self.modes.demand.position - self._actual().position

    @property
    def status(self) -> int:
        """Status word."""
        word = self.power.state | self.power.dc_link << 4 | 1 << 9
        if self.enabled:
            word |= self.modes.status
        positioned = self.modes.mode in {Mode.PROFILE_POSITION, Mode.CYCLIC_POSITION}
        return word | MODE_BIT_13 * (self._following_failed and positioned)

    def reboot(self) -> None:
        """Lose the power of the electronics for a moment; the motor keeps its rate."""
        self.power_on()

    def _let_alone(self) -> None:
        """Do nothing more to it, apart from what is in its power stage and objects."""
        super()._let_alone()
        if isinstance(self.motor, InertiaLoad):
            self.motor.jammed, self.motor.external = False, 0.0

    def _actual(self) -> Motion:
        motor = self.motor
        return Motion(motor.angle / COUNT_RAD + self._origin, motor.rate / COUNT_RAD)

    def _set_position(self, counts: float) -> None:
        """Let the present place have a position in counts."""
        shift = counts - self._actual().position
        self._origin += shift
        self.modes.shift(shift)

    def _register(self) -> int:
        """The error register."""
        bits = 0
        for number in self.power.faults:
            bits |= register_bits(emergency_code(number))
        return bits

    def _error(self, place: int) -> int:
        """The error field of a place, the newest at 0.

        Raises:
            AbortError: There is none.
        """
        if place >= len(self._errors):
            raise AbortError(NO_DATA)
        return self._errors[place]

    def receive(self, frame: Frame) -> list[Frame]:
        """Take in any frame on the bus; return its immediate answers."""
        if frame.remote and not frame.extended and self.nmt == OPERATIONAL and self._off <= 0:
            return self.pdos.requested(frame.cob_id)
        return super().receive(frame)

    def _sdo(self, request: bytes) -> bytes | None:
        return self._sdo_server.answer(request, self.sdo_aborts)

    def _command(self, command: int) -> None:
        if command != 130:
            super()._command(command)
            return
        self.store.load(self._stored, 0x1000, 0x1FFF)  # only the communication is reset
        self.heartbeats = Heartbeats(self.store)
        self._out.append(self._own(0x700, b"\0"))
        super()._command(128)

    def emergency(self, code: int, register: int = 0, extra: bytes = b"") -> None:
        """Send an emergency message, unless 1014h switches them off, and note it in 1003h."""
        if code:
            self._errors.appendleft(code)
        if not self.store.get(0x1014) & COB_ID_INVALID:
            super().emergency(code, register, extra)

    @property
    def emergency_id(self) -> int:
        """Identifier of its emergency messages (1014h)."""
        return self.store.get(0x1014) & 0x7FF

    def _failed(self, numbers: list[int]) -> None:
        for number in numbers:
            self.emergency(emergency_code(number), self._register())

    def _written(self, index: int, sub: int) -> None:
        mode = self.store.get(0x6060)
        match index:
            case 0x1003:
                self._errors.clear()
            case 0x1010:
                self._stored = self.store.stored()
            case 0x1011:
                self._stored = {}  # the defaults come with the next start
            case 0x1017:
                self.heartbeats.restart()
            case 0x2000:
                self._take_load()
            case 0x6040:
                self._control(self.store.get(0x6040))
            case 0x6060 if self.store.allows(index, mode):
                self.modes.enter(Mode(mode))
            case _:
                self.modes.set_target(index)

    def _take_load(self) -> None:
        """Let the load have the inertia and friction of 2000h."""
        inertia, coulomb, viscous = (self.store.get(0x2000, sub) for sub in (1, 2, 3))
        if isinstance(self.motor, InertiaLoad):
            self.motor.body = Inertia(inertia * 1e-7, coulomb * 1e-6, viscous * 1e-6)

    def _control(self, word: int) -> None:
        """Obey a control word."""
        power, before = self.power, self.power.state
        option = self.store.get(0x605A)
        power.option = _ENDS if option < 5 else _REMAINS
        self._failed(power.control(word))
        if power.state is Power.QUICK_STOP and before is not Power.QUICK_STOP:
            self.modes.abandon()
            if option == 0:
                power.still()
        if before is Power.FAULT and power.state is not Power.FAULT:
            self._following_failed = False
            self.emergency(0)
        self.modes.set_control(word, enabled=self.enabled)

    def _lose_master(self) -> None:
        """React by the option of 6007h: 1 fault, 2 voltage off, 3 quick stop."""
        option = self.store.get(0x6007)
        if option == 1:
            super()._lose_master()
            return
        code = emergency_code(MASTER_SILENT)
        self.emergency(code, register_bits(code))
        if option in {2, 3}:
            self._control(0x00 if option == 2 else 0x02)

    def step(self, dt: float) -> list[Frame]:
        """Let dt seconds pass; return the frames sent meanwhile."""
        frames = super().step(dt)
        if self.nmt == OPERATIONAL and self._off <= 0:
            frames += self.pdos.events(dt)
        return frames

    def _coast(self, dt: float) -> None:
        self.motor.coast(dt)

    def _move(self, dt: float) -> None:
        count = max(1, math.ceil(dt / MAX_STEP_S - 1e-9))
        for _ in range(count):
            self._move_once(dt / count)

    def _move_once(self, dt: float) -> None:
        state, modes = self.power.state, self.modes
        if state is Power.OPERATION_ENABLED:
            modes.step(dt)
            self._drive(dt)
            self._check_following(dt)
        elif ramp := self._stopping_ramp(state):
            modes.brake(ramp, dt)
            self._drive(dt)
        else:
            self.motor.coast(dt)
            modes.follow(self._actual())
        if modes.mode in VELOCITY_MODES:
            modes.anchor(self._actual().position)
        modes.look(self._actual(), dt)
        if self._stands():
            self.power.still()
        self._unwind()

    def _stopping_ramp(self, state: Power) -> float | None:
        """Ramp in counts/s^2 on which a state brakes; None where the motor has no torque."""
        if state is Power.QUICK_STOP:
            slow = self.store.get(0x605A) in {1, 5}
        elif state is Power.FAULT_REACTION and self.store.get(0x605E):
            slow = self.store.get(0x605E) == 1
        else:
            return None
        return float(max(1, self.store.get(0x6084 if slow else 0x6085)))

    def _stands(self) -> bool:
        """Whether a stop is done: demand and motor rest, or nothing brakes."""
        if self.power.state is Power.FAULT_REACTION and not self.store.get(0x605E):
            return True
        return not self.modes.demand.velocity and abs(self.motor.rate) < _STANDSTILL_RATE_RAD_S

    def _drive(self, dt: float) -> None:
        """Let the motor follow the demand."""
        demand = self.modes.demand
        controlled = self.modes.mode not in VELOCITY_MODES
        angle = (demand.position - self._origin) * COUNT_RAD if controlled else None
        most = min(self.store.get(0x6072), MAX_TORQUE) / 1000 * RATED_TORQUE_NM
        self.motor.drive(
            angle, demand.velocity * COUNT_RAD, demand.acceleration * COUNT_RAD, most, dt
        )

    def _check_following(self, dt: float) -> None:
        """Fail where the following error has been too large for too long (6065h, 6066h)."""
        window, time = self.store.get(0x6065), self.store.get(0x6066) / 1e3
        within = abs(self.following_error) <= window or window == NO_WINDOW
        self._beyond = 0.0 if within else self._beyond + dt
        if self._beyond > time:
            self._following_failed = True
            self.modes.follow(self._actual())  # what is left of the motion is braked
            self._failed(self.power.fail(FOLLOWING_ERROR, braked=True))

    def _unwind(self) -> None:
        """Keep positions within 32 bits where a motor turns on and on."""
        position = self._actual().position
        if (
            self.modes.mode in VELOCITY_MODES
            and not -_COUNTER_WRAP / 2 <= position < _COUNTER_WRAP / 2
        ):
            self._set_position((position + _COUNTER_WRAP / 2) % _COUNTER_WRAP - _COUNTER_WRAP / 2)


def _wrap_counts(counts: float) -> int:
    """A position in counts, wrapped to 32 bits."""
    return (round(counts) + _COUNTER_WRAP // 2) % _COUNTER_WRAP - _COUNTER_WRAP // 2


def register_bits(code: int) -> int:
    """Bits of the error register (1001h) for an emergency code."""
    kinds = {0x2: 1 << 1, 0x3: 1 << 2, 0x4: 1 << 3, 0xF: 1 << 7}
    if code >> 8 == 0x81:
        return 1 | 1 << 4
    return 1 | kinds.get(code >> 12, 1 << 5)
