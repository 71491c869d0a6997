"""Bring-up of the drives over SDO: identity, safe settings, PDO mapping, heartbeats, current limit.

Currents count in 0.001 A and the torque constant in 0.001 N m/A, which the defaults of the vendor's
EDS suggest (MOTOR.ICONT 9900, MOTOR.IPEAK 29 700). Their product, the motor's continuous torque, is
known from its datasheet: it tells whether both are read rightly, and whether the drive knows its
motor.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

import can

from twin.devices.akd import cia402, frames
from twin.devices.akd import conditions as c
from twin.devices.akd.axis import difference
from twin.devices.akd.cia402 import DriveState
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.dictionary import PDO_INVALID, table
from twin.devices.akd.network import Network, Remote, absent
from twin.devices.akd.units import read_units

BY_HAND = (
    "DRV.TYPE is CANopen",
    "DRV.CMDSOURCE is 1 (fieldbus)",
    "with everything off there are 60 ohm between CANH and CANL: a terminator at either end",
)
"""What no object of the drive tells: to be looked at in WorkBench, and measured."""


class Precondition(NamedTuple):
    """One setting.

    Attributes:
        name: What it is called in the drive.
        seen: Its value in words.
        advice: What to do; empty if it is as it should be.
    """

    name: str
    seen: str
    advice: str


def read_preconditions(remote: Remote, config: AkdConfig) -> tuple[Precondition, ...]:
    """What the drive says; a setting that this drive does not have is left out.

    Raises:
        DriveError: If the drive does not answer.
    """
    found = []
    rate = remote.read_if_there(0x36E5)
    if rate is not None:
        found.append(_bit_rate(rate, config.bus.bitrate // 1000))
    for index, name, well, badly, advice in table()["flags"]:
        value = remote.read_if_there(index)
        if value is not None:
            seen = (well, "") if value else (badly, advice)
            found.append(Precondition(name, *seen))
    return tuple(found)


def _bit_rate(value: int, configured: int) -> Precondition:
    name = "FBUS.PARAM01 (bit rate)"
    if value == configured:
        return Precondition(name, f"{value} kbit/s", "")
    automatic = "automatic: found from the first frames at power-up"
    seen = f"{value} kbit/s from the next power-up on" if value else automatic
    return Precondition(name, seen, f"set it to {configured} in the drive and power-cycle it")


_RPDOS = 4


def master_frames(config: AkdConfig) -> dict[int, str]:
    """Identifiers of those frames, and what each is in words.

    Args:
        config: Nodes of the drives and of the host.
    """
    beat = frames.HEARTBEAT + config.host
    known = {
        frames.NMT: "NMT commands (000h)",
        frames.SYNC: "SYNC (080h)",
        beat: f"a heartbeat of node {config.host} ({beat:03X}h), "
        "so the drives would not notice that this host falls silent",
    }
    for axis in config.axes:
        for number in range(_RPDOS):
            command = frames.RPDO1 + 0x100 * number + axis.node
            known[command] = f"RPDO{number + 1} to {axis.where} ({command:03X}h)"
        request = frames.SDO_REQUEST + axis.node
        known[request] = f"SDO requests to {axis.where} ({request:03X}h)"
    return known


_PATIENCE = 3.0
"""Longest wait in s for a drive that was found turning."""
_POLL = 0.01
"""Time in s between two readings of the position."""
_STILL = 5e-5
"""Motion in rad between them that counts as none."""

_TORQUE = {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP, DriveState.FAULT_REACTION}


def take_torque_away(remote: Remote) -> None:
    """Bring a drive from any state to rest without torque, whatever its quick stop option says.

    With option 6 (605Ah), and by one reading of the manual with every option, a quick stop ends
    at rest with torque: then, and when it takes too long, the voltage is disabled.

    Raises:
        DriveError: If the drive does not answer, keeps its torque, or does not come to rest.
    """
    remote.write(0x60FF, 0, 0)
    network = remote.network
    deadline = network.now() + _PATIENCE
    while (state := cia402.state(remote.read(0x6041))) in _TORQUE and network.now() < deadline:
        resting = _moved(remote) < _STILL
        over = state is DriveState.QUICK_STOP and resting
        remote.write(0x6040, 0, cia402.DISABLE_VOLTAGE if over else cia402.QUICK_STOP)
    remote.write(0x6040, 0, cia402.DISABLE_VOLTAGE)
    status = remote.read(0x6041)
    if cia402.state(status) in _TORQUE:
        detail = f"keeps its torque (status word {status:04X}h); open the STO circuit, then look"
        raise remote.wrong(detail)
    deadline = network.now() + _PATIENCE
    while _moved(remote) >= _STILL:
        if network.now() > deadline:
            raise remote.wrong("does not come to rest")


def _moved(remote: Remote) -> float:
    """Motion in rad at the cam shaft within the time between two readings."""
    before = remote.read(0x6064)
    remote.network.pump(_POLL)
    return abs(remote.axis.position.value(difference(remote.read(0x6064), before)))


_PER_UNIT = 1000
_TRUST = 1.5
"""Factor by which the drive's motor may differ from the datasheet's."""
_STEP = 0.1
"""Step in A to which the limit is rounded up."""


class CurrentLimit(NamedTuple):
    """A current that the drive's controller does not pass.

    Attributes:
        counts: In the drive's counts.
        words: What it means.
    """

    counts: int
    words: str


def current_limit(remote: Remote, config: AkdConfig) -> CurrentLimit:
    """The current that gives the torque limit, in the counts of IL.LIMITP (356Eh).

    Raises:
        DriveError: If the drive's motor is not the one configured, or its currents count unlike.
    """
    axis = remote.axis
    continuous, constant = remote.read(0x358E), remote.read(0x3593)
    motor = continuous * constant / _PER_UNIT**2
    known = (
        f"MOTOR.ICONT {continuous / _PER_UNIT:g} A times MOTOR.KT {constant / _PER_UNIT:g} N m/A"
    )
    if not config.motor_torque / _TRUST <= motor <= config.motor_torque * _TRUST:
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
    amperes = _STEP * math.ceil(amperes / _STEP - 1e-9)
    words = f"torque {amperes * axis.gear * constant / _PER_UNIT:.3g} N m ({amperes:.3g} A)"
    return CurrentLimit(round(amperes * _PER_UNIT), words)


VENDOR = 0x6A
DEVICE = 0x00020192
PROFILE_VELOCITY = 3
_PROFILE_VELOCITY_BIT = 1 << 2
"""Bit of 6502h; 0 as a whole says nothing."""
QUICK_STOP_THEN_OFF = 2

_BEFORE = 0.1
"""Time in s that is listened before anything is sent: another host's heartbeat is heard in it."""
_LISTEN = 0.05
"""Time in s in which a second node with the same id would answer too."""
_PROMPT = 0.25
"""Longest wait in s for an SDO answer while a drive may have torque; an AKD takes some ms."""
_SETTLE = 0.02
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
        DriveError: If a drive is absent, is not what it should be, or refuses a setting.
    """
    network = Network(bus, config.answer, now)
    network.pump(_BEFORE)
    _alone(network, config)
    for axis in config.axes:
        _command(network, frames.PRE_OPERATIONAL, axis)
    network.pump(_SETTLE)
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
            raise DriveError(c.SECOND_MASTER, where, f"another master sends {words}; end it first")


def _command(network: Network, command: int, axis: AxisConfig) -> None:
    network.send(frames.NMT, bytes((command, axis.node)))


def _without_torque(network: Network, remotes: list[Remote]) -> None:
    """Identify every drive and take its torque away; one that is wrong spares no other.

    A drive that falls silent here is given up soon: the next one may have torque.
    """
    failures = []
    patience, network.answer = network.answer, min(network.answer, _PROMPT)
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
    network.request(axis.node, 0x1000, 0, frames.encode_sdo_read(0x1000, 0))
    network.pump(_LISTEN)
    answers = network.answers.get(axis.node, 0) - before
    if not answers:
        if network.bus_errors:
            detail = "does not answer and the bus reports errors; check the bit rate"
            raise DriveError(c.BIT_RATE, axis.where, detail)
        raise DriveError(c.NODE_ABSENT, axis.where, absent(network, axis))
    if answers > 1:
        detail = f"{answers} devices answer to this id; give every drive its own"
        raise DriveError(c.DUPLICATE_ID, axis.where, detail)
    expected = [(0x1000, 0, DEVICE, "device type"), (0x1018, 1, VENDOR, "vendor")]
    if axis.product is not None:
        expected.append((0x1018, 2, axis.product, "product code"))
    for index, sub, value, name in expected:
        actual = remote.read(index, sub)
        if actual != value:
            detail = f"{name} is {actual:#x}, an AKD has {value:#x}"
            raise DriveError(c.WRONG_IDENTITY, axis.where, detail)


class SettingsFound(NamedTuple):
    """What a drive was found to be, and what it keeps of what was set, in words.

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
    units = read_units(remote)
    modes = remote.read(0x6502)
    if modes and not modes & _PROFILE_VELOCITY_BIT:
        detail = f"has no profile velocity mode (6502h = {modes:X}h)"
        raise remote.wrong(detail)
    try:
        limit = units.velocity.counts(config.rate_limit * axis.gear)
        ramp = units.acceleration.counts(config.ramp * axis.gear)
    except ValueError as error:
        raise remote.wrong(f"{error}; set 365Fh and 3659h to 0") from error
    current = current_limit(remote, config)
    for index, sub, value in (
        (0x1005, 0, frames.SYNC),
        (0x6060, 0, PROFILE_VELOCITY),
        (0x605A, 0, QUICK_STOP_THEN_OFF),
        (0x6083, 0, ramp),
        (0x6084, 0, ramp),
        (0x207F, 0, limit),
        (0x3622, 0, limit),
        (0x3623, 0, -limit),
        (0x356E, 0, current.counts),
        (0x356F, 0, -current.counts),
        (0x60C2, 1, round(config.period * 1e3)),
        (0x60C2, 2, -3),
        (0x1017, 0, round(config.heartbeat * 1e3)),
    ):
        remote.write(index, sub, value)
    return SettingsFound(
        units=units.words,
        limits=f"speed {units.velocity.words(remote.read(0x3622))}, "
        f"ramps {units.acceleration.words(remote.read(0x6083))}, {current.words}",
        faults=_faults(remote),
        preconditions=read_preconditions(remote, config),
    )


def _faults(remote: Remote) -> tuple[int, ...]:
    if cia402.state(remote.read(0x6041)) is not cia402.DriveState.FAULT:
        return ()
    numbers = (remote.read(0x2001, place) for place in (1, 2))
    return tuple(number for number in numbers if number)


_IDENTIFIERS = {0x1400: frames.RPDO1, 0x1800: frames.TPDO1, 0x1801: frames.TPDO2}


def _map_pdos(remote: Remote) -> None:
    """Map what is exchanged at every SYNC, and switch every other PDO off."""
    node, axis = remote.axis.node, remote.axis
    for number in range(4):
        for base, cob_id in ((0x1400, frames.RPDO1), (0x1800, frames.TPDO1)):
            remote.write(base + number, 1, cob_id + 0x100 * number + node | PDO_INVALID)
    for index, entries in frames.pdo_maps(axis.plate_object).items():
        remote.map_pdo(index, _IDENTIFIERS[index] + node, entries)


def _operational(network: Network, axis: AxisConfig, config: AkdConfig) -> None:
    network.states.pop(axis.node, None)
    _command(network, frames.START, axis)
    running = network.pump(
        3 * config.silence, lambda: network.states.get(axis.node) == frames.OPERATIONAL
    )
    if not running:
        state = network.states.get(axis.node)
        name = "no heartbeat" if state is None else frames.nmt_words(state)
        raise DriveError(c.NMT_LEFT, axis.where, f"does not become operational ({name})")
