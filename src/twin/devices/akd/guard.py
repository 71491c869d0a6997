"""What is watched on one axis, cycle by cycle; everything found goes to the reports."""

from __future__ import annotations

from collections import deque

from twin.devices.akd import conditions as c
from twin.devices.akd import frames
from twin.devices.akd.axis import Axis
from twin.devices.akd.bringup import PROFILE_VELOCITY
from twin.devices.akd.cia402 import State, Status, Wish
from twin.devices.akd.config import AkdConfig
from twin.devices.akd.reports import Reports
from twin.devices.akd.stream import Stream
from twin.hal.faults import Condition

_WINDOW = 50
"""Cycles over which irregular PDOs are counted."""
_DOUBLES = 10
"""Cycles in a row with doubled PDOs that mean a second node with this id."""


class Guard:
    """Judges an axis before every SYNC.

    Args:
        axis: What is watched.
        config: Thresholds and period.
        reports: Where faults go.
    """

    def __init__(self, axis: Axis, config: AkdConfig, reports: Reports) -> None:
        self._axis = axis
        self._config = config
        self._watch = config.watch
        self._reports = reports
        self._irregular: deque[bool] = deque(maxlen=_WINDOW)
        self._emergencies: deque[float] = deque(maxlen=self._watch.burst)
        self._short = False
        self._was_enabled = False
        self._limited = self._lagging = 0.0
        self._travel = self._plate_travel = 0.0
        self._quiet = self._plate_quiet = 0.0
        self._wish, self._wished = Wish.OFF, 0.0
        self._resetting: float | None = None
        self.stop_ignored = False
        """Whether the drive keeps its torque in spite of a quick stop."""

    def frame(self, service: int, data: bytes, cycle: int, sync: float, at: float) -> None:
        """Take in a frame of this node; any service, any bytes."""
        axis = self._axis
        if service == frames.TPDO1:
            motion = frames.motion(data)
            if motion is None:
                self._wrong_length("TPDO1", data, at)
            elif axis.take_motion(motion, cycle, sync):
                self._travel = self._quiet = 0.0
        elif service == frames.TPDO2:
            sensors = frames.sensors(data, axis.plate is not None)
            if sensors is None:
                self._wrong_length("TPDO2", data, at)
            elif axis.take_sensors(sensors, cycle, sync):
                self._plate_travel = self._plate_quiet = 0.0
        elif service == frames.HEARTBEAT:
            self._heartbeat(frames.nmt_state(data), at)
        elif service == frames.EMERGENCY:
            self._emergency(frames.emergency(data), at)

    def ask_reset(self, at: float) -> None:
        """Reset a fault, and watch whether it goes; forget what was counted."""
        self._resetting = at
        self.stop_ignored = False
        self._wish = Wish.OFF
        self._axis.ask_reset()
        self._axis.motion, self._axis.sensors = Stream(), Stream()
        self._irregular.clear()
        self._emergencies.clear()
        self._travel = self._plate_travel = 0.0
        self._was_enabled = False

    def cycle(self, at: float) -> None:
        """Judge the cycle that ends at a time in s, before the next SYNC."""
        self._frames(at)
        axis = self._axis
        if at - axis.heartbeat > self._config.silence:
            silent = at - axis.heartbeat
            self._found(c.HEARTBEAT_LOST, f"none for {1e3 * silent:.0f} ms", at)
        if axis.status is not None:
            self._states(axis.status, at)
            self._motion(at)
        self._stopping(at)

    def _found(self, condition: Condition, detail: str, at: float) -> None:
        self._reports.report(condition, self._axis.config.where, detail, at)

    def _wrong_length(self, name: str, data: bytes, at: float) -> None:
        self._short = True
        self._found(c.PDO_SHORT, f"{name} with {len(data)} bytes", at)

    def _heartbeat(self, state: int | None, at: float) -> None:
        axis = self._axis
        if state is None:
            return
        if state == 0:
            axis.booted = True
            self._found(c.DRIVE_REBOOTED, "boot-up message in mid-run", at)
        elif state != frames.OPERATIONAL:
            self._found(c.NMT_LEFT, f"is {frames.NMT_STATES.get(state, str(state))}", at)
        elif axis.booted:
            self._found(c.DUPLICATE_ID, "one node boots while another with its id runs", at)
        axis.nmt, axis.heartbeat = state, at

    def _emergency(self, message: frames.Emergency, at: float) -> None:
        axis = self._axis
        axis.emergencies = [*axis.emergencies[-15:], message]
        if message.short:
            self._found(c.EMERGENCY_SHORT, message.words, at)
        elif message.code:
            self._found(c.EMERGENCY, message.words, at)
        self._emergencies.append(at)
        if len(self._emergencies) == self._watch.burst and at - self._emergencies[0] <= 1.0:
            self._found(c.EMERGENCY_BURST, f"{self._watch.burst} within 1 s", at)

    def _frames(self, at: float) -> None:
        axis = self._axis
        irregular, self._short = self._short, False
        doubled = True
        for name, stream in (("TPDO1", axis.motion), ("TPDO2", axis.sensors)):
            tally = stream.close()
            irregular = irregular or tally != (False, 0, 0)
            doubled = doubled and stream.doubled >= _DOUBLES
            if tally.missing:
                self._found(c.PDO_MISSING, f"{name}, {stream.missed} in a row", at)
            if tally.late:
                self._found(c.PDO_LATE, f"{name}, {tally.late} of earlier cycles", at)
            if tally.surplus:
                self._found(c.PDO_WRONG_CYCLE, f"{name}, {tally.surplus} without a SYNC", at)
            if stream.missed >= self._watch.stale:
                self._found(c.PDO_STALE, f"{name} missing for {stream.missed} cycles", at)
        if doubled:
            self._found(c.DUPLICATE_ID, f"every PDO twice for {_DOUBLES} cycles", at)
        self._irregular.append(irregular)
        if (count := sum(self._irregular)) >= self._watch.unsteady:
            self._found(c.PDO_UNSTEADY, f"{count} of {len(self._irregular)} cycles irregular", at)

    def _states(self, status: int, at: float) -> None:
        axis, watch = self._axis, self._watch
        words = f"status word {status:04X}h"
        if axis.state in {State.FAULT, State.FAULT_REACTION}:
            newest = f", {axis.emergencies[-1].words}" if axis.emergencies else ""
            if self._resetting is None:
                self._found(c.DRIVE_FAULT, words + newest, at)
            elif at - self._resetting > watch.reset:
                self._resetting = None
                self._found(c.RESET_REFUSED, words + newest, at)
        elif self._resetting is not None and at - self._resetting > watch.reset:
            self._resetting = None
        if axis.mode != PROFILE_VELOCITY:
            self._found(c.MODE_CHANGED, f"mode {axis.mode}, not {PROFILE_VELOCITY}", at)
        if not status & Status.REMOTE:
            self._found(c.REMOTE_LOST, f"{words}: another tool controls the drive", at)
        if status & Status.WARNING:
            self._found(c.DRIVE_WARNING, words, at)
        if axis.wish is Wish.ON:
            if not status & Status.VOLTAGE:
                self._found(c.NO_DC_LINK, words, at)
            if axis.state is State.QUICK_STOP:
                self._found(c.QUICK_STOPPED, f"{words}: nobody here asked for it", at)
            elif self._was_enabled and axis.state is not State.OPERATION_ENABLED:
                self._found(c.DRIVE_DISABLED, f"{words}: {axis.state.value}", at)
        self._was_enabled = axis.enabled
        limited = status & Status.INTERNAL_LIMIT and axis.enabled
        self._limited = self._limited + self._config.period if limited else 0.0
        if self._limited > watch.limit_time:
            self._found(c.INTERNAL_LIMIT, f"{words} for {1e3 * self._limited:.0f} ms", at)

    def _motion(self, at: float) -> None:
        axis, watch, period = self._axis, self._watch, self._config.period
        for name, counter in (("motor", axis.motor), ("plate", axis.plate)):
            if counter is not None and counter.jump:
                self._found(c.ENCODER_JUMP, f"{name} encoder by {counter.jump} counts", at)
                counter.jump = 0
        if not axis.enabled:
            self._travel = self._plate_travel = self._lagging = 0.0
            return
        if not axis.motion.missed:
            self._travel += axis.sent * period
            self._quiet = self._quiet + period if self._travel else 0.0
        if abs(self._travel) > watch.travel and self._quiet > watch.frozen:
            self._found(c.FROZEN, f"no count over {self._travel:.3f} rad commanded", at)
        if axis.plate is not None and not axis.sensors.missed:
            self._plate_travel += axis.rate * period
            self._plate_quiet = self._plate_quiet + period if self._plate_travel else 0.0
        if abs(self._plate_travel) > watch.plate_travel and self._plate_quiet > watch.frozen:
            detail = f"no count over {self._plate_travel:.3f} rad of the motor"
            self._found(c.PLATE_FROZEN, detail, at)
        lagging = abs(axis.rate - axis.sent) > watch.lag
        self._lagging = self._lagging + period if lagging else 0.0
        if self._lagging > watch.lag_time:
            detail = f"turns at {axis.rate:.2f} rad/s, told {axis.sent:.2f} rad/s"
            self._found(c.RUNAWAY, detail, at)

    def _stopping(self, at: float) -> None:
        axis = self._axis
        if axis.wish is not self._wish:
            self._wish, self._wished = axis.wish, at
        torque = axis.state in {State.OPERATION_ENABLED, State.QUICK_STOP}
        if self._wish is Wish.QUICK_STOP and torque and at - self._wished > self._watch.stop:
            self.stop_ignored = True
            detail = f"still {axis.state.value} after {self._watch.stop} s"
            self._found(c.STOP_IGNORED, detail, at)
