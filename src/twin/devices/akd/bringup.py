"""Bring-up of the drives over SDO: identity, settings, PDO mapping, heartbeat monitoring."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import can

from twin.devices.akd import cia402, frames
from twin.devices.akd.conditions import (
    BIT_RATE,
    DUPLICATE_ID,
    NMT_LEFT,
    NODE_ABSENT,
    SECOND_MASTER,
    WRONG_IDENTITY,
    WRONG_SETTING,
    DriveError,
)
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.devices.akd.current import current_limit
from twin.devices.akd.dictionary import PDO_INVALID
from twin.devices.akd.network import Network, Remote, absent
from twin.devices.akd.preconditions import Precondition, read_preconditions
from twin.devices.akd.second_master import master_frames
from twin.devices.akd.standstill import take_torque_away
from twin.devices.akd.units import read_units

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
            raise DriveError(SECOND_MASTER, where, f"another master sends {words}; end it first")


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
            raise DriveError(BIT_RATE, axis.where, detail)
        raise DriveError(NODE_ABSENT, axis.where, absent(network, axis))
    if answers > 1:
        detail = f"{answers} devices answer to this id; give every drive its own"
        raise DriveError(DUPLICATE_ID, axis.where, detail)
    expected = [(0x1000, 0, DEVICE, "device type"), (0x1018, 1, VENDOR, "vendor")]
    if axis.product is not None:
        expected.append((0x1018, 2, axis.product, "product code"))
    for index, sub, value, name in expected:
        actual = remote.read(index, sub)
        if actual != value:
            detail = f"{name} is {actual:#x}, an AKD has {value:#x}"
            raise DriveError(WRONG_IDENTITY, axis.where, detail)


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
        raise DriveError(WRONG_SETTING, axis.where, detail)
    try:
        limit = units.velocity.counts(config.rate_limit * axis.gear)
        ramp = units.acceleration.counts(config.ramp * axis.gear)
    except ValueError as error:
        raise DriveError(WRONG_SETTING, axis.where, f"{error}; set 365Fh and 3659h to 0") from error
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


def _map_pdos(remote: Remote) -> None:
    """Map what is exchanged at every SYNC, and switch every other PDO off."""
    node, axis = remote.axis.node, remote.axis
    for number in range(4):
        for base, cob_id in ((0x1400, frames.RPDO1), (0x1800, frames.TPDO1)):
            remote.write(base + number, 1, cob_id + 0x100 * number + node | PDO_INVALID)
    remote.map_pdo(0x1400, frames.RPDO1 + node, frames.RPDO1_MAP)
    remote.map_pdo(0x1800, frames.TPDO1 + node, frames.TPDO1_MAP)
    remote.map_pdo(0x1801, frames.TPDO2 + node, (frames.VELOCITY, axis.plate_object))


def _operational(network: Network, axis: AxisConfig, config: AkdConfig) -> None:
    network.states.pop(axis.node, None)
    _command(network, frames.START, axis)
    running = network.pump(
        3 * config.silence, lambda: network.states.get(axis.node) == frames.OPERATIONAL
    )
    if not running:
        state = network.states.get(axis.node)
        name = "no heartbeat" if state is None else frames.NMT_STATES.get(state, str(state))
        raise DriveError(NMT_LEFT, axis.where, f"does not become operational ({name})")
