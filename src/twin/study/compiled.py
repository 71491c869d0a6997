"""Runs of a study in C: plant, sensors, drives, observer and law of each rig in one compiled loop.

The loop joins the C source of a rig's FMU (``twin.fmu``) with the controller's
(``twin.board``) and is given the noise that the twin draws. Its runs are those of the exact
equations in numpy but for rounding. A run that does not finish is repeated in numpy, which states
why it ended.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Array
from twin.base.errors import ScenarioError, TwinError
from twin.base.followers import FOLLOWER_LABELS
from twin.base.parts import extra
from twin.base.programs import find_c_compiler, find_error_line
from twin.board.program import CONTROLLER_NAME
from twin.fmu.export import (
    RIG_SOURCES,
    add_token,
    c_source,
    compiled_in,
    first_values,
    frame_phase,
    read_sources,
    surface_of,
    variables,
)
from twin.run.controller_building import build_reference, control_of, own_errors
from twin.run.metrics import Ending, Motion, Outcome, measure
from twin.scenario.rig_tables import left_out
from twin.scenario.schema import Scenario, changed_in_vain
from twin.study.work import Job, Row, carry_out, controller_key, metrics_row, refusal, refused_row

LANES = 4
"""Rigs that are simulated side by side: so many numbers a processor calculates at once."""
LOOP_FLAGS = (
    *("-std=c99", "-O3", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden"),
    *("-fno-math-errno", "-fno-trapping-math", "-fopenmp-simd", f"-DLANES={LANES}"),
)
"""How the loop is compiled: without fused operations, so that it rounds as numpy does, and without
what stands in the way of calculating several rigs at once."""


MOST_CONTROLLERS = 32
"""Largest number of controllers where C is chosen for runs: every process compiles each."""
UNFOLLOWED = left_out("source")
"""Settings that the C source leaves out, by key, and why."""


def find_unknown(scenario: Scenario) -> Iterator[str]:
    """What of a scenario the compiled loop does not know, a line each."""
    if scenario.plant.kind != "lagrange":
        yield (
            f"plant.kind: must be lagrange with engine = c, got {scenario.plant.kind}; write "
            'set = ["plant.kind=lagrange"] in the file'
        )
    if scenario.fault:
        yield "[[fault]]: only the virtual rig has faults; engine = c simulates none"
    if scenario.change:
        yield "change: a rig does not change while it runs with engine = c"
    if scenario.takes_time or scenario.board is not None:
        yield "controller: engine = c has no computing time and no board"
    if scenario.sensors.ideal:
        yield "sensors.ideal: engine = c measures as a real rig does"
    for key in changed_in_vain(scenario, UNFOLLOWED):
        yield f"{key}: {FOLLOWER_LABELS['source']} {UNFOLLOWED[key]}"


def draw_noise(scenario: Scenario, count: int) -> list[Array | None]:
    """The noise of a rig by stream of ``rig.h``, of variance 1, as ``sim`` draws it from the seed.

    A rig that is switched on reads its encoders once before the first control period.

    Args:
        scenario: The scenario.
        count: Number of control periods.

    Returns:
        The numbers of each stream, shape (count,), those that are held repeated; None of a stream
        that the rig has no use for.
    """
    touch, encoders, servo = scenario.sensors.touch, scenario.sensors.encoders, scenario.plant.servo
    hold = round(max(scenario.sensors.noise_hold, scenario.rig.period) / scenario.rig.period)
    sources = (
        NoiseSource(any(touch.variance), spawned=0, channels=2, hold=hold),
        NoiseSource(any(encoders.variance), spawned=2, channels=2, hold=hold, before=1),
        NoiseSource(any(scenario.disturbance.variance), spawned=3, channels=2, hold=hold),
        NoiseSource(touch.dead_time_spread > 0, spawned=1000, channels=1, hold=hold),
        NoiseSource(servo.vibration_wander > 0, spawned=4, channels=4),
        NoiseSource(touch.frame_rate > 0, spawned=1001, channels=2),
    )
    return [stream for source in sources for stream in source.draw(scenario.seed, count)]


class NoiseSource(NamedTuple):
    """Where streams of noise come from.

    Attributes:
        used: Whether the rig has a use for them.
        spawned: Number of their seed among those that the seed of a rig's devices spawns.
        channels: Number of streams.
        hold: Control periods for which a draw is held.
        before: Draws before the first control period.
    """

    used: bool
    spawned: int
    channels: int
    hold: int = 1
    before: int = 0

    def draw(self, seed: int, count: int) -> Sequence[Array | None]:
        """The streams, shape (count,) each, or None, by the seed of the scenario."""
        if not self.used:
            return self.channels * [None]
        whole = self.before + count
        stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, self.spawned)))
        drawn = stream.standard_normal((-(-whole // self.hold), self.channels))
        return list(drawn.repeat(self.hold, axis=0)[self.before : whole].T)


class CompiledRuns:
    """The compiled loop of scenarios that differ in the parameters of their rigs alone.

    Args:
        scenario: One of them.
        surface: Its ``surface_of``.

    Raises:
        TwinError: If the controller has no form in C, or there is no compiler.
    """

    def __init__(self, scenario: Scenario, surface: Array | None) -> None:
        ticks = round(scenario.duration / scenario.rig.period)
        with TemporaryDirectory(prefix="ballplate-study-") as folder:
            library = ctypes.CDLL(str(compile_runs(scenario, surface, Path(folder))))
        self._simulate = library.simulate
        self._desired = np.empty((ticks, 5, 2))
        library.desire(ctypes.c_int64(ticks), _address(self._desired))
        self._found = np.empty((3, LANES, ticks, 2))
        self._good = np.empty(LANES, np.int32)
        self._time = scenario.rig.period * np.arange(ticks)
        self._path = build_reference(scenario)(self._time)[0].reshape(-1, 2)

    def run(self, rigs: Sequence[CompiledRig]) -> list[Motion | None]:
        """The motions of some rigs, at most ``LANES``.

        Args:
            rigs: The rigs.

        Returns:
            A motion each, in memory that the next call overwrites; None if its plate was levelled
            or its ball left the plate.
        """
        ticks = len(self._time)
        lanes = [rigs[min(lane, len(rigs) - 1)] for lane in range(LANES)]
        values = np.array([rig.values for rig in lanes])
        noise = {id(rig): draw_noise(rig.scenario, ticks + 1) for rig in rigs}
        numbers = [stream for rig in lanes for stream in noise[id(rig)]]
        self._simulate(
            _address(values),
            (ctypes.c_void_p * LANES)(*(_address(rig.surface) for rig in lanes)),
            (ctypes.c_void_p * len(numbers))(*map(_address, numbers)),
            (ctypes.c_int64 * len(numbers))(*map(_stride, numbers)),
            ctypes.c_int64(ticks),
            _address(self._desired),
            *map(_address, self._found),
            _address(self._good),
        )
        good = self._good & np.isfinite(self._found).all(axis=(0, 2, 3))
        return [
            Motion(time=self._time, ball=ball, plate=plate, u=applied, reference=self._path)
            if fine
            else None
            for fine, ball, plate, applied in zip(good[: len(rigs)], *self._found, strict=False)
        ]


class CompiledRig(NamedTuple):
    """A rig for the compiled loop.

    Attributes:
        scenario: Its scenario.
        surface: Its ``surface_of``.
    """

    scenario: Scenario
    surface: Array | None

    @property
    def values(self) -> Array:
        """The variables of the C source in their order."""
        framed = self.scenario.sensors.touch.frame_rate > 0
        return first_values(self.scenario, frame_phase(self.scenario) if framed else 0.0)


def _address(values: NDArray[Any] | None) -> ctypes.c_void_p | None:
    return None if values is None else values.ctypes.data_as(ctypes.c_void_p)


def _stride(values: Array | None) -> int:
    return 0 if values is None else values.strides[0] // values.itemsize


def compile_runs(scenario: Scenario, surface: Array | None, folder: Path) -> Path:
    """Compile the loop of a scenario in a folder.

    Returns:
        The library.

    Raises:
        ScenarioError: If the controller has no form in C.
        TwinError: If there is no compiler, or it fails.
    """
    with extra("casadi", "engine = c"):
        from twin.board.source import controller_parts, controller_sources  # noqa: PLC0415  heavy
    compiler = find_c_compiler()
    if compiler is None:
        raise TwinError("engine: c needs a C compiler (cc, gcc or clang); none is installed")
    parts = controller_parts(CONTROLLER_NAME, control_of(scenario), "double")
    fixed = c_source(scenario, surface, None)
    rig, _ = add_token(read_sources(*RIG_SOURCES) | fixed, variables(scenario, 0.0))
    texts = {
        **{name: text for name, text in rig.items() if name != "noise.c"},
        **read_sources("fmi.h"),
        **controller_sources(parts),
        **read_sources("batch.c", package="twin.study"),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    library = folder / "runs.so"
    files = [name for name in texts if name.endswith(".c")]
    done = subprocess.run(
        [compiler, *LOOP_FLAGS, "-o", library.name, *files, "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TwinError(f"engine: {compiler} failed: {find_error_line(done.stderr)}")
    return library


_compiled: dict[tuple[str, str], CompiledRuns] = {}
"""Compiled loops of this process, by controller and by what of a rig is compiled in."""


def compiled_runs(rig: CompiledRig, controller: str) -> CompiledRuns:
    """The compiled loop of a rig, made once in the life of this process.

    Args:
        rig: The rig.
        controller: The ``controller_key`` of its scenario.

    Raises:
        TwinError: If the controller has no form in C, or there is no compiler.
    """
    key = controller, repr(compiled_in(rig.scenario, rig.surface))
    if key not in _compiled:
        with own_errors():
            _compiled[key] = CompiledRuns(rig.scenario, rig.surface)
    return _compiled[key]


def knows(scenarios: Iterable[Scenario]) -> bool:
    """Whether the compiled loop can take all of some scenarios.

    There is a compiler, the loop knows all that they have, and they have at most
    ``MOST_CONTROLLERS`` controllers, each with a form in C.
    """
    if find_c_compiler() is None:
        return False
    check = KnownCheck()
    try:
        for scenario in scenarios:
            check(scenario)
            if check.more:
                return False
        check.check_controllers()
    except TwinError:
        return False
    return True


def check_known(scenario: Scenario) -> None:
    """Make sure that the compiled loop knows all of a rig.

    Raises:
        ScenarioError: If it does not: what, in a line.
    """
    for unknown in find_unknown(scenario):
        raise ScenarioError(unknown)


class KnownCheck:
    """Makes sure, before any of some runs begins, that the compiled loop knows all of each.

    It is called with every run, and then asked once for the controllers: whether one has a form in
    C takes longer and is asked of the first ``MOST_CONTROLLERS``; the others are asked when they
    are compiled. A controller that cannot be built is left to the run.

    Attributes:
        more: Whether there are more than ``MOST_CONTROLLERS`` controllers.
    """

    def __init__(self) -> None:
        self.more = False
        self._controllers = dict[str, Scenario]()

    def __call__(self, scenario: Scenario) -> None:
        """Check the scenario of a run, but for its controller.

        Raises:
            ScenarioError: If the loop does not know something: what, in a line.
        """
        check_known(scenario)
        controller = controller_key(scenario)
        if controller not in self._controllers:
            self.more = len(self._controllers) == MOST_CONTROLLERS
            if not self.more:
                self._controllers[controller] = scenario

    def check_controllers(self) -> None:
        """Check the controllers of the runs.

        Raises:
            TwinError: If one has no form in C, or what writes it is not installed.
        """
        for scenario in self._controllers.values():
            if refusal(scenario) is None:
                check_controller(scenario)


def check_controller(scenario: Scenario) -> None:
    """Make sure that the controller of a scenario has a form in C.

    Raises:
        TwinError: If it has none, or what writes it is not installed.
    """
    with extra("casadi", "engine = c"):
        from twin.board.source import controller_parts  # noqa: PLC0415  heavy
    with own_errors():
        controller_parts(CONTROLLER_NAME, control_of(scenario), "double")


def carry_out_compiled(jobs: Sequence[Job]) -> list[Row]:
    """Carry out some runs in C; one row each, in their order, as ``carry_out`` gives them.

    Raises:
        TwinError: If the loop does not know what a run needs, or cannot be compiled.
    """
    rows: dict[str, Row] = {}
    refused: dict[str, TwinError | None] = {}
    alike: dict[CompiledRuns, list[tuple[Job, CompiledRig]]] = {}
    for job in jobs:
        scenario = Scenario.model_validate_json(job.scenario)
        controller = controller_key(scenario)
        if controller not in refused:
            refused[controller] = refusal(scenario)
        if error := refused[controller]:
            rows[job.key] = refused_row(job.key, error)
            continue
        check_known(scenario)
        rig = CompiledRig(scenario, surface_of(scenario))
        alike.setdefault(compiled_runs(rig, controller), []).append((job, rig))
    others = list[Job]()
    for runs, rigs in alike.items():
        for first in range(0, len(rigs), LANES):
            some = rigs[first : first + LANES]
            motions = runs.run([rig for _, rig in some])
            for (job, rig), motion in zip(some, motions, strict=True):
                if motion is None:
                    others.append(job)
                else:
                    rows[job.key] = row_of(job, rig.scenario, motion)
    rows |= {row["key"]: row for row in carry_out(others)}
    return [rows[job.key] for job in jobs]


def row_of(job: Job, scenario: Scenario, motion: Motion) -> Row:
    """The row of a run that finished."""
    end = Outcome(Ending.FINISHED, scenario.duration)
    axes = scenario.plant.axes
    return metrics_row(job.key, measure(motion, end, axes=axes, **dict(scenario.metrics)))
