"""Monitoring of one axis: judges every cycle and reports faults."""

from __future__ import annotations

from collections import deque

from twin.devices.akd import conditions as c
from twin.devices.akd import frames
from twin.devices.akd.axis import Axis
from twin.devices.akd.bringup import PROFILE_VELOCITY
from twin.devices.akd.cia402 import AxisRequest, DriveState, StatusBit
from twin.devices.akd.conditions import FaultReports
from twin.devices.akd.config import AkdConfig, AxisConfig
from twin.hal.interface import Condition

_WINDOW = 50
"""Cycles over which irregular PDOs are counted."""
ANSWER = 0.8
"""Share of a period that a drive may take to answer a SYNC."""
_DOUBLED = 10
"""Cycles in a row with doubled PDOs that mean a second node with this id."""


class MonitoredAxis(Axis):
    """An axis that is judged before every SYNC.

    Args:
        config: The axis.
        drives: Thresholds and period.
        reports: Where faults are reported.
        at: Time in s from which its heartbeat is awaited.
    """

    def __init__(
        self, config: AxisConfig, drives: AkdConfig, reports: FaultReports, *, at: float
    ) -> None:
        super().__init__(config, drives, at=at)
        self._silence = drives.silence
        self._limits = drives.watch
        self._reports = reports
        self._irregular: deque[bool] = deque(maxlen=_WINDOW)
        self._emergencies: deque[float] = deque(maxlen=self._limits.burst)
        self._short = False
        self._was_enabled = False
        self._limited = self._lagging = 0.0
        self._travel = self._plate_travel = 0.0
        self._quiet = self._plate_quiet = 0.0
        self._request, self._requested = AxisRequest.DISABLE, 0.0
        self._resetting: float | None = None
        self.stop_ignored = False
        """Whether the drive keeps its torque in spite of a quick stop."""

    def receive(self, service: int, data: bytes, cycle: int, sync: float, at: float) -> None:
        """Take in a frame of this node; any service, any bytes."""
        if service == frames.TPDO1:
            motion = frames.decode_tpdo1(data)
            if motion is None:
                self._wrong_length("TPDO1", data, at)
            elif self.update_motion(motion, cycle, sync):
                self._travel = self._quiet = 0.0
        elif service == frames.TPDO2:
            feedback = frames.decode_tpdo2(data)
            if feedback is None:
                self._wrong_length("TPDO2", data, at)
            elif self.update_feedback(feedback, cycle, sync):
                self._plate_travel = self._plate_quiet = 0.0
        elif service == frames.HEARTBEAT:
            self._heartbeat(frames.decode_nmt_state(data), at)
        elif service == frames.EMERGENCY:
            self._emergency(frames.decode_emergency(data), at)

    def reset(self, at: float) -> None:
        """Request a fault reset, and watch whether it succeeds."""
        self._resetting = at
        self.request_reset()

    def cycle(self, at: float, synced: float) -> None:
        """Judge the cycle whose SYNC was sent at a time in s and that ends now, before the next."""
        self._judge_pdos(at, early=at - synced < ANSWER * self._period)
        if at - self.heartbeat > self._silence:
            silent = at - self.heartbeat
            self._report(c.HEARTBEAT_LOST, f"none for {1e3 * silent:.0f} ms", at)
        if self.status is not None:
            self._judge_status(self.status, at)
            self._judge_motion(at)
        self._judge_stop(at)

    def _report(self, condition: Condition, detail: str, at: float) -> None:
        self._reports.report(condition, self.config.where, detail, at)

    def _wrong_length(self, name: str, data: bytes, at: float) -> None:
        self._short = True
        self._report(c.PDO_SHORT, f"{name} with {len(data)} bytes", at)

    def _heartbeat(self, state: int | None, at: float) -> None:
        if state is None:
            return
        if state == 0:
            self.booted = True
            self._report(c.DRIVE_REBOOTED, "boot-up message in mid-run", at)
        elif state != frames.OPERATIONAL:
            self._report(c.NMT_LEFT, f"is {frames.nmt_words(state)}", at)
        elif self.booted:
            self._report(c.DUPLICATE_ID, "one node boots while another with its id runs", at)
        self.heartbeat = at

    def _emergency(self, message: frames.Emergency, at: float) -> None:
        self.emergency = message.words
        if message.short:
            self._report(c.EMERGENCY_SHORT, message.words, at)
        elif message.code:
            self._report(c.EMERGENCY, message.words, at)
        self._emergencies.append(at)
        if len(self._emergencies) == self._limits.burst and at - self._emergencies[0] <= 1.0:
            self._report(c.EMERGENCY_BURST, f"{self._limits.burst} within 1 s", at)

    def _judge_pdos(self, at: float, *, early: bool) -> None:
        irregular, self._short = self._short, False
        doubled = True
        for name, pdo in (("TPDO1", self.tpdo1), ("TPDO2", self.tpdo2)):
            stats = pdo.close(early=early)
            irregular = irregular or stats != (False, 0, 0)
            doubled = doubled and pdo.doubled >= _DOUBLED
            if stats.missing:
                self._report(c.PDO_MISSING, f"{name}, {pdo.missed} in a row", at)
            if stats.late:
                self._report(c.PDO_LATE, f"{name}, {stats.late} of earlier cycles", at)
            if stats.surplus:
                self._report(c.PDO_WRONG_CYCLE, f"{name}, {stats.surplus} without a SYNC", at)
            if pdo.missed >= self._limits.stale:
                self._report(c.PDO_STALE, f"{name} missing for {pdo.missed} cycles", at)
        if doubled:
            self._report(c.DUPLICATE_ID, f"every PDO twice for {_DOUBLED} cycles", at)
        self._irregular.append(irregular)
        if (count := sum(self._irregular)) >= self._limits.unsteady:
            self._report(c.PDO_UNSTEADY, f"{count} of {len(self._irregular)} cycles irregular", at)

    def _judge_status(self, status: int, at: float) -> None:
        limits = self._limits
        words = f"status word {status:04X}h"
        if self.state in {DriveState.FAULT, DriveState.FAULT_REACTION}:
            newest = self.newest_fault
            if self._resetting is None:
                self._report(c.DRIVE_FAULT, words + newest, at)
            elif at - self._resetting > limits.reset:
                self._resetting = None
                self._report(c.RESET_REFUSED, words + newest, at)
        elif self._resetting is not None and at - self._resetting > limits.reset:
            self._resetting = None
        if self.mode != PROFILE_VELOCITY:
            self._report(c.MODE_CHANGED, f"mode {self.mode}, not {PROFILE_VELOCITY}", at)
        if not status & StatusBit.REMOTE:
            self._report(c.REMOTE_LOST, f"{words}: another tool controls the drive", at)
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
            self._travel = self._plate_travel = self._lagging = 0.0
            return
        if not self.tpdo1.missed:
            self._travel += self.sent * period
            self._quiet = self._quiet + period if self._travel else 0.0
        if abs(self._travel) > limits.travel and self._quiet > limits.frozen:
            self._report(c.FROZEN, f"no count over {self._travel:.3f} rad commanded", at)
        if not self.tpdo2.missed:
            self._plate_travel += self.rate * period
            self._plate_quiet = self._plate_quiet + period if self._plate_travel else 0.0
        if abs(self._plate_travel) > limits.plate_travel and self._plate_quiet > limits.frozen:
            detail = f"no count over {self._plate_travel:.3f} rad of the motor"
            self._report(c.PLATE_FROZEN, detail, at)
        lagging = abs(self.rate - self.sent) > limits.lag
        self._lagging = self._lagging + period if lagging else 0.0
        if self._lagging > limits.lag_time:
            detail = f"turns at {self.rate:.2f} rad/s, commanded {self.sent:.2f} rad/s"
            self._report(c.RUNAWAY, detail, at)

    def _judge_stop(self, at: float) -> None:
        if self.request is not self._request:
            self._request, self._requested = self.request, at
        torque = self.state in {DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP}
        ignored = torque and at - self._requested > self._limits.stop
        if self._request is AxisRequest.QUICK_STOP and ignored:
            self.stop_ignored = True
            detail = f"still {self.state.value} after {self._limits.stop} s"
            self._report(c.STOP_IGNORED, detail, at)
