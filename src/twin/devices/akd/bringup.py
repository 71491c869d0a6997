"""Bring-up of the drives over SDO: identity, units, safe settings, PDO mapping, heartbeats, nets.

Requests wait for their answer, and the bus is read only meanwhile. What a count means in a drive is
read from it and checked, never assumed in silence. Velocities and accelerations among its own
parameters (3xxxh), and what CiA 402 derives from them, count in the unit chosen by UNIT.VROTARY and
UNIT.ACCROTARY: rpm and rpm/s, or they are refused. How many counts one of them has is not
documented: 1000 fits the vendor's description of 60FFh, 1 fits the defaults in its EDS. The values
found in the drive tell the two apart, as a motor has neither 2.3 nor 2.3 million rpm.

Currents count in 0.001 A and the torque constant in 0.001 N m/A, which the defaults of the vendor's
EDS suggest (MOTOR.ICONT 9900, MOTOR.IPEAK 29 700). Their product, the motor's continuous torque, is
known from its datasheet: it tells whether both are read rightly, and whether the drive knows its
motor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import can

from twin.base.errors import plural
from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.axis import difference
from twin.devices.akd.bus import BUS_ERRORS
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.protocol import (
    AKD_VENDOR_ID,
    AT_EVERY_SYNC,
    PDO_INVALID,
    RPM_RAD_S,
    DriveState,
    Object,
    table,
)

FIRST_TRANSMIT = 0x1800
"""Index of the parameters of the first PDO that a drive sends."""

_DRIVE_SERVICES = (protocol.HEARTBEAT, protocol.SDO_RESPONSE, protocol.TPDO1, protocol.TPDO2)


class Network:
    """A CANopen network that reads the bus only while it waits for something.

    A receiving thread would compete with the control loop, and an adapter that goes would end it
    with a traceback.

    Args:
        bus: The open bus.
        answer: Longest wait for an SDO answer in s.
        now: Monotonic time in s.
    """

    def __init__(self, bus: can.BusABC, answer: float, now: Callable[[], float]) -> None:
        self.bus = bus
        self.answer = answer
        """Longest wait for an SDO answer in s."""
        self.now = now
        """Monotonic time in s."""
        self.states: dict[int, int] = {}
        """NMT states from heartbeats, by node."""
        self.answers: dict[int, int] = {}
        """Number of SDO answers, by node."""
        self._answer: dict[int, protocol.SdoAnswer | None] = {}
        self.identifiers: set[int] = set()
        """Of all frames that others have sent."""
        self.bus_errors = 0

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        self.bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))

    def request(self, node: int, index: int, sub: int, data: bytes) -> protocol.SdoAnswer | None:
        """Send an SDO request, and wait for its answer; None if there is none in time."""

        def answered() -> protocol.SdoAnswer | None:
            answer = self._answer.get(node)
            return answer if answer and answer.key == (index, sub) else None

        self._answer.pop(node, None)
        self.send(protocol.SDO_REQUEST + node, data)
        self.pump(self.answer, lambda: answered() is not None)
        return answered()

    def answered_otherwise(self, node: int, index: int, sub: int) -> str:
        """Message of a node instead of an answer to the newest request; empty if none."""
        if node not in self._answer:
            return ""
        return protocol.answers_otherwise((index, sub), self._answer[node])

    def pump(self, seconds: float, done: Callable[[], bool] = lambda: False) -> bool:
        """Read the bus until something is done, at most for s; return whether it was done.

        What arrived in time counts even if the computer was busy elsewhere until after it; a bus
        that does not become quiet is read for twice the time.
        """
        deadline = self.now() + seconds
        while not done():
            left = deadline - self.now()
            message = self.bus.recv(min(max(left, 0.0), 0.02))
            if message is not None:
                self._take(message)
            if left <= 0 and (message is None or left < -seconds):
                return False
        return True

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame:
            self.bus_errors += 1
        elif message.is_rx and not message.is_remote_frame and not message.is_extended_id:
            self.identifiers.add(message.arbitration_id)
            node = message.arbitration_id & protocol.NODE_MASK
            service = message.arbitration_id - node
            if service == protocol.SDO_RESPONSE and len(message.data) == 8:
                self.answers[node] = self.answers.get(node, 0) + 1
                self._answer[node] = protocol.decode_sdo(bytes(message.data))
            state = protocol.decode_nmt_state(bytes(message.data))
            if service == protocol.HEARTBEAT and state is not None:
                self.states[node] = state


class Remote:
    """One drive during bring-up: reads and writes that end in a value or one clear line.

    Args:
        network: The bus.
        axis: The axis of the drive.
    """

    def __init__(self, network: Network, axis: AxisConfig) -> None:
        self.axis = axis
        self.network = network

    def read(self, index: int, sub: int = 0) -> int:
        """The value of an object.

        Raises:
            DriveError: If the drive does not answer, or refuses.
        """
        what, known = f"reading {index:04X}h:{sub}", self._known(index, sub)
        data = self._asked(what, index, sub, protocol.encode_sdo_read(index, sub))
        if len(data) != known.bits // 8:
            detail = f"{what}: {plural(len(data), 'byte')}, an AKD has {known.bits // 8}"
            raise self.wrong(detail)
        return known.decode(data)

    def read_if_there(self, index: int, sub: int = 0) -> int | None:
        """The value of an object; None if the drive refuses it.

        Raises:
            DriveError: If the drive does not answer.
        """
        try:
            return self.read(index, sub)
        except DriveError as error:
            if error.fault.condition is not c.SDO_ABORT:
                raise
            return None

    def write(self, index: int, sub: int, value: int) -> None:
        """Write an object and read it back; ``objects.toml`` gives the allowed difference.

        Raises:
            DriveError: If the drive does not answer, refuses, or keeps a different value.
        """
        what, known = f"writing {value} to {index:04X}h:{sub}", self._known(index, sub)
        try:
            data = known.encode(value)
        except OverflowError as error:
            raise self.wrong(f"{what}: out of range") from error
        self._asked(what, index, sub, protocol.encode_sdo_write(index, sub, data))
        read = self.read(index, sub)
        if not protocol.is_kept(index, value, read):
            raise self.wrong(f"{index:04X}h:{sub} ({known.name}) keeps {read}, not {value}")

    def map_pdo(self, parameters: int, cob_id: int, entries: Sequence[tuple[int, int]]) -> None:
        """Map a PDO that is switched off, in the order of CiA 301, and switch it on.

        Args:
            parameters: Index of its parameters; its mapping lies 200h above.
            cob_id: Its identifier.
            entries: Index and subindex of each mapped object.

        Raises:
            DriveError: If the drive does not answer, refuses, or keeps something else.
        """
        mapping = parameters + 0x200
        self.write(parameters, 2, AT_EVERY_SYNC)
        if parameters >= FIRST_TRANSMIT:
            self.write(parameters, 3, 0)  # no inhibit time
            self.write(parameters, 5, 0)  # no event timer
        self.write(mapping, 0, 0)
        for place, (index, sub) in enumerate(entries, 1):
            self.write(mapping, place, index << 16 | sub << 8 | self._known(index, sub).bits)
        self.write(mapping, 0, len(entries))
        self.write(parameters, 1, cob_id)

    def _known(self, index: int, sub: int) -> Object:
        known = protocol.objects().get((index, sub))
        if known is None:
            raise self.wrong(f"{index:04X}h:{sub}: not in the object dictionary")
        return known

    def _asked(self, what: str, index: int, sub: int, data: bytes) -> bytes:
        """Send a request and return the data of its answer."""
        where = self.axis.where
        try:
            answer = self.network.request(self.axis.node, index, sub, data)
        except BUS_ERRORS as error:
            raise DriveError(
                c.ADAPTER_GONE, where, f"{what}: the adapter was lost ({error})"
            ) from error
        if answer is None:
            if other := self.network.answered_otherwise(self.axis.node, index, sub):
                raise DriveError(c.SDO_WRONG, where, f"{what}: {other}")
            if self.axis.node in self.network.answers:
                raise DriveError(c.SDO_TIMEOUT, where, f"{what}: no answer")
            raise DriveError(c.NODE_ABSENT, where, absent(self.network, self.axis))
        if answer.aborted:
            words = protocol.abort_words(answer.value)
            raise DriveError(c.SDO_ABORT, where, f"{what} refused: {words}")
        return answer.data

    def wrong(self, detail: str) -> DriveError:
        """That the drive is set otherwise than it must be, to be raised."""
        return DriveError(c.WRONG_SETTING, self.axis.where, detail)


def absent(network: Network, axis: AxisConfig) -> str:
    """Why a drive may be silent, in one line."""
    mask = protocol.NODE_MASK
    nodes = {each & mask for each in network.identifiers if each & ~mask in _DRIVE_SERVICES}
    others = sorted(nodes - {0, axis.node})
    heard = f"heard nodes {', '.join(map(str, others))}" if others else "heard nobody"
    return f"does not answer ({heard}); check power, cable, bit rate and node switches"


PER_UNIT = 1000
"""Counts of one unit where the rig file gives no value; as for 60FFh (web help: float 1000:1)."""

_CUSTOM_VELOCITY = 1 << 4
"""Bit of FBUS.PARAM05 that replaces 0.001 rpm by the factor in 204Ch."""
_ROUNDING_DIGITS = 2
_MAX_ROUNDING_SHARE = 0.1
"""Share by which a value may pass the one wanted because it is rounded up."""


class DriveQuantity(NamedTuple):
    """A velocity or an acceleration as a drive's parameters have it.

    Attributes:
        unit: ``rpm`` or ``rpm/s``.
        scale: One count in rad/s or rad/s^2 at the motor.
        key: Key of the rig file that overrides it.
    """

    unit: str
    scale: float
    key: str

    def counts(self, value: float) -> int:
        """The fewest counts that are at least a value, round in the drive's unit.

        Rounded up: these are nets, and the host's own limits come first.

        Raises:
            ValueError: If the drive's counts are too coarse for it.
        """
        amount = value / RPM_RAD_S
        step = 10.0 ** (math.floor(math.log10(amount)) + 1 - _ROUNDING_DIGITS)
        wanted = math.ceil(amount / step - 1e-9) * step * RPM_RAD_S
        counts = math.ceil(wanted / self.scale - 1e-9)
        if counts * self.scale > (1 + _MAX_ROUNDING_SHARE) * value:
            raise ValueError(f"{self.words(1)} a count is too coarse for {value:.3g} in SI units")
        return counts

    def words(self, counts: int) -> str:
        """Counts as a person reads them."""
        return f"{counts * self.scale / RPM_RAD_S:.6g} {self.unit}"


SPEED_RANGE_RAD_S = (9 * RPM_RAD_S, 20_000 * RPM_RAD_S)
"""Speed limits that a motor may have, rad/s; the host sets none below 1 rad/s."""
RAMP_RANGE_RAD_S2 = (100 * RPM_RAD_S, 5e6 * RPM_RAD_S)
"""Ramps that a drive may have, rad/s^2."""


def read_units(remote: Remote) -> tuple[DriveQuantity, DriveQuantity]:
    """Units of velocity and acceleration; checks whatever else scales what is exchanged, too.

    Raises:
        DriveError: If anything scales otherwise than the host counts; it names the line to change.
    """
    axis = remote.axis
    counts = remote.read(0x608F, 1) / max(1, remote.read(0x608F, 2))
    if counts != axis.motor_counts:
        raise remote.wrong(
            f"{counts:g} counts per motor revolution (608Fh), configured are {axis.motor_counts}; "
            f"set {axis.name}.motor_counts = {counts:g}",
        )
    if remote.read(0x36E9) & _CUSTOM_VELOCITY:
        factor = f"{remote.read(0x204C, 1)}/{remote.read(0x204C, 2)}"
        detail = (
            f"velocity is scaled by 204Ch = {factor} (36E9h bit 4 is set); clear it in the drive"
        )
        raise remote.wrong(detail)
    for index, name in ((0x6091, "gear ratio"), (0x6092, "feed constant")):
        ratio = remote.read(index, 1), remote.read(index, 2)
        if ratio[0] != ratio[1]:
            text = f"{name} {index:04X}h is {ratio[0]}:{ratio[1]}; set it to 1:1 in the drive, "
            raise remote.wrong(f"{text}and name a real gear as {axis.name}.gear")
    speed = _quantity(remote, 0x365F, "UNIT.VROTARY", "rpm", "limit_unit")
    ramp = _quantity(remote, 0x3659, "UNIT.ACCROTARY", "rpm/s", "acceleration_unit")
    _check_plausible(remote, speed, "velocity", SPEED_RANGE_RAD_S)
    _check_plausible(remote, ramp, "acceleration", RAMP_RANGE_RAD_S2)
    return speed, ramp


def _quantity(remote: Remote, index: int, name: str, unit: str, key: str) -> DriveQuantity:
    if chosen := remote.read(index):
        text = f"{name} ({index:04X}h) is {chosen}; set it to 0 ({unit}) in the drive"
        raise remote.wrong(text)
    given: float | None = getattr(remote.axis, key)
    return DriveQuantity(unit, given if given is not None else RPM_RAD_S / PER_UNIT, key)


def _check_plausible(
    remote: Remote, quantity: DriveQuantity, kind: str, range_: tuple[float, float]
) -> None:
    """Compare what the drive has been set to with what a motor can have."""
    low, high = range_
    axis, unit = remote.axis, quantity.unit
    for index, name in table()["scaled"][kind]:
        found = abs(remote.read(index))
        if not found or low <= found * quantity.scale <= high:
            continue
        allowed = f"{low / RPM_RAD_S:.3g} to {high / RPM_RAD_S:.3g} {unit} are plausible"
        text = f"{name} ({index:04X}h) holds {found}, which would be {quantity.words(found)}"
        fits = [size for size in (RPM_RAD_S, RPM_RAD_S / PER_UNIT) if low <= found * size <= high]
        advice = f"set {name} in the drive"
        if fits:
            in_unit = f"{found * fits[0] / RPM_RAD_S:g} {unit}"
            advice = f"if it is {in_unit}, set {axis.name}.{quantity.key} = {fits[0]:.9g}"
        raise remote.wrong(f"{text} ({allowed}); {advice}")


Precondition = tuple[str, str, str]
"""A setting: its name in the drive, its value in words, and what to do if it is wrong."""


def read_preconditions(remote: Remote, config: AkdConfig) -> tuple[Precondition, ...]:
    """Read the settings that the host does not write; one that this drive lacks is left out.

    Raises:
        DriveError: If the drive does not answer.
    """
    found = []
    rate, wanted = remote.read_if_there(0x36E5), config.bus.bitrate // 1000
    if rate is not None:
        seen, advice = f"{rate} kbit/s", ""
        if rate != wanted:
            automatic = "automatic: found from the first frames at power-up"
            seen = f"{seen} from the next power-up on" if rate else automatic
            advice = f"set it to {wanted} in the drive and power-cycle it"
        found.append(("FBUS.PARAM01 (bit rate)", seen, advice))
    for index, name, well, badly, remedy in table()["flags"]:
        value = remote.read_if_there(index)
        if value is not None:
            found.append((name, *((well, "") if value else (badly, remedy))))
    return tuple(found)


_RPDO_COUNT = 4


def master_frames(config: AkdConfig) -> dict[int, str]:
    """Identifiers of those frames, and what each is in words.

    Args:
        config: Nodes of the drives and of the host.
    """
    known = {
        protocol.NMT: "NMT commands",
        protocol.SYNC: "SYNC",
        protocol.HEARTBEAT + config.host: f"a heartbeat of node {config.host}, the host's own",
    }
    for axis in config.axes:
        known[protocol.SDO_REQUEST + axis.node] = f"SDO requests to {axis.where}"
        for number in range(_RPDO_COUNT):
            command = protocol.RPDO1 + 0x100 * number + axis.node
            known[command] = f"RPDO{number + 1} to {axis.where}"
    return known


_STANDSTILL_TIMEOUT_S = 3.0
"""Longest wait in s for a drive that was found turning."""
_POLL_INTERVAL_S = 0.01
"""Time in s between two readings of the position."""
_STILL_MOTION_RAD = 5e-5
"""Motion in rad between them that counts as none."""

_STATES_TO_SWITCH_OFF = {
    DriveState.OPERATION_ENABLED,
    DriveState.QUICK_STOP,
    DriveState.FAULT_REACTION,
}


def take_torque_away(remote: Remote) -> None:
    """Bring a drive from any state to rest without torque, whatever its quick stop option is.

    With option 6 (605Ah), and by one reading of the manual with every option, a quick stop ends
    at rest with torque: then, and when it takes too long, the voltage is disabled.

    Raises:
        DriveError: If the drive does not answer, keeps its torque, or does not stop.
    """
    remote.write(0x60FF, 0, 0)
    network = remote.network
    deadline = network.now() + _STANDSTILL_TIMEOUT_S
    while (
        state := protocol.state(remote.read(0x6041))
    ) in _STATES_TO_SWITCH_OFF and network.now() < deadline:
        resting = _measure_motion(remote) < _STILL_MOTION_RAD
        over = state is DriveState.QUICK_STOP and resting
        remote.write(0x6040, 0, protocol.DISABLE_VOLTAGE if over else protocol.QUICK_STOP)
    remote.write(0x6040, 0, protocol.DISABLE_VOLTAGE)
    status = remote.read(0x6041)
    if protocol.state(status) in _STATES_TO_SWITCH_OFF:
        detail = f"keeps its torque (status word {status:04X}h); open the STO circuit, then look"
        raise remote.wrong(detail)
    deadline = network.now() + _STANDSTILL_TIMEOUT_S
    while _measure_motion(remote) >= _STILL_MOTION_RAD:
        if network.now() > deadline:
            raise remote.wrong("does not stop")


def _measure_motion(remote: Remote) -> float:
    """Motion in rad at the cam shaft within the time between two readings."""
    before = remote.read(0x6064)
    remote.network.pump(_POLL_INTERVAL_S)
    return abs(difference(remote.read(0x6064), before) * remote.axis.position)


_PER_UNIT = 1000
_MAX_MOTOR_FACTOR = 1.5
"""Factor by which the drive's motor may differ from the datasheet's."""
_CURRENT_STEP_A = 0.1
"""Step in A to which the limit is rounded up."""


def current_limit(remote: Remote, config: AkdConfig) -> tuple[int, str]:
    """The current that gives the torque limit, in counts of IL.LIMITP (356Eh) and in words.

    Raises:
        DriveError: If the drive's motor is not the one configured, or its currents count unlike.
    """
    axis = remote.axis
    continuous, constant = remote.read(0x358E), remote.read(0x3593)
    motor = continuous * constant / _PER_UNIT**2
    known = (
        f"MOTOR.ICONT {continuous / _PER_UNIT:g} A times MOTOR.KT {constant / _PER_UNIT:g} N m/A"
    )
    if (
        not config.motor_torque / _MAX_MOTOR_FACTOR
        <= motor
        <= config.motor_torque * _MAX_MOTOR_FACTOR
    ):
        detail = (
            f"{known} are {motor:.3g} N m, the motor's continuous torque is "
            f"{config.motor_torque:g}; choose the motor in the drive, or set drives.motor_torque"
        )
        raise remote.wrong(detail)
    found = remote.read(0x356E)
    if found and not continuous / 100 <= found <= 100 * continuous:
        detail = (
            f"IL.LIMITP (356Eh) holds {found} and MOTOR.ICONT (358Eh) {continuous}: they do not "
            "count alike; set IL.LIMITP to the motor's peak current in the drive"
        )
        raise remote.wrong(detail)
    amperes = config.torque_limit / axis.gear / (constant / _PER_UNIT)
    amperes = _CURRENT_STEP_A * math.ceil(amperes / _CURRENT_STEP_A - 1e-9)
    words = f"torque {amperes * axis.gear * constant / _PER_UNIT:.3g} N m ({amperes:.3g} A)"
    return round(amperes * _PER_UNIT), words


DEVICE_TYPE = 0x00020192
_PROFILE_VELOCITY_BIT = 1 << 2
"""Bit of 6502h; a drive with all bits 0 does not report its modes."""
QUICK_STOP_THEN_OFF = 2

_LISTEN_BEFORE_S = 0.1
"""Time in s of listening before anything is sent: long enough for a second host's heartbeat."""
_DUPLICATE_LISTEN_S = 0.05
"""Time in s in which a second node with the same id would answer too."""
_POWERED_ANSWER_TIMEOUT_S = 0.25
"""Longest wait in s for an SDO answer while a drive may have torque; an AKD takes some ms."""
_BUS_SETTLE_S = 0.02
"""Time in s after which nothing of an earlier exchange is on its way any more."""


def monitoring(config: AkdConfig) -> int:
    """Value of 1016h:1: the host's node, and the silence in ms after which the drive stops."""
    return config.host << 16 | round(config.silence * 1e3)


def bring_up(
    bus: can.BusABC,
    config: AkdConfig,
    *,
    now: Callable[[], float] = time.monotonic,
) -> tuple[SettingsFound, ...]:
    """Take both drives from any state to operational, monitored, without torque.

    The host must send its heartbeat from now on. On an error no drive that answers has torque.

    Args:
        bus: The open bus; nobody else may read it meanwhile.
        config: What the drives are set to.
        now: Monotonic time in s.

    Returns:
        What each drive was found to be.

    Raises:
        DriveError: If a drive is absent, is of a wrong type, or refuses a setting.
    """
    network = Network(bus, config.answer, now)
    network.pump(_LISTEN_BEFORE_S)
    _alone(network, config)
    for axis in config.axes:
        _command(network, protocol.PRE_OPERATIONAL, axis)
    network.pump(_BUS_SETTLE_S)
    remotes = [Remote(network, axis) for axis in config.axes]
    _without_torque(network, remotes)
    found = []
    for remote in remotes:
        found.append(_configure(remote, config))
        _map_pdos(remote)
    for remote in remotes:
        remote.write(0x1016, 1, monitoring(config))
    for remote in remotes:
        _operational(network, remote.axis, config)
    _alone(network, config)
    return tuple(found)


def _alone(network: Network, config: AkdConfig) -> None:
    """Make sure that nobody else commands the drives, or would keep them going in our place."""
    for identifier, words in master_frames(config).items():
        if identifier in network.identifiers:
            where = f"CAN {config.bus}"
            raise DriveError(c.SECOND_MASTER, where, f"a second master sends {words}; end it first")


def _command(network: Network, command: int, axis: AxisConfig) -> None:
    network.send(protocol.NMT, bytes((command, axis.node)))


def _without_torque(network: Network, remotes: list[Remote]) -> None:
    """Identify every drive and take its torque away; one that is wrong spares no other.

    A drive that falls silent here is given up soon: the next one may have torque.
    """
    failures = []
    patience, network.answer = network.answer, min(network.answer, _POWERED_ANSWER_TIMEOUT_S)
    for remote in remotes:
        try:
            _identify(network, remote)
            take_torque_away(remote)
        except DriveError as error:
            failures.append(error)
    network.answer = patience
    if failures:
        raise failures[0]


def _identify(network: Network, remote: Remote) -> None:
    """Make sure that exactly one AKD answers to the node's id."""
    axis = remote.axis
    before = network.answers.get(axis.node, 0)
    network.request(axis.node, 0x1000, 0, protocol.encode_sdo_read(0x1000, 0))
    network.pump(_DUPLICATE_LISTEN_S)
    answers = network.answers.get(axis.node, 0) - before
    if not answers:
        if network.bus_errors:
            detail = "does not answer and the bus reports errors; check the bit rate"
            raise DriveError(c.BIT_RATE, axis.where, detail)
        raise DriveError(c.NODE_ABSENT, axis.where, absent(network, axis))
    if answers > 1:
        detail = f"{answers} devices answer to this id; give every drive its own"
        raise DriveError(c.DUPLICATE_ID, axis.where, detail)
    expected = [(0x1000, 0, DEVICE_TYPE, "device type"), (0x1018, 1, AKD_VENDOR_ID, "vendor")]
    if axis.product is not None:
        expected.append((0x1018, 2, axis.product, "product code"))
    for index, sub, value, name in expected:
        actual = remote.read(index, sub)
        if actual != value:
            detail = f"{name} is {actual:#x}, an AKD has {value:#x}"
            raise DriveError(c.WRONG_IDENTITY, axis.where, detail)


class SettingsFound(NamedTuple):
    """The identity and the settings that a drive has after its bring-up, in words.

    Attributes:
        units: What its counts mean.
        limits: The nets in the drive.
        faults: Numbers of its present faults, oldest first.
        preconditions: Settings that the host does not write.
    """

    units: str
    limits: str
    faults: tuple[int, ...]
    preconditions: tuple[Precondition, ...]


def _configure(remote: Remote, config: AkdConfig) -> SettingsFound:
    """Set everything but the PDOs, computed from the drive's own units."""
    axis = remote.axis
    speed, accel = read_units(remote)
    modes = remote.read(0x6502)
    if modes and not modes & _PROFILE_VELOCITY_BIT:
        detail = f"has no profile velocity mode (6502h = {modes:X}h)"
        raise remote.wrong(detail)
    try:
        limit = speed.counts(config.rate_limit * axis.gear)
        ramp = accel.counts(config.ramp * axis.gear)
    except ValueError as error:
        raise remote.wrong(f"{error}; set 365Fh and 3659h to 0") from error
    current, torque = current_limit(remote, config)
    for index, sub, value in (
        (0x1005, 0, protocol.SYNC),
        (0x6060, 0, protocol.PROFILE_VELOCITY),
        (0x605A, 0, QUICK_STOP_THEN_OFF),
        (0x6083, 0, ramp),
        (0x6084, 0, ramp),
        (0x207F, 0, limit),
        (0x3622, 0, limit),
        (0x3623, 0, -limit),
        (0x356E, 0, current),
        (0x356F, 0, -current),
        (0x60C2, 1, round(config.period * 1e3)),
        (0x60C2, 2, -3),
        (0x1017, 0, round(config.heartbeat * 1e3)),
    ):
        remote.write(index, sub, value)
    return SettingsFound(
        units=f"target velocity in 0.001 rpm; limits in {speed.unit} (365Fh), {speed.words(1)} "
        f"a count; ramps in {accel.unit} (3659h), {accel.words(1)} a count",
        limits=f"speed {speed.words(remote.read(0x3622))}, "
        f"ramps {accel.words(remote.read(0x6083))}, {torque}",
        faults=_faults(remote),
        preconditions=read_preconditions(remote, config),
    )


def _faults(remote: Remote) -> tuple[int, ...]:
    if protocol.state(remote.read(0x6041)) is not protocol.DriveState.FAULT:
        return ()
    numbers = (remote.read(0x2001, place) for place in (1, 2))
    return tuple(number for number in numbers if number)


_PDO_IDENTIFIERS = {0x1400: protocol.RPDO1, 0x1800: protocol.TPDO1, 0x1801: protocol.TPDO2}


def _map_pdos(remote: Remote) -> None:
    """Map what is exchanged at every SYNC, and switch every other PDO off."""
    node, axis = remote.axis.node, remote.axis
    for number in range(4):
        for base, cob_id in ((0x1400, protocol.RPDO1), (0x1800, protocol.TPDO1)):
            remote.write(base + number, 1, cob_id + 0x100 * number + node | PDO_INVALID)
    for index, entries in protocol.pdo_maps(axis.plate_object).items():
        remote.map_pdo(index, _PDO_IDENTIFIERS[index] + node, entries)


def _operational(network: Network, axis: AxisConfig, config: AkdConfig) -> None:
    network.states.pop(axis.node, None)
    _command(network, protocol.START, axis)
    running = network.pump(
        3 * config.silence, lambda: network.states.get(axis.node) == protocol.OPERATIONAL
    )
    if not running:
        state = network.states.get(axis.node)
        name = "no heartbeat" if state is None else protocol.nmt_words(state)
        raise DriveError(c.NMT_LEFT, axis.where, f"does not become operational ({name})")
