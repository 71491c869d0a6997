"""Bring-up of the drives over SDO: identity, units, safe settings, PDO mapping, heartbeats."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import can

from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.axis import difference
from twin.devices.akd.conditions import DriveError
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.drive_units import current_limit, read_units
from twin.devices.akd.protocol import AKD_VENDOR_ID, PDO_INVALID, DriveState, table
from twin.devices.akd.remote import Network, Remote, absent

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
