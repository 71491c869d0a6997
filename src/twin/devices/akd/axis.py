"""One servo axis as the host sees it: its newest data, checked every cycle, and the next command.

A PDO carries no number, so its frames are counted: every SYNC owes one. A frame too many pays a
debt of the last cycles (late) or belongs to no SYNC at all (surplus). A PDO that lags by exactly
one period for good looks like one that was lost once; only its first cycle shows it. A cycle
that is checked sooner after its SYNC than an answer may take, because the host sent that SYNC late,
shows nothing about the drive: its frame is awaited until the next check.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from twin.base.errors import plural
from twin.devices.akd import conditions as c
from twin.devices.akd import protocol
from twin.devices.akd.agreement import HeartbeatCount, MotionAgreement
from twin.devices.akd.config import AkdConfig, AxisConfig, counts32
from twin.devices.akd.protocol import AxisRequest, DriveState, StatusBit
from twin.devices.common import FaultReports
from twin.hal.interface import Condition

_POSSIBLE_TORQUE_STATES = {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP, DriveState.UNKNOWN}
_POWERLESS_STATES = {
    DriveState.NOT_READY,
    DriveState.SWITCH_ON_DISABLED,
    DriveState.READY,
    DriveState.FAULT,
}
_RESET_CYCLES = 8
"""Cycles for which a request to reset stands."""
_QUICK_STOP_END_RAD_S = 0.01
"""Motor rate in rad/s that counts as standstill."""
_OWED_CYCLES = 25
"""Cycles after which a missing frame is no longer expected."""
_IRREGULARITY_CYCLES = 50
"""Cycles over which irregular PDOs are counted."""
ANSWER_SHARE = 0.8
"""Share of a period that a drive may take to answer a SYNC."""
_MAX_DOUBLED_CYCLES = 10
"""Cycles in a row with doubled PDOs that mean a second node with this id."""
_MAX_DISAGREEMENT_TRAVELS = 2
"""Travels without a count by which velocity and position may differ: one each way."""
_CYCLES_PROVING_OPERATION = 3
"""Cycles with both PDOs after which a heartbeat that denies PDOs must come from a second node."""


def difference(new: int, old: int) -> int:
    """Motion of a signed 32-bit counter, the shorter way round its wrap, in counts."""
    return (new - old + (1 << 31)) % (1 << 32) - (1 << 31)


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


class EncoderCounter:
    """A 32-bit position counter, unwrapped; implausible steps are left out.

    Args:
        unit: One count in rad; negative where signs differ.
        speed: Fastest plausible motion, rad/s.
        slack: Motion that is always plausible, rad.
    """

    def __init__(self, unit: float, speed: float, slack: float) -> None:
        self._unit = unit
        self.counts = 0
        """Position without wraps and jumps; starts at the first value of the drive."""
        self.jump = 0
        """Last step that was left out, in counts; whoever reports it sets it back to 0."""
        self.pdo = PdoTracker()
        """The PDO that carries it."""
        self.sampled = -float("inf")
        """Time in s of the SYNC that sampled it."""
        self.travel = self.quiet = 0.0
        """Motion in rad that should have been seen since the last count, and for how long, s."""
        self._speed = abs(speed / unit)
        self._slack = abs(slack / unit)
        self._raw: int | None = None

    @property
    def angle(self) -> float:
        """Position in rad."""
        return self.counts * self._unit

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

    def expect(self, rate: float, period: float) -> None:
        """Count a period of fresh data in which the motor should have turned at a rate in rad/s."""
        self.travel += rate * period
        self.quiet = self.quiet + period if self.travel else 0.0


class Axis:
    """A drive's newest data, its state, and the requested state; checked before every SYNC.

    Args:
        config: The axis.
        drives: Thresholds of what is plausible, and the period.
        reports: Where faults are reported.
        at: Time in s from which its heartbeat is awaited.
    """

    def __init__(
        self, config: AxisConfig, drives: AkdConfig, reports: FaultReports, *, at: float
    ) -> None:
        self._limits = limits = drives.watch
        self.config = config
        self._period = drives.period
        self._silence = drives.silence
        self._reports = reports
        self.motor = EncoderCounter(
            config.position, limits.jump * drives.rate_limit, limits.slack[0]
        )
        """The motor's encoder, in TPDO1."""
        self.plate = EncoderCounter(config.plate, limits.plate_rate, limits.slack[1])
        """The plate's encoder, in TPDO2."""
        self.status: int | None = None
        """Status word; None before the first."""
        self.state = DriveState.UNKNOWN
        self.mode: int | None = None
        self.rate = 0.0
        """Measured motor rate at the cam shaft, rad/s."""
        self.heartbeat = at
        """Time in s at which the last heartbeat arrived."""
        self._beats = HeartbeatCount(drives.heartbeat)
        self._agreement = MotionAgreement(
            _MAX_DISAGREEMENT_TRAVELS * limits.travel, drives.shaft_lag
        )
        self._heard: tuple[int, int] | None = None
        """NMT state of a heartbeat that is not operational, and the cycles since with both PDOs."""
        self.found_faults: tuple[int, ...] = ()
        """Numbers of the faults it was found with at the start, until they are reset."""
        self.emergency = ""
        """The newest emergency message in words."""
        self.request = AxisRequest.DISABLE
        self.target = 0.0
        """Rate to be sent while operation is enabled, rad/s at the cam shaft."""
        self.sent = 0.0
        """Rate sent last, rad/s."""
        self.stop_ignored = False
        """Whether the drive keeps its torque in spite of a quick stop."""
        self._reset_cycles = 0
        self._irregular: deque[bool] = deque(maxlen=_IRREGULARITY_CYCLES)
        self._emergencies: deque[float] = deque(maxlen=limits.burst)
        self._short = False
        self._was_enabled = False
        self._limited = self._lagging = 0.0
        self._request, self._requested = AxisRequest.DISABLE, 0.0
        self._resetting: float | None = None

    @property
    def enabled(self) -> bool:
        """Whether the drive follows its target."""
        return self.state is DriveState.OPERATION_ENABLED and self.request is AxisRequest.ENABLE

    @property
    def powerless(self) -> bool:
        """Whether its newest state shows a motor without torque."""
        return self.state in _POWERLESS_STATES

    def receive(self, service: int, data: bytes, cycle: int, sync: float, at: float) -> None:
        """Take in a frame of this node; any service, any bytes.

        Args:
            service: Its identifier without the node.
            data: Its bytes.
            cycle: Number of the last SYNC.
            sync: When that was sent, s.
            at: Time now, s.
        """
        if service in protocol.TPDOS:
            self._pdo(service, data, cycle, sync, at)
        elif service == protocol.HEARTBEAT:
            self._heartbeat(protocol.decode_nmt_state(data), at)
        elif service == protocol.EMERGENCY:
            self._emergency(protocol.decode_emergency(data), at)

    def _pdo(self, service: int, data: bytes, cycle: int, sync: float, at: float) -> None:
        values = protocol.decode_tpdo(service, data)
        if values is None:
            self._short = True
            name = "TPDO1" if service == protocol.TPDO1 else "TPDO2"
            self._report(c.PDO_SHORT, f"{name} with {plural(len(data), 'byte')}", at)
        elif service == protocol.TPDO1:
            self.status, self.mode, position = values
            self.state = protocol.state(self.status)
            self._take(self.motor, position, cycle, sync)
        else:
            velocity, position = values
            self.rate = velocity * self.config.velocity
            self._take(self.plate, position, cycle, sync)

    def _take(self, counter: EncoderCounter, raw: int, cycle: int, sync: float) -> None:
        elapsed = sync - counter.sampled
        if counter.pdo.owed:  # late ones arrive at once and are a period apart
            elapsed = max(elapsed, self._period)
        if counter.update(raw, elapsed):
            counter.travel = counter.quiet = 0.0
        counter.sampled = sync
        counter.pdo.arrive(cycle)

    def finish_quick_stop(self) -> None:
        """End a quick stop that has brought the drive out of operation, or to standstill."""
        resting = self.state is DriveState.QUICK_STOP and abs(self.rate) < _QUICK_STOP_END_RAD_S
        if self.request is AxisRequest.QUICK_STOP and (
            resting or self.state not in _POSSIBLE_TORQUE_STATES
        ):
            self.request = AxisRequest.DISABLE

    def next_rpdo1(self) -> bytes:
        """RPDO1 of this cycle: at most one transition further towards the request."""
        control = protocol.control_word(self.state, self.request)
        if self._reset_cycles and self.state is DriveState.FAULT:
            # The first cycle has no reset bit yet, so that there is an edge.
            first = self._reset_cycles == _RESET_CYCLES
            control = protocol.DISABLE_VOLTAGE if first else protocol.RESET
        self._reset_cycles = max(0, self._reset_cycles - 1)
        self.sent = self.target if self.enabled else 0.0
        return protocol.encode_rpdo1(control, counts32(self.sent, self.config.velocity))

    def reset(self, at: float) -> None:
        """Request one rising edge of the reset bit, if the drive is, or soon shows, in fault.

        It is watched whether that succeeds.
        """
        self._resetting = at
        self._reset_cycles = _RESET_CYCLES
        self.found_faults = ()

    def cycle(self, at: float, synced: float) -> None:
        """Check the cycle from its SYNC at ``synced`` to ``at`` (s), before the next SYNC."""
        self._judge_pdos(at, early=at - synced < ANSWER_SHARE * self._period)
        self._judge_node(at)
        if at - self.heartbeat > self._silence:
            silent = at - self.heartbeat
            self._report(c.HEARTBEAT_LOST, f"none for {1e3 * silent:.0f} ms", at)
        if self.status is not None:
            self._judge_status(self.status, at)
            self._judge_motion(at)
        self._judge_stop(at)

    def _report(self, condition: Condition, detail: str, at: float) -> None:
        self._reports.report(condition, self.config.where, detail, at)

    def _heartbeat(self, state: int | None, at: float) -> None:
        if state is None:
            return
        if state != protocol.OPERATIONAL:
            self._heard = self._heard or (state, 0)
        if self._beats.too_many(at):
            self._report(c.DUPLICATE_ID, "more heartbeats than one node sends", at)
        self.heartbeat = at

    def _judge_node(self, at: float) -> None:
        """Report a second node if a heartbeat denies operation, as this node sends PDOs."""
        if self._heard is None:
            return
        state, answered = self._heard
        self._heard = state, answered + 1
        if self.motor.pdo.missed or self.plate.pdo.missed:
            self._heard = None
            if state:
                self._report(c.NMT_LEFT, f"is {protocol.nmt_words(state)}", at)
            else:
                self._report(c.DRIVE_REBOOTED, "boot-up message in mid-run", at)
        elif answered + 1 == _CYCLES_PROVING_OPERATION:
            self._heard = None
            words = protocol.nmt_words(state) if state else "booting"
            self._report(
                c.DUPLICATE_ID, f"one node is {words} while a second one with its id runs", at
            )

    def _emergency(self, message: protocol.Emergency, at: float) -> None:
        self.emergency = message.words
        if message.short:
            self._report(c.EMERGENCY_SHORT, message.words, at)
        elif message.code:
            self._report(c.EMERGENCY_MESSAGE, message.words, at)
        self._emergencies.append(at)
        if len(self._emergencies) == self._limits.burst and at - self._emergencies[0] <= 1.0:
            self._report(c.EMERGENCY_BURST, f"{self._limits.burst} within 1 s", at)

    def _judge_pdos(self, at: float, *, early: bool) -> None:
        irregular, self._short = self._short, False
        doubled = True
        for name, pdo in (("TPDO1", self.motor.pdo), ("TPDO2", self.plate.pdo)):
            stats = pdo.close(early=early)
            irregular = irregular or stats != (False, 0, 0)
            doubled = doubled and pdo.doubled >= _MAX_DOUBLED_CYCLES
            if stats.missing:
                self._report(c.PDO_MISSING, f"{name}, {pdo.missed} in a row", at)
            if stats.late:
                self._report(c.PDO_LATE, f"{name}, {stats.late} of earlier cycles", at)
            if stats.surplus:
                self._report(c.PDO_WRONG_CYCLE, f"{name}, {stats.surplus} without a SYNC", at)
            if pdo.missed >= self._limits.stale:
                self._report(c.PDO_STALE, f"{name} missing for {pdo.missed} cycles", at)
        if doubled:
            self._report(c.DUPLICATE_ID, f"every PDO twice for {_MAX_DOUBLED_CYCLES} cycles", at)
        self._irregular.append(irregular)
        if (count := sum(self._irregular)) >= self._limits.unsteady:
            self._report(c.PDO_UNSTEADY, f"{count} of {len(self._irregular)} cycles irregular", at)

    def _judge_status(self, status: int, at: float) -> None:
        limits = self._limits
        words = f"status word {status:04X}h"
        if self.state in {DriveState.FAULT, DriveState.FAULT_REACTION}:
            found = protocol.fault_words(self.found_faults)
            known = f"found in fault: {found}" if found else self.emergency
            detail = ", ".join(filter(None, (words, known)))
            if self._resetting is None:
                self._report(c.DRIVE_FAULT, detail, at)
            elif at - self._resetting > limits.reset:
                self._resetting = None
                self._report(c.RESET_REFUSED, detail, at)
        elif self._resetting is not None and at - self._resetting > limits.reset:
            self._resetting = None
        if self.mode != protocol.PROFILE_VELOCITY:
            self._report(c.MODE_CHANGED, f"mode {self.mode}, not {protocol.PROFILE_VELOCITY}", at)
        if not status & StatusBit.REMOTE:
            self._report(c.REMOTE_LOST, f"{words}: a second tool controls the drive", at)
        if status & StatusBit.WARNING:
            self._report(c.DRIVE_WARNING, words, at)
        if self.request is AxisRequest.ENABLE:
            if not status & StatusBit.VOLTAGE:
                self._report(c.NO_DC_LINK, words, at)
            if self.state is DriveState.QUICK_STOP:
                self._report(c.QUICK_STOPPED, f"{words}: nobody here asked for it", at)
            elif self._was_enabled and self.state is not DriveState.OPERATION_ENABLED:
                self._report(c.DRIVE_DISABLED, f"{words}: {self.state.value}", at)
        self._was_enabled = self.enabled
        limited = status & StatusBit.INTERNAL_LIMIT and self.enabled
        self._limited = self._limited + self._period if limited else 0.0
        if self._limited > limits.limit_time:
            self._report(c.INTERNAL_LIMIT, f"{words} for {1e3 * self._limited:.0f} ms", at)

    def _judge_motion(self, at: float) -> None:
        limits, period = self._limits, self._period
        for name, counter in (("motor", self.motor), ("plate", self.plate)):
            if counter.jump:
                self._report(c.ENCODER_JUMP, f"{name} encoder by {counter.jump} counts", at)
                counter.jump = 0
        if not self.enabled:
            self.motor.travel = self.plate.travel = self._lagging = 0.0
            self._agreement.restart()
            return
        if not (self.motor.pdo.missed or self.plate.pdo.missed):
            off = self._agreement.take(self.plate.sampled, self.motor.angle, self.rate)
            if off > 0:
                detail = f"off by {off:.3f} rad more than allowed, at {self.rate:.2f} rad/s"
                if (ratio := self._agreement.ratio) > 0:  # neither unknown nor turned over
                    turns = f"the position turns {ratio:.1f} times as far as the velocity"
                    detail = f"{detail}; {turns}: check velocity_unit and gear"
                self._report(c.CONTRADICTION, detail, at)
        for counter, rate, most, condition, motion in (
            (self.motor, self.sent, limits.travel, c.MOTOR_FROZEN, "commanded"),
            (self.plate, self.rate, limits.plate_travel, c.PLATE_FROZEN, "of the motor"),
        ):
            if not counter.pdo.missed:
                counter.expect(rate, period)
            if abs(counter.travel) > most and counter.quiet > limits.frozen:
                self._report(condition, f"no count over {counter.travel:.3f} rad {motion}", at)
        lagging = abs(self.rate - self.sent) > limits.lag
        self._lagging = self._lagging + period if lagging else 0.0
        if self._lagging > limits.lag_time:
            detail = f"turns at {self.rate:.2f} rad/s, commanded {self.sent:.2f} rad/s"
            self._report(c.RUNAWAY, detail, at)

    def _judge_stop(self, at: float) -> None:
        if self.request is not self._request:
            self._request, self._requested = self.request, at
        torque = self.state in _POSSIBLE_TORQUE_STATES
        ignored = torque and at - self._requested > self._limits.stop
        if self._request is AxisRequest.QUICK_STOP and ignored:
            self.stop_ignored = True
            detail = f"still {self.state.value} after {self._limits.stop} s"
            self._report(c.STOP_IGNORED, detail, at)
