"""The control loop: one controller, one rig or a batch, until the time is up or all have ended.

Many scenarios are the rigs of one batch, each with the result it has alone. What a run gives does
not depend, to the last bit, on what shares its batch: only scenarios that are ``alike`` are put
together, noise is drawn rig by rig, and foreign laws and plants are in groups large enough that
numpy and they calculate in one and the same way. Any rig within an episode may begin again while
the others go on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from controllers.catalog import origin
from controllers.controller import Controller
from controllers.interfaces import Measurement
from controllers.per_rig import PerRigReference
from twin.base.errors import ScenarioError, TwinError
from twin.base.settings import value_of
from twin.hal.rig import Rig
from twin.hal.supervisor import State
from twin.run import assemble, controller_building, plants, rig_changes
from twin.run.metrics import (
    INTERRUPTED_REASON,
    RAN_AWAY,
    Ending,
    Motion,
    Outcome,
    measure,
    outcome_only,
)
from twin.run.record import Recorder
from twin.scenario import Scenario
from twin.scenario.schema import CATALOG_TABLES, choices
from twin.sim.plant.interface import SomeRigs
from twin.sim.rig import SimulatedRig

Begin = Callable[[Measurement], Measurement]
Keep = Callable[[int, Measurement], None]


class RunMonitor:
    """Decides for each of N rigs whether and how its run has ended.

    Args:
        rig: The rigs.
    """

    STOP_WATCH = 2.0
    """Seconds a holding rig is watched further: its ball may come to rest or still fall."""

    def __init__(self, rig: Rig) -> None:
        self.outcomes: dict[int, Outcome] = {}
        self._rig = rig
        self._rigs = len(rig.supervisor.state)
        self._stopped = np.full(self._rigs, np.nan)

    def watch(self, measurement: Measurement) -> bool:
        """Take in a new period; return whether every rig has ended."""
        if self._rig.supervisor.all_running and not self._rig.any_fallen:
            return False
        self._note(measurement.time, self._rig.fallen)
        return len(self.outcomes) == self._rigs

    def examine(self, time: float) -> bool:
        """Find the rigs that have diverged, by any effect; return whether all have ended."""
        for rig in np.flatnonzero(self._rig.diverged).tolist():
            known = self.outcomes.get(rig)
            if known is None or known.ending is not Ending.DIVERGED:
                self.outcomes[rig] = Outcome(Ending.DIVERGED, time, RAN_AWAY)
        return len(self.outcomes) == self._rigs

    def _note(self, time: float, fallen: NDArray[np.bool_]) -> None:
        supervisor = self._rig.supervisor
        stopped = (supervisor.state == State.HOLDING) | (supervisor.state == State.FAULT)
        self._stopped = np.where(stopped & np.isnan(self._stopped), time, self._stopped)
        lost = supervisor.lost
        for rig in range(self._rigs):
            reason = supervisor.reason[rig]
            if rig in self.outcomes:
                continue
            if fallen[rig]:
                self.outcomes[rig] = Outcome(Ending.FELL, time, reason or "ball left the plate")
            elif supervisor.state[rig] == State.FAULT:
                self.outcomes[rig] = Outcome(Ending.FAULT, time, reason)
            elif lost[rig] and not supervisor.by_device[rig]:
                self.outcomes[rig] = Outcome(Ending.LOST, time, "the ball is no longer detected")
            elif time - self._stopped[rig] > self.STOP_WATCH:
                self.outcomes[rig] = self._stop(rig)

    def _stop(self, rig: int) -> Outcome:
        """The outcome of a rig that was stopped."""
        supervisor = self._rig.supervisor
        ending = Ending.FAULT if supervisor.by_device[rig] else Ending.ABORTED
        return Outcome(ending, float(self._stopped[rig]), supervisor.reason[rig])

    def final(self, time: float, otherwise: Ending, reason: str = "") -> list[Outcome]:
        """One outcome a rig; those that have not ended get the ending given."""
        self.examine(time)
        for rig in range(self._rigs):
            if rig not in self.outcomes:
                goes_on = np.isnan(self._stopped[rig])
                own = Outcome(otherwise, time, reason) if goes_on else self._stop(rig)
                self.outcomes[rig] = own
        return [self.outcomes[rig] for rig in range(self._rigs)]


def record_and_wait(
    rig: Rig,
    recorder: Recorder,
    measurement: Measurement,
    estimate: Array,
    requested: Array,
    applied: Array,
    further: Array,
    computing: Array | None = None,
    board: Array | None = None,
) -> Measurement:
    """Record a control period after its rate was written, and wait for the next.

    Args:
        rig: The rigs.
        recorder: Takes the period in.
        measurement: The one that began it.
        estimate: State that was believed in, shape (N, 8).
        requested: Plate accelerations that were asked for, rad/s^2, shape (N, 2).
        applied: Those that came of it, shape (N, 2).
        further: What was estimated beyond the state, shape (N, k).
        computing: How long the command is computed and how late it is, s, shape (N, 2).
        board: Of a controller that is a program, see ``ControlStep``, shape (N, 3).

    Returns:
        The measurement that begins the next.
    """
    channels = {
        "measured": measurement.y,
        "age": measurement.age,
        "touched": measurement.touched,
        "estimate": estimate,
        "requested": requested,
        "applied": applied,
        "supervisor": rig.supervisor.state,
    }
    if recorder.further:
        channels["further"] = further
    if computing is not None:
        channels["computing"] = computing
    if board is not None:
        channels["board"] = board
    recorder.append(measurement.time, channels | rig.telemetry())
    rig.wait()
    return rig.read()


def drive(
    rig: Rig,
    controller: Controller,
    duration: float,
    recorder: Recorder,
    progress: Callable[[float], None] = lambda _: None,
    *,
    begin: Begin | None = None,
    keep: Keep | None = None,
) -> list[Outcome]:
    """Run the loop until a time in s and return one outcome per rig.

    A rig with a ball that fell, was lost or passed a limit has ended; the others go on.
    Ctrl-C ends all of them as aborted, with the plate levelled and the record kept; in real time
    so does what a law raises.

    Args:
        rig: The rigs, not switched on.
        controller: Theirs.
        duration: Time of the run in s at which it ends.
        recorder: Takes every period in.
        progress: Called with the time in s now and then.
        begin: Begins in the middle of a run: puts rig and controller, just started, into a saved
            state and returns the measurement of that moment.
        keep: Shown number and measurement of every period before anything is done in it.
    """
    monitor = RunMonitor(rig)
    end, reason = Ending.FINISHED, ""
    with rig:
        measurement = rig.read()

        def start() -> None:
            controller.start(measurement)
            if rig.in_real_time or controller.timed:
                # a first command takes longer than a period: plans are laid, memory is touched
                controller.command(measurement)
                controller.start(measurement)

        rig.meanwhile(start)
        rig.start()
        if begin is not None:
            measurement = begin(measurement)
        try:
            for tick in range(round(measurement.time / rig.period), round(duration / rig.period)):
                if measurement.time > duration - rig.period / 2:
                    break
                if keep is not None:
                    keep(tick, measurement)
                step = controller.command(measurement)
                applied = controller.applied(rig.write(step.rate))
                decided = (step.estimate, step.acceleration, applied, *step[3:])
                measurement = record_and_wait(rig, recorder, measurement, *decided)
                if monitor.watch(measurement):
                    break
                if tick % 100 == 0:
                    progress(measurement.time)
                    if monitor.examine(measurement.time):
                        break
        except KeyboardInterrupt:
            end, reason = Ending.ABORTED, INTERRUPTED_REASON
        except (Exception, SystemExit) as error:
            # what a rig did is not made again: its record is kept
            reason = controller_building.line_of(error) if rig.in_real_time else ""
            if not reason:
                error.add_note(f"at {measurement.time:.3f} s")
                raise
            end = Ending.ABORTED
    return monitor.final(recorder.end, end, reason)


ROUNDING_PAIR = 2
"""Matrix products of a foreign law's rigs, a multiple of it, are rounded in the same way, whatever
the multiple: kernels of OpenBLAS take rows in pairs, and an odd one differently. Laws of this
program give each rig the same bits in a batch of any size."""

SEEN_EVERY = 5
"""Control periods from one instant to the next of what the rig's computer sees."""


def alike(scenario: Scenario) -> dict[str, Any]:
    """Settings that scenarios must share so that a common batch changes none of their bits.

    In addition to the shared keys of a batch, these are the keys that make a plant or an observer
    calculate in a different way.
    """
    friction = plants.build_friction([scenario])
    surface = None if friction is None or friction.map is None else friction.map
    return assemble.batch_keys(scenario) | {
        "observer": scenario.observer.model_dump(),
        "predictor": None if scenario.predictor is None else scenario.predictor.model_dump(),
        "model": repr(scenario.designed_on),
        "resisted": friction is not None,
        "free": friction is None or bool(friction.absent),
        "constant": friction is None or friction.constant,
        "ageing": friction is not None and friction.ageing,
        "balanced": not any(scenario.plant.ball.offset_mm),
        "level": any(scenario.plant.level_deg),
        "sloping": surface is not None and surface.sloping,
        "patches": surface is not None,
        "change": [change.model_dump() for change in scenario.change],
        "board": scenario.board is not None,
    }


@controller_building.own_errors()
def simulate(
    scenarios: Sequence[Scenario], *, seen: bool = False, requested: list[Array] | None = None
) -> list[dict[str, Any]]:
    """The indicators of each scenario, all of them alike.

    Args:
        scenarios: What to run.
        seen: Whether to judge what the rig's computer sees, the ball as estimated and the plate
            as its encoders count, every few periods; by default the truth of every period.
        requested: Takes in what each controller requested, rad/s^2, shape (ticks, 2).

    Raises:
        KeyboardInterrupt: If the user interrupts.
        TwinError: If rigs or controllers cannot be built.
    """
    refuse_faults(scenarios)
    order = _pad_batch(scenarios)
    first = scenarios[0]
    batch = [scenarios[i] for i in order]
    rig, controller = assemble.assemble(batch, threads=1, unseen=True, as_alone=False)
    ticks = round(first.duration / first.rig.period)
    late = [scenario.takes_time for scenario in scenarios]
    record = Recorder(
        ticks,
        len(order),
        first.rig.period,
        keep=(
            *(("estimate", "measured", "applied") if seen else ("state", "applied")),
            *(["computing"] if any(late) else ()),
            *(["requested", "supervisor", "board"] if first.board is not None else ()),
            *(["requested"] if requested is not None and first.board is None else ()),
        ),
        every=SEEN_EVERY if seen else 1,
    )
    with np.errstate(all="ignore"):
        outcomes = drive(rig, controller, first.duration, record)
    if any(outcome.interrupted for outcome in outcomes):
        raise KeyboardInterrupt
    reference = controller.reference
    paths = reference.members if isinstance(reference, PerRigReference) else (reference,)
    desired = {path: path(record.time)[0] for path in set(paths)}
    found = []
    for index, scenario in enumerate(scenarios):
        at = order.index(index)
        outcome = outcomes[at]
        if requested is not None:
            requested.append(record["requested"][:, at].copy())
        if outcome.ending is not Ending.FINISHED:
            found.append(outcome_only(outcome))
            continue
        motion = Motion.of(record, desired[paths[at]], at, seen=seen)
        if not late[index]:
            motion = replace(motion, lateness=None)
        axes = scenario.plant.axes
        found.append(measure(motion, outcome, axes=axes, **dict(scenario.metrics)))
    return found


def refuse_faults(scenarios: Sequence[Scenario]) -> None:
    """Refuse scenarios with faults that only the virtual rig can do to itself.

    Raises:
        ScenarioError: If one of them has any.
    """
    if any(each.fault for each in scenarios):
        raise ScenarioError(
            "[[fault]]: only the virtual rig can inject faults; run it on --rig emulated"
        )


def is_foreign(scenario: Scenario) -> bool:
    """Whether a law, observer or reference of a scenario is not part of this program."""
    return any(
        origin(choices(table)[getattr(scenario, table).kind]) is not None
        for table in CATALOG_TABLES
    )


def _pad_batch(scenarios: Sequence[Scenario]) -> list[int]:
    """Order of the scenarios by law; of foreign laws the last twice where its number is odd."""
    groups: dict[tuple[str, BallPlate], list[int]] = {}
    for index, scenario in enumerate(scenarios):
        groups.setdefault(controller_building.law_of(scenario), []).append(index)
    found: list[int] = []
    for its in groups.values():
        odd = len(its) % ROUNDING_PAIR if is_foreign(scenarios[its[0]]) else 0
        found += its + its[-1:] * odd
    lacking = max(0, plants.PLANTS[scenarios[0].plant.kind].least - len(found))
    return found + [found[-1]] * lacking


EPISODE_SHARED_KEYS = (
    "rig.limits",
    "rig.cams",
    "sensors.noise_hold",
    "sensors.encoders.counts",
    "change",
)
"""Keys in which all episodes must agree, besides those in which the rigs of any batch must."""


class Episodes:
    """N rigs, each within an episode: a run of its own, from its own start.

    Rigs are those of ``ballplate run``, noise and limits included. What they look at together stays
    in step with the first of them: every 20 ms the plate is measured again, over 40 ms each the
    ball's speed is checked. An episode that begins a multiple of 40 ms after them has the same bits
    as one that begins with them.

    Args:
        scenarios: One per rig, for its first episode.
        threads: Threads of the engine; 0 for one per processor.

    Raises:
        ScenarioError: If they differ in what all episodes must agree in, or change while running.
        ModelError: If the mechanism or its cam table cannot be used.

    Attributes:
        scenarios: One per rig, of its present episode.
        measurement: The newest: ``y`` = (x, phi, y, theta), shape (N, 4), m and rad.
        applied: Plate rates that were applied in the last period, rad/s, shape (N, 2).
        ticks: Control periods since each episode began, shape (N,).
    """

    measurement: Measurement
    applied: Array
    ticks: NDArray[np.integer]

    def __init__(self, scenarios: Sequence[Scenario], *, threads: int = 0) -> None:
        self.scenarios = list(scenarios)
        self._threads = threads
        self._common = _common(self.scenarios[0])
        self.period = self.scenarios[0].rig.period
        """Control period in s."""
        if self.scenarios[0].change:
            raise ScenarioError("change: rigs of episodes do not change while they run")
        self._all = np.arange(len(self.scenarios))
        self.begin(self._all, self.scenarios)

    @property
    def state(self) -> Array:
        """The true states, shape (N, 8), as no real rig knows them."""
        return self._rig.devices.state

    @property
    def over(self) -> Mask:
        """Rigs with a ball that left the plate, was lost or passed a limit, shape (N,)."""
        stopped: Mask = self._rig.supervisor.state != State.RUNNING
        return stopped | self._rig.fallen | self._rig.diverged

    def reasons(self, rigs: NDArray[np.integer]) -> list[str]:
        """Why the episodes of some rigs are over, in words."""
        stopped, diverged = self._rig.supervisor.reason, self._rig.diverged
        found = [stopped[rig] or "ball left the plate" for rig in rigs]
        return [RAN_AWAY if ran else text for ran, text in zip(diverged[rigs], found, strict=True)]

    def begin(self, rigs: NDArray[np.integer], scenarios: Sequence[Scenario]) -> None:
        """Let some rigs begin an episode; the others do not notice, to the last bit.

        Args:
            rigs: Numbers of those that begin, shape (k,).
            scenarios: What each of them is from now on.

        Raises:
            ScenarioError: If they differ in what all episodes must agree in.
            ModelError: If a number is out of range.
        """
        for scenario in scenarios:
            assemble.agree(self._common, _common(scenario), "all episodes")
        before = list(self.scenarios)
        for rig, scenario in zip(rigs.tolist(), scenarios, strict=True):
            self.scenarios[rig] = scenario
        try:
            self._begin(rigs, before)
        except TwinError:
            self.scenarios[:] = before  # the plant is still theirs
            raise

    def _begin(self, rigs: NDArray[np.integer], before: Sequence[Scenario]) -> None:
        """Let rigs begin with their present scenarios."""
        if len(rigs) == len(self._all):
            plant, transmission = plants.build_plant(self.scenarios, threads=self._threads)
            self._known = rig_changes.without_error(transmission)
            self._rig = assemble.build_rig(self.scenarios, plant, transmission)
            self.measurement = _own(_start_rigs(self._rig))
            self.applied = np.zeros((len(rigs), 2))
            self.ticks = np.zeros(len(rigs), int)
            return
        self._join(rigs, before)

    def _join(self, rigs: NDArray[np.integer], before: Sequence[Scenario]) -> None:
        """Let rigs be made of their present scenarios and begin among the others."""
        new, rig = [self.scenarios[each] for each in rigs], self._rig
        plant = rig.devices.plant
        old = [before[each] for each in rigs]
        plates = [[each.dimensions for each in those] for those in (old, new)]
        if plates[0] != plates[1] or rig_changes.differ(old, new, *rig_changes.OF_PLANTS):
            plants.PLANTS[new[0].plant.kind].rebuild(plant, rigs, self.scenarios)
        rig_changes.change_devices(rig.devices, before, self.scenarios, plant=False)
        rig_changes.change_transmission(rig, self._known, before, self.scenarios)
        begun = assemble.build_rig(
            new, SomeRigs(plant, rigs), plants.with_calibration_error(self._known, new)
        )
        seen = _start_rigs(begun)
        rig.devices.adopt(rigs, begun.devices)
        rig.adopt(rigs, begun)
        now = self.measurement
        for mine, theirs in ((now.y, seen.y), (now.age, seen.age), (now.touched, seen.touched)):
            mine[rigs] = theirs
        self.applied[rigs] = 0.0
        self.ticks[rigs] = 0

    def advance(self, rate: Array, ticks: int) -> Array:
        """Command plate rates for a number of control periods.

        Args:
            rate: Plate rates (phi', theta') in rad/s, shape (N, 2).
            ticks: How many.

        Returns:
            The true ball position after each, m, shape (ticks, N, 2).
        """
        rig, found = self._rig, np.empty((ticks, len(self._all), 2))
        for tick in range(ticks):
            self.applied = rig.write(rate)
            rig.wait()
            self.measurement = rig.read()
            found[tick] = rig.devices.state[:, 0::4]
        self.ticks = self.ticks + ticks
        self.applied, self.measurement = self.applied.copy(), _own(self.measurement)
        return found


def _start_rigs(rig: SimulatedRig) -> Measurement:
    """The first measurement of rigs that are switched on and started here.

    They are never switched off: a simulation holds nothing but memory.
    """
    rig.__enter__()
    seen = rig.read()
    rig.start()
    return seen


def _own(seen: Measurement) -> Measurement:
    """A measurement with arrays of its own: the values of rigs that begin are put into them."""
    y, age, touched = seen.y.copy(), seen.age.copy(), seen.touched.copy()
    return Measurement(seen.time, y, age, touched, seen.state)


def _common(scenario: Scenario) -> dict[str, object]:
    return assemble.batch_keys(scenario) | {
        key: value_of(scenario, key) for key in EPISODE_SHARED_KEYS
    }
