"""A rig of real devices: powered servos on a bus, a touch screen on a port, a real-time clock.

Servos and screen are of any kind (`devices/kinds.py`). The rig knows them only as `PoweredServos`
and `PoweredScreen`, which describe when each method is called.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.interfaces import Measurement
from twin.base.errors import RigError
from twin.devices.common import RELAXED
from twin.devices.realtime import RealTimeClock, Scheduling, TimingLog, real_time
from twin.hal.agreement import Agreement, BallAgreement
from twin.hal.interface import (
    AXIS_NAMES,
    NOMINAL_PERIOD,
    Condition,
    Fault,
    Limits,
    PoweredScreen,
    PoweredServos,
    Severity,
    Transmission,
)
from twin.hal.rig import Entry, Rig
from twin.hal.supervisor import BALL_LOST, State, Supervisor


class StartRefusedError(RigError):
    """A rig is not switched on, because of what a device reports.

    Args:
        fault: The report.
        line: The message.
    """

    def __init__(self, fault: Fault, line: str) -> None:
        self.fault = fault
        super().__init__(line)


FIRST_MOTION_RATE_RAD_S = math.radians(10.0)
"""Plate rate in rad/s of the first motion of a rig that nobody has checked."""
FIRST_MOTION_LIMIT_S = 3.0
"""Seconds after which it ends even where no encoders can show that motors and plate agree."""
UNCHECKED = Condition(
    "first motion slow",
    Severity.WARNING,
    NOMINAL_PERIOD,
    "noted; the plate turns at 10 deg/s at most until motors and plate agree, or for 3 s",
    "run `ballplate doctor --move` with this rig file",
)


class MotorPlateWatch:
    """Reports where motors and plate do not turn together.

    Args:
        servos: Who measures both.
        period: Control period in s.
    """

    def __init__(self, servos: PoweredServos, period: float) -> None:
        self._servos = servos
        self._period = period
        self._agreement: Agreement | None = None
        self.lost = servos.lost
        """Plate angle in rad that may be lost between motor and plate."""

    def begin(self, transmission: Transmission) -> None:
        """Compare what turns from now on, by a transmission."""
        self._agreement = Agreement(transmission, self.lost, self._period)

    @property
    def proven(self) -> bool:
        """Whether both axes have turned far enough to be known to agree."""
        return self._agreement is not None and self._agreement.proven

    def faults(self) -> tuple[Fault, ...]:
        """The disagreement that shows now, if any; each is reported once."""
        turned = self._servos.turned()
        if self._agreement is None or turned is None:
            return ()
        found = self._agreement.look(*turned)
        if found is None:
            return ()
        self._agreement = None
        return (
            Fault(
                found.condition, f"axis {AXIS_NAMES[found.axis]}", found.text, self._servos.now()
            ),
        )


class HardwareRig(Rig):
    """One real rig; as emulated devices speak the same bytes, they are driven by it, too.

    Entering blocks: the drives are brought up, the plate is declared to stand at ``home``,
    and the ball is waited for. Within, nothing waits but ``wait``.

    Args:
        servos: The servos, of any kind.
        screen: The touch screen.
        clock: Absolute deadlines of the period.
        transmission: Plate angles to motor angles.
        limits: What may be commanded.
        home: Plate angles (phi, theta) in rad at which the plate stands when switched on; the
            encoders are incremental.
        patience: Longest time in s that the ball is waited for.
        reset: Whether faults in the drives are reset when switching on: a person's request.
        relaxed: Safety nets that are wider than by default, in words; every run is warned of them.
        unchecked: Why its first motion must be slow, in words; empty where it need not.
        plate_lag: Time constant in s with which the plate follows its command.
        axes: Number of its axes; of 1, theta is never commanded, and theta and y read as 0.
        scheduling: Makes the loop's thread a real-time one while the rig is on.
    """

    POWER_ON = 1.0
    """Longest time in s from the request for torque to both drives following."""
    PLANNING = 60.0
    """Longest time in s that a controller may take to begin."""
    in_real_time = True
    MARGIN = 0.0005
    """Time in s before the end of a period at which waiting for answers ends."""

    def __init__(
        self,
        *,
        servos: PoweredServos,
        screen: PoweredScreen,
        clock: RealTimeClock,
        transmission: Transmission,
        limits: Limits,
        home: tuple[float, float] = (0.0, 0.0),
        patience: float = 30.0,
        reset: bool = False,
        relaxed: Sequence[str] = (),
        unchecked: str = "",
        plate_lag: float = 0.0,
        axes: int = 2,
        scheduling: Callable[[], AbstractContextManager[Scheduling]] = real_time,
    ) -> None:
        self._motors = MotorPlateWatch(servos, clock.period)
        super().__init__(
            servos=servos,
            screen=screen,
            clock=clock,
            transmission=transmission,
            supervisor=Supervisor(
                limits,
                clock.period,
                1,
                late=servos.late + 2 * plate_lag,
            ),
            period=clock.period,
            fault_sources=(servos, screen, clock, self._motors),
        )
        self.supervisor.axes = axes
        self.servos = servos
        self.screen = screen
        self.clock = clock
        self._home = np.array([home])
        self._patience = patience
        self.reset = reset
        """A person's request: reset the faults in the drives when the rig is switched on next."""
        self._relaxed = tuple(relaxed)
        self.unchecked = unchecked
        """Why the first motion after it is switched on must be slow, in words; empty for not."""
        self._ball = BallAgreement(clock.period)
        self.watches_roll = True
        """Whether a ball that rolls against the tilt stops the rig; the doctor looks for itself."""
        self._slow_periods = 0
        """Periods for which the plate still turns slowly, at most."""
        self._scheduling = scheduling
        self._on = ExitStack()
        self._obtained: Scheduling | None = None
        self._trip: float | None = None

    def _power_on(self) -> None:
        """Bring the devices up.

        Raises:
            TwinError: Whatever a device lacks, or that there is no ball; all is off again then.
        """
        with ExitStack() as on:
            self._obtained = on.enter_context(self._scheduling())
            self.screen.start()
            on.callback(self.screen.stop)
            on.callback(self.servos.stop)
            reset, self.reset = self.reset, False
            self.servos.start(reset=reset)
            self.clock.start()
            if reset:
                self._idle(lambda: False, 0.1)
            self._torque()
            self.servos.home(self._home, self._transmission.motor(self._home))
            self._idle(lambda: bool(self._screen.read().touched.all()), self._patience)
            if not self._screen.read().touched.all():
                detail = f"no ball within {self._patience:g} s of switching on"
                fault = Fault(BALL_LOST, self.screen.where, detail)
                raise StartRefusedError(fault, f"{fault.where}: {detail}")
            self._on = on.pop_all()

    def _hold(self) -> None:
        """Be ready; time and its statistics start at zero."""
        super()._hold()
        for words in self._relaxed:
            self.supervisor.report(Fault(RELAXED, "rig file", words))
        if self.unchecked:
            self.supervisor.report(Fault(UNCHECKED, "rig file", self.unchecked))
            self.supervisor.limit_rate(FIRST_MOTION_RATE_RAD_S)
            self._slow_periods = round(FIRST_MOTION_LIMIT_S / self.period)
        self._motors.begin(self._transmission)
        self._ball = BallAgreement(self.period)
        for fault in self.servos.warnings():
            self.supervisor.report(fault)
        self._exchange()
        self._start_clock()

    def meanwhile(self, work: Callable[[], None]) -> None:
        """Run a slow function in a thread of its own, while the devices stay in contact.

        Raises:
            StartRefusedError: If a device reports what a rig cannot be started with.
            Exception: What the work raises.
        """
        with ThreadPoolExecutor(1) as pool:
            done = pool.submit(work)
            self._idle(done.done, self.PLANNING)
            done.result()

    def start(self) -> None:
        """Let the controller move the plate from now on; time starts at zero again."""
        self._start_clock()
        super().start()

    def _start_clock(self) -> None:
        self.clock.timing = TimingLog(self.period)
        self.clock.start()
        self.clock.timing.begin()

    def _power_off(self) -> None:
        """No torque, ports closed, an ordinary thread again; what came up meanwhile is noted."""
        self._on.close()
        for fault in self.servos.faults():
            self.supervisor.report(fault)
            note = self.supervisor.notes.pop()
            self.journal.append(Entry(self.clock.since_start(fault.at), note))

    def read(self) -> Measurement:
        """The present measurement; a rig past a limit, or with a fault, is stopped here."""
        self.screen.note_plate(self.servos.plate())
        measurement = super().read()
        if self.supervisor.all_running and self.watches_roll:
            y, touched = measurement.y[0], bool(measurement.touched[0])
            found = self._ball.look(y[0::2], y[1::2], touched)
            if found is not None:
                self.supervisor.report(Fault(found[0], "plate", found[1], self.servos.now()))
        if self._slow_periods and self.supervisor.all_running:
            self._slow_periods -= 1
            if self._motors.proven or not self._slow_periods:
                self._slow_periods = 0
                self.supervisor.limit_rate(None)
        if self.supervisor.state[0] == State.FAULT:
            self.servos.quick_stop()
        self.clock.timing.mark("read")
        return measurement

    def write(self, rate: Array) -> Array:
        """Command plate rates (phi', theta') in rad/s, shape (1, 2); return those applied."""
        self.clock.timing.mark("control")
        applied = super().write(rate)
        self.servos.send()
        self.clock.timing.mark("write")
        return applied

    def replace_transmission(self, transmission: Transmission) -> None:
        """Use a new transmission from now on; the plate stays where it is."""
        super().replace_transmission(transmission)
        self._motors.begin(transmission)

    def wait(self) -> None:
        """Return at the beginning of the next control period."""
        self.clock.timing.mark("record")
        self.servos.settle(self.clock.left - self.MARGIN)
        self._trip = self.servos.round_trip
        if self._trip is not None:
            self.clock.timing.trips.add(self._trip)
        self.clock.wait()
        self.clock.timing.begin()
        self.servos.receive()
        self.screen.receive()

    def telemetry(self) -> dict[str, Array]:
        """How late the period began, the bus round trip before it, and the age of its angles."""
        trip = math.nan if self._trip is None else self._trip
        row = [self.clock.lateness, trip, float(self.servos.age().max())]
        return {"timing": np.array([row])}

    @property
    def scheduling(self) -> tuple[str, ...]:
        """Real-time rights that the operating system allowed, in words."""
        return self._obtained.words if self._obtained else ()

    def account(self) -> dict[str, Any]:
        """Timing statistics, and what the operating system allowed."""
        scheduling = self._obtained._asdict() if self._obtained else {}
        return {"ledger": self.clock.timing.as_dict(), "scheduling": scheduling}

    def _torque(self) -> None:
        self.servos.enable()
        self._idle(lambda: self.servos.enabled, self.POWER_ON)
        if not self.servos.enabled:
            raise RigError(f"drives: no torque within {self.POWER_ON:g} s of the request")

    def _exchange(self) -> None:
        """One period without a controller."""
        self.servos.send()
        self.servos.settle(self.clock.left - self.MARGIN)
        self.clock.wait()
        self.servos.receive()
        self.screen.receive()

    def _idle(self, done: Callable[[], bool], limit: float) -> None:
        """Exchange until something is done, at most for a time in s.

        Raises:
            StartRefusedError: If a device reports what a rig cannot be switched on with.
        """
        for _ in range(round(limit / self.period)):
            if done():
                return
            self._exchange()
            self.clock.faults()  # nothing moves yet: being late does no harm
            for device in (self.servos, self.screen):
                for fault in device.faults():
                    if fault.condition.severity is not Severity.WARNING:
                        raise StartRefusedError(fault, f"{fault}; {fault.condition.recovery}")
