"""A rig driven by a person: the loop of every run, in real time, with events between periods."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from controllers.interfaces import Measurement
from twin.base.data_file import read_packaged
from twin.base.errors import TwinError
from twin.play.driven import MAX_DRIVEN_S, Driven, DrivenRig, Part, States, Write, save_driven
from twin.run.controller_building import build_controller
from twin.run.loop import drive
from twin.run.metrics import Ending, Outcome
from twin.run.record import Recorder
from twin.scenario.changing import at_time
from twin.scenario.schema import Scenario


class Goal(NamedTuple):
    """Where the ball shall go, m, plate axes."""

    x: float
    y: float


class Push(NamedTuple):
    """Sudden change of the ball's velocity, m/s, plate axes."""

    x_rate: float
    y_rate: float


class Settings(NamedTuple):
    """New values of keys of plant, drives, sensors, law, observer and predictor."""

    values: Mapping[str, Any]


class Pause(NamedTuple):
    """Whether time stands still."""

    paused: bool


class Back(NamedTuple):
    """Go back by a time in s, to the last state kept before that; to the beginning at most."""

    seconds: float


class Save(NamedTuple):
    """Save what was driven so far as a run folder."""

    folder: Path


class Notification(NamedTuple):
    """The end of a background job, as saving a run: a message, and whether it failed."""

    message: str
    wrong: bool = False


class End(NamedTuple):
    """Nothing follows; what was driven since it was last saved is saved, if there is a folder."""

    folder: Path | None = None


Event = Goal | Push | Settings | Pause | Back | Save | Notification | End
Inbox = Callable[[float], Sequence[Event]]
"""Waits for events, at most a time in s, and gives those that have come, oldest first."""


MAX_AHEAD_S = 0.004
"""Seconds the simulation may be ahead of the clock, so that it need not sleep every period."""
MAX_BEHIND_S = 0.1
"""Largest delay behind the clock in s that the simulation makes up for."""
FACTOR_WINDOW_S = 1.0
"""Seconds over which the real-time factor is taken."""


class Pace:
    """When a simulated time is due by the clock.

    Args:
        clock: Seconds of the wall clock; tests give their own.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self._clock = clock
        self._passed: deque[tuple[float, float]] = deque()
        self.begin(0.0)

    def begin(self, time: float) -> None:
        """Let it be a simulated time in s now: at the start, after a pause, after going back."""
        self._zero = self._clock() - time
        self._passed.clear()

    def early(self, time: float) -> float:
        """Seconds to wait until a simulated time in s is due; 0 if it is."""
        now = self._clock()
        late = now - self._zero - time
        if late > MAX_BEHIND_S:
            self._zero += late - MAX_BEHIND_S
        self._passed.append((now, time))
        while now - self._passed[0][0] > FACTOR_WINDOW_S:
            self._passed.popleft()
        return -late if late < -MAX_AHEAD_S else 0.0

    @property
    def factor(self) -> float:
        """Simulated seconds a second of the clock, over the last second; 1 until it is known."""
        if not self._passed or self._passed[-1][0] - self._passed[0][0] < FACTOR_WINDOW_S / 10:
            return 1.0
        (wall, time), (wall_now, time_now) = self._passed[0], self._passed[-1]
        return (time_now - time) / (wall_now - wall)


PAGE_TABLES = read_packaged("twin.play", "page.toml")
"""Fields of the page, and where their values come from."""
PICTURE_COLUMNS = tuple(PAGE_TABLES["columns"])
"""Numbers of one picture: s, m, rad; the effort is the RMS of the plate's acceleration, rad/s^2,
since the picture before; ``factor`` is the simulated seconds a second of the clock."""


class Errors:
    """Root mean square distances of rig and clean model from where the ball shall be, so far."""

    def __init__(self) -> None:
        self._sums = [(-math.inf, 0.0, 0.0)]

    def add(self, rows: Sequence[Sequence[float]]) -> None:
        """Take pictures in, oldest first; one before the last one forgets what followed it."""
        for row in rows:
            now = dict(zip(PICTURE_COLUMNS, row, strict=True))
            while self._sums[-1][0] >= now["time"]:
                self._sums.pop()
            _, rig, clean = self._sums[-1]
            self._sums.append(
                (now["time"], rig + now["error"] ** 2, clean + now["ghost_error"] ** 2)
            )

    @property
    def rms(self) -> tuple[float, float]:
        """Errors of rig and clean model in m; NaN for a ball that has left the plate."""
        (_, rig, clean), count = self._sums[-1], max(1, len(self._sums) - 1)
        return math.sqrt(rig / count), math.sqrt(clean / count)


class Status(NamedTuple):
    """The texts of the page; sent when they change.

    Attributes:
        tables: The scenario as it is now.
        paused: Whether time stands still.
        ended: How the run ended, if it has: only going back goes on from there.
        message: What was done or refused last.
        wrong: Whether that message is of something refused.
    """

    tables: Mapping[str, Any]
    paused: bool = False
    ended: str = ""
    message: str = ""
    wrong: bool = False


Show = Callable[[tuple[float, ...]], None]
"""Called with the numbers of a picture, in the order of ``PICTURE_COLUMNS``."""
Tell = Callable[[Status], None]


PICTURE_INTERVAL_S = 0.02
"""Simulated seconds from one picture to the next."""
IDLE_WAIT_S = 0.05
"""Seconds after which a simulation that stands still looks about."""


class _RestartLoop(Exception):  # noqa: N818  no error: a stretch of the run is over
    """The loop is left and entered again, with a new state, controller or record."""


class Session:
    """One rig, its clean model, and the person who drives them.

    Args:
        scenario: What to begin with.
        inbox: Where the person's events come from.
        show: Called with the numbers of a picture.
        tell: Called with the texts of the page.
        pace: Keeps it in step with the clock.
        write: Writes what is to be saved; elsewhere, so that the simulation need not wait.
        paused: Whether time stands still to begin with.

    Attributes:
        driven: What was driven so far.
        record: Of it.
        outcome: How the run ended; None while it goes on.

    Raises:
        ScenarioError: If the scenario cannot be driven by hand.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        inbox: Inbox,
        show: Show = lambda _: None,
        tell: Tell = lambda _: None,
        pace: Pace | None = None,
        write: Write = save_driven,
        paused: bool = False,
    ) -> None:
        self.driven = self._first = Driven.begun(scenario)
        self._saved = 0, self.driven
        self.outcome: Outcome | None = None
        self._states = States()
        self._inbox, self._show, self._write = inbox, show, write
        self._pace = pace or Pace()
        self._events: deque[Event] = deque()
        self._over = self._again = False
        self._paused = paused
        self._tell, self._status, self._sent = tell, Status({}), Status({})
        self._every = max(1, round(PICTURE_INTERVAL_S / scenario.rig.period))
        self._both = DrivenRig(self.driven)
        rig = self._both.rig
        self.record = Recorder(round(MAX_DRIVEN_S / rig.period), 1, rig.period, rig.channels)

    def run(self) -> None:
        """Simulate until the person ends it."""
        begin = None
        self._say(0.0)
        self._pace.begin(0.0)
        while not self._over:
            try:
                rig, controller = self._both.rig, self._both.controller
                (self.outcome,) = drive(
                    rig, controller, MAX_DRIVEN_S, self.record, begin=begin, keep=self._turn
                )
                self._stand()
            except _RestartLoop:
                begin = self._begin

    def _begin(self, _: Measurement) -> Measurement:
        """Put the rig into the last state kept, with the controller that was chosen."""
        measurement = self._both.go_on(self._states.all[-1])
        self._keep(measurement)
        self._show(self._picture(measurement.time))
        self._say(measurement.time)
        return measurement

    def _turn(self, tick: int, measurement: Measurement) -> None:
        """Between two periods: wait for the clock, take events in, step the clean model."""
        time = measurement.time
        if self._states.due(time):
            self._keep(measurement)
        do = partial(self._do, measurement=measurement)
        self._take(self._inbox(self._pace.early(time)), do, time)
        while self._paused:
            self._take(self._inbox(IDLE_WAIT_S), do, time)
            self._pace.begin(time)
        if tick % self._every == 0:
            self._show(self._picture(time))
        self._both.ghost.step()

    def _take(self, events: Sequence[Event], do: Callable[[Event], None], time: float) -> None:
        """Do what the person wants; leaves the loop if that needs it to be entered again."""
        self._events += events
        if not self._events:
            return
        while self._events and not self._again:
            try:
                do(self._events.popleft())
            except TwinError as error:
                self._note(str(error), wrong=True)
        self._say(time)
        if self._again:
            self._again = False
            raise _RestartLoop

    def _do(self, event: Event, measurement: Measurement) -> None:
        time = measurement.time
        match event:
            case Goal(x, y):
                self.driven = self.driven.goal(time, x, y)
                self._both.follow(self.driven.reference)
            case Push(x_rate, y_rate):
                self.driven = self.driven.push(time, x_rate, y_rate)
                _, x_rate, y_rate = self.driven.pushes[-1]
                self._both.push(x_rate, y_rate)
                self._keep(measurement)
                self._note(f"pushed by {1000 * math.hypot(x_rate, y_rate):.0f} mm/s")
            case Settings(values):
                self._change(time, values, measurement)
            case _:
                self._do_ended(event, time)

    def _do_ended(self, event: Event, time: float) -> None:
        """Handle an event that is possible after the end of a run, too."""
        match event:
            case Pause(paused):
                self._paused = paused
                self._note("")
            case Back(seconds):
                self._go_back(time - seconds)
            case Save(folder):
                self._save(folder)
            case Notification(message, wrong):
                self._note(message, wrong=wrong)
            case End(folder):
                if folder is not None and self._unsaved:
                    self._save(folder)
                self._over = self._again = True
                self.outcome = self.outcome or Outcome(Ending.FINISHED, time)
            case _:
                raise TwinError("the run has ended; go back first")

    def _stand(self) -> None:
        """Wait after the end of the run, which can still be saved or set back."""
        assert self.outcome is not None
        time = self.record.end
        self._show(self._picture(time))
        self._say(time)
        while True:
            self._take(self._inbox(IDLE_WAIT_S), partial(self._do_ended, time=time), time)

    def _change(self, time: float, values: Mapping[str, Any], measurement: Measurement) -> None:
        """Have new values of settings from now on."""
        driven = self.driven.settings(time, values)
        controller = None
        if driven.controllers is not self.driven.controllers:
            controller = build_controller(driven.scenario)
            self._both.ghost.control(driven.scenario)
        self.driven = driven
        self._both.change(driven.scenario, time)
        self._note("")
        if controller is not None:
            self._keep(measurement)
            self._both.control(controller, driven.scenario)
            self._again = True

    def _go_back(self, time: float) -> None:
        """Go on from the last state kept before a time in s."""
        state = self._states.back_to(time)
        self.driven, self.record.length, self.outcome = state.driven, state.row, None
        self._both = DrivenRig(self.driven)
        self._pace.begin(state.time)
        self._note(f"back at {state.time:g} s")
        self._again = True

    def _keep(self, measurement: Measurement) -> None:
        """Keep the state of this moment."""
        self._states.keep(self._both.kept(measurement, self.record.length, self.driven))

    @property
    def _unsaved(self) -> bool:
        """Whether a person did something that is in no run folder."""
        done = self.driven is not self._first and self.record.length > 0
        return done and (self.record.length, self.driven) != self._saved

    def _save(self, folder: Path) -> None:
        """Have what was driven so far written."""
        if not self.record.length:
            raise TwinError("the run has not started yet")
        end = self.record.end
        self._write(
            Part(
                driven=self.driven,
                outcome=self.outcome or Outcome(Ending.FINISHED, end),
                record=self.record.of_rig(0),
                journal=tuple(self._both.rig.journal),
                factor=self._pace.factor,
            ),
            folder,
        )
        self._saved = self.record.length, self.driven
        self._note(f"saving to {folder}/")

    def _picture(self, time: float) -> tuple[float, ...]:
        """The numbers of a picture."""
        last = self.record["applied"][-self._every :] if self.record.length else None
        return self._both.picture(time, self.driven, last, self._pace.factor)

    def _note(self, message: str, *, wrong: bool = False) -> None:
        """Set the message that is sent next."""
        self._status = self._status._replace(message=message, wrong=wrong)
        if wrong:
            self._sent = Status({})  # sent again, as the page may show the refused value

    def _say(self, time: float) -> None:
        """Tell how things are, with the last message, if anything has changed."""
        now = at_time(self.driven.scenario, time)
        tables = now.model_dump(mode="json", exclude={"change", "reference"})
        ended = self.outcome
        why = "" if ended is None else f"{ended.ending}: {ended.reason}".rstrip(": ")
        status = self._status._replace(tables=tables, paused=self._paused, ended=why)
        if status != self._sent:
            self._sent = self._status = status
            self._tell(status)
