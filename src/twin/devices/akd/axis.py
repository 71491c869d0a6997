"""One servo axis as the host sees it: its newest data, and the control word that follows.

A PDO carries no number, so its frames are counted: every SYNC owes one. A frame too many pays a
debt of the last cycles (late) or belongs to no SYNC at all (surplus). A PDO that lags by exactly
one period for good looks like one that was lost once; only its first cycle shows it. A cycle that
is judged sooner after its SYNC than an answer may take, because the host was late with that SYNC,
says nothing of the drive: its frame is waited for until the next judgement.
"""

from __future__ import annotations

from typing import NamedTuple

from twin.devices.akd import cia402, frames
from twin.devices.akd.cia402 import AxisRequest, DriveState
from twin.devices.akd.config import AkdConfig, AxisConfig, Scale

_TORQUE = {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP, DriveState.UNKNOWN}
_POWERLESS = {
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY,
    DriveState.FAULT,
}
_RESET_CYCLES = 8
"""Cycles for which a request to reset stands."""
_STANDSTILL = 0.01
"""Motor rate in rad/s that counts as standstill."""
_OWED_CYCLES = 25
"""Cycles after which a missing frame is no longer expected."""


def difference(new: int, old: int) -> int:
    """Motion of a signed 32-bit counter, the shorter way round its wrap, in counts."""
    return (new - old + (1 << 31)) % (1 << 32) - (1 << 31)


class EncoderCounter:
    """A 32-bit position counter, unwrapped; implausible steps are left out.

    Args:
        scale: Counts to rad.
        speed: Fastest plausible motion, rad/s.
        slack: Motion that is always plausible, rad.
    """

    def __init__(self, scale: Scale, speed: float, slack: float) -> None:
        self.scale = scale
        self.counts = 0
        """Position without wraps and jumps; starts at the first value of the drive."""
        self.jump = 0
        """Last step that was left out, in counts; whoever reports it sets it back to 0."""
        self._speed = abs(speed / scale.unit)
        self._slack = abs(slack / scale.unit)
        self._raw: int | None = None

    @property
    def angle(self) -> float:
        """Position in rad."""
        return self.scale.value(self.counts)

    def update(self, raw: int, elapsed: float) -> int:
        """Take in the drive's counter, s after the last time; return the step in counts."""
        if self._raw is None:
            self.counts = self._raw = raw
            return 0
        step = difference(raw, self._raw)
        self._raw = raw
        if abs(step) > self._speed * elapsed + self._slack:
            self.jump = step
            return 0
        self.counts += step
        return step


class PdoCycleStats(NamedTuple):
    """Frames of one PDO in one cycle: whether missing, how many late, how many of no cycle."""

    missing: bool
    late: int
    surplus: int


class PdoTracker:
    """Counts the frames of one PDO per SYNC."""

    def __init__(self) -> None:
        self.cycle = 0
        """SYNC that the newest frame answers; 0 before the first."""
        self.missed = 0
        """Cycles in a row without a frame."""
        self.doubled = 0
        """Cycles in a row with surplus frames."""
        self.owed = 0
        """Frames of the last cycles that have not come and may still."""
        self._arrived = 0
        self._since = 0
        self._awaited = False

    def arrive(self, cycle: int) -> None:
        """Count a frame that arrives after this SYNC and before the next."""
        self.cycle = cycle
        self._arrived += 1

    def close(self, *, early: bool = False) -> PdoCycleStats:
        """Judge the cycle before the next SYNC is sent.

        Args:
            early: Whether that is sooner after the last SYNC than an answer may take. A frame that
                has not come yet is then waited for, once: until the next judgement.
        """
        arrived, self._arrived = self._arrived, 0
        due = 2 if self._awaited else 1
        self._awaited = early and arrived == due - 1
        self._since += 1
        if self._since > _OWED_CYCLES:
            self.owed = 0
        lacking = due - arrived - self._awaited
        if lacking > 0:
            self.missed = lacking if arrived else self.missed + lacking
            self.owed += lacking
            self._since = 0
            self.doubled = 0
            return PdoCycleStats(missing=True, late=0, surplus=0)
        late = min(max(0, arrived - due), self.owed)
        self.owed -= late
        surplus = max(0, arrived - due) - late
        if arrived:
            self.missed = 0
        self.doubled = self.doubled + 1 if surplus else 0
        return PdoCycleStats(missing=False, late=late, surplus=surplus)


class Axis:
    """A drive's newest data, its state, and what is requested of it.

    Args:
        config: The axis.
        drives: Thresholds of what is plausible.
        at: Time in s from which its heartbeat is awaited.
    """

    def __init__(self, config: AxisConfig, drives: AkdConfig, *, at: float) -> None:
        limits = drives.watch
        self.config = config
        self._period = drives.period
        self.motor = EncoderCounter(
            config.position, limits.jump * drives.rate_limit, limits.slack[0]
        )
        self.plate = EncoderCounter(config.plate, limits.plate_rate, limits.slack[1])
        self.tpdo1, self.tpdo2 = PdoTracker(), PdoTracker()
        self.sampled = -float("inf")
        """Time in s of the SYNC that sampled the motor position."""
        self.plate_sampled = -float("inf")
        self.status: int | None = None
        """Status word; None before the first."""
        self.state = DriveState.UNKNOWN
        self.mode: int | None = None
        self.rate = 0.0
        """Measured motor rate at the cam shaft, rad/s."""
        self.heartbeat = at
        """Time in s at which the last heartbeat arrived."""
        self.booted = False
        """Whether a boot-up message of the drive has arrived since the start."""
        self.found_faults: tuple[int, ...] = ()
        """Numbers of the faults it was found with at the start, until they are reset."""
        self.emergency = ""
        """The newest emergency message in words."""
        self.request = AxisRequest.DISABLE
        self.target = 0.0
        """Rate to be sent while operation is enabled, rad/s at the cam shaft."""
        self.sent = 0.0
        """Rate sent last, rad/s."""
        self._reset_cycles = 0

    @property
    def enabled(self) -> bool:
        """Whether the drive follows its target."""
        return self.state is DriveState.OPERATION_ENABLED and self.request is AxisRequest.ENABLE

    @property
    def powerless(self) -> bool:
        """Whether its newest state shows a motor without torque."""
        return self.state in _POWERLESS

    @property
    def newest_fault(self) -> str:
        """What is known of its fault beyond the status word, to be appended to that in words."""
        if self.found_faults:
            return f", found in fault: {frames.fault_words(self.found_faults)}"
        return f", {self.emergency}" if self.emergency else ""

    def update_motion(self, data: frames.MotionPdo, cycle: int, at: float) -> int:
        """Take in TPDO1 that answers a SYNC sent at a time in s; return the step in counts."""
        step = self.motor.update(data.position, self._passed(at - self.sampled, self.tpdo1))
        self.status, self.mode = data.status, data.mode
        self.state = cia402.state(data.status)
        self.sampled = at
        self.tpdo1.arrive(cycle)
        return step

    def update_feedback(self, data: frames.FeedbackPdo, cycle: int, at: float) -> int:
        """Take in TPDO2 that answers a SYNC sent at a time in s; return the plate's step."""
        passed = self._passed(at - self.plate_sampled, self.tpdo2)
        step = self.plate.update(data.plate, passed)
        self.rate = self.config.velocity.value(data.velocity)
        self.plate_sampled = at
        self.tpdo2.arrive(cycle)
        return step

    def _passed(self, elapsed: float, pdo: PdoTracker) -> float:
        """Time in s since a datum was sampled: late ones arrive at once and are a period apart."""
        return max(elapsed, self._period) if pdo.owed else elapsed

    def finish_quick_stop(self) -> None:
        """End a quick stop that has brought the drive out of operation, or to standstill."""
        resting = self.state is DriveState.QUICK_STOP and abs(self.rate) < _STANDSTILL
        if self.request is AxisRequest.QUICK_STOP and (resting or self.state not in _TORQUE):
            self.request = AxisRequest.DISABLE

    def request_reset(self) -> None:
        """Request one rising edge of the reset bit, if the drive is, or soon shows, in fault."""
        self._reset_cycles = _RESET_CYCLES
        self.found_faults = ()

    def next_rpdo1(self) -> bytes:
        """RPDO1 of this cycle: at most one transition further towards the request."""
        control = cia402.control_word(self.state, self.request)
        if self._reset_cycles and self.state is DriveState.FAULT:
            # The first cycle has no reset bit yet, so that there is an edge.
            first = self._reset_cycles == _RESET_CYCLES
            control = cia402.DISABLE_VOLTAGE if first else cia402.RESET
        self._reset_cycles = max(0, self._reset_cycles - 1)
        self.sent = self.target if self.enabled else 0.0
        return frames.encode_rpdo1(control, self.config.velocity.counts32(self.sent))
