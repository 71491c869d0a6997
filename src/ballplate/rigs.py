"""The rig of a scenario for other programs: to step with a controller of one's own, or an FMU."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from numbers import Integral
from pathlib import Path
from typing import Self, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ballplate.changes import Changes, KeyChange, Settings, changes_of, scenario_of
from ballplate.reporter import Reporter, default
from ballplate.results import Result
from controllers.arrays import Array
from controllers.interfaces import Measurement, Reference
from twin.base.errors import RecordError, ScenarioError, TwinError
from twin.base.parts import extra
from twin.base.shipped import find
from twin.run.assemble import assemble
from twin.run.loop import RunMonitor, record_and_wait
from twin.run.metrics import Ending, Outcome
from twin.run.plants import PLANTS
from twin.run.record import Recorder
from twin.scenario.schema import Scenario

DIVERGENCE_CHECK_PERIODS = 100
"""Control periods after which is looked whether numbers have run away, as in a run."""


class Rig:
    """N simulated rigs, stepped a control period at a time; a context manager.

    Entering switches the drives on and takes the first measurement, leaving levels the plates.
    Within, ``step`` commands plate rates and returns the next measurement. Limits, cams and noise
    are those of ``run``: a controller that asks for the same gives the same record.

    Args:
        scenarios: One per rig.

    Attributes:
        scenarios: One per rig.
        controller: The scenarios' own controller of all rigs, to compare with or to build on:
            ``controller.command(measurement).rate``, then ``controller.applied(applied)``.
        measurement: The newest: ``y`` = (x, phi, y, theta), shape (N, 4), m and rad.
        applied: Plate rates that were applied in the last step, rad/s, shape (N, 2).

    Examples:
        >>> import ballplate as bp
        >>> with bp.rig("circle", ["plant.kind=lagrange"], duration=0.5) as rig:
        ...     while not rig.done:  # the scenario's own controller, as in run
        ...         rate = rig.controller.command(rig.measurement).rate
        ...         _ = rig.step(rate)
        ...         _ = rig.controller.applied(rig.applied)
        >>> done = bp.run("circle", ["plant.kind=lagrange"], duration=0.5)
        >>> bool((rig.result()["true_x"] == done["true_x"]).all())
        True
    """

    measurement: Measurement
    applied: Array

    def __init__(self, scenarios: Sequence[Scenario]) -> None:

        self.scenarios = list(scenarios)
        self._rig, self.controller = assemble(self.scenarios)
        self._monitor = RunMonitor(self._rig)
        self.period: float = self._rig.period
        """Control period in s."""
        self._ticks = round(self.scenarios[0].duration / self.period)
        count = len(self.scenarios)
        knows = self.controller.observer.knows
        self._record = Recorder(self._ticks, count, self.period, self._rig.channels, knows)
        self._ended: list[Outcome] | None = None
        self._over = False
        self._since = -1
        """The period that was measured for the applied command."""
        self._computing: list[tuple[float, float]] = []

    def __enter__(self) -> Self:
        self._rig.__enter__()
        self.measurement = self._rig.read()
        self.controller.start(self.measurement)
        self._rig.start()
        self.applied = np.zeros((len(self.scenarios), 2))
        self._begin = time.perf_counter()
        return self

    def __exit__(self, *error: object) -> None:

        self._spent = time.perf_counter() - self._begin
        self._rig.__exit__(*error)
        early = not self.done
        ending, reason = (Ending.ABORTED, "left early") if early else (Ending.FINISHED, "")
        computing = np.array(self._computing).reshape(-1, 1, 2)
        if computing[..., 0].any(where=np.isfinite(computing[..., 0])):
            each = (self._record.length, len(self.scenarios), 2)
            self._record.data["computing"] = np.broadcast_to(computing, each)
        self._ended = self._monitor.final(self._record.end, ending, reason)

    @property
    def time(self) -> float:
        """Simulated seconds since the start."""
        return self.measurement.time

    @property
    def done(self) -> bool:
        """Whether the scenario's duration is over, or every rig has ended."""
        return self._over or self._record.length >= self._ticks

    @property
    def reference(self) -> Reference:
        """The path to follow: ``reference(t)`` is position and four derivatives, (5, N, 2)."""
        return self.controller.reference

    @property
    def state(self) -> Array:
        """The true states, shape (N, 8), as no real rig knows them."""
        return self._rig.devices.state

    def step(
        self,
        rate: ArrayLike,
        estimate: ArrayLike | None = None,
        further: ArrayLike | None = None,
        *,
        computed_s: float = 0.0,
    ) -> Measurement:
        """Command plate rates for one control period, after those that it took to compute them.

        Args:
            rate: Plate rates (phi', theta') in rad/s, shape (2,) or (N, 2).
            estimate: State that the controller believes in, shape (8,) or (N, 8), for the record.
            further: What the scenario's observer estimates beyond it, as ``controller.command``
                gives it, shape (k,) or (N, k), for the record.
            computed_s: How long they were computed, s. Up to a period is in time; for each further
                one, begun ones counted, the rates applied last are held for a period before.

        Returns:
            What the sensors say then.

        Raises:
            TwinError: If the rig is not entered, the run is over, or a shape is wrong.
        """
        if not hasattr(self, "_begin") or self._ended is not None:
            raise TwinError(
                "a rig must be stepped inside its with block: with ballplate.rig(...) as rig:"
            )
        if self.done:
            raise TwinError(f"the run of {self.scenarios[0].duration:g} s is over; see rig.done")
        count = len(self.scenarios)

        def each(what: str, given: ArrayLike, width: int) -> Array:
            return np.broadcast_to(as_shape(what, given, (width,), (count, width)), (count, width))

        wanted = each("rate", rate, 2)
        believed = each("estimate", np.full(8, np.nan) if estimate is None else estimate, 8)
        known = len(self._record.further)
        more = each("further", np.full(known, np.nan) if further is None else further, known)
        took = float(as_shape("computed_s", computed_s, ()))
        if not 0 <= took < np.inf:
            raise TwinError(f"computed_s: must be a time in s of 0 or more, got {computed_s!r}")
        late = max(0, math.ceil(took / self.period - 1e-9) - 1)
        begun = self._record.length
        for tick in range(late + 1):
            if self.done:
                break
            if tick == late:
                self._since = begun
            lateness = (self._record.length - self._since) * self.period
            self._computing.append((took if tick == 0 else np.nan, lateness))
            self._advance(wanted if tick == late else self.applied, believed, more)
        return self.measurement

    def _advance(self, wanted: Array, believed: Array, more: Array) -> None:
        """Command plate rates, shape (N, 2), for one control period."""
        now, requested = self.measurement, (wanted - self.applied) / self.period
        before, self.applied = self.applied, self._rig.write(wanted)
        decided = (believed, requested, (self.applied - before) / self.period, more)
        self.measurement = record_and_wait(self._rig, self._record, now, *decided)
        self._over = self._monitor.watch(self.measurement)
        if not self._over and (self._record.length - 1) % DIVERGENCE_CHECK_PERIODS == 0:
            self._over = self._monitor.examine(self.time)

    def result(self, rig: int = 0) -> Result:
        """What one of the rigs did, after its context was left.

        Args:
            rig: Which, from 0.

        Raises:
            TwinError: If the context is not left yet, or there is no such rig.
        """
        if self._ended is None:
            raise TwinError("the result is available after the with block of the rig")
        if rig not in range(len(self.scenarios)):
            raise TwinError(f"rig: must be 0 to {len(self.scenarios) - 1}, got {rig!r}")

        scenario, record = self.scenarios[rig], self._record.of_rig(rig)
        speed = record.length * self.period / self._spent
        done = Result.of(scenario, record, self._ended[rig], real_time_factor=speed)
        return Result.from_run(done, f"rig-{rig}", PLANTS[scenario.plant.kind].label)


def as_shape(what: str, given: ArrayLike, *shapes: tuple[int, ...]) -> Array:
    """Numbers of one of some shapes.

    Raises:
        TwinError: If they are no numbers, or of a wrong shape, which it names.
    """
    try:
        found = np.asarray(given, float)
    except (TypeError, ValueError):
        found = np.empty(())
    if found.shape not in shapes:
        got = f"shape {found.shape}" if found.shape else f"{given!r:.60}"
        raise TwinError(
            f"{what}: must be numbers of shape {' or '.join(map(str, shapes))}, got {got}"
        )
    return found


def rig(
    scenario: str | Path | Sequence[str | Path],
    settings: Settings = (),
    *,
    count: int | None = None,
    **changes: Unpack[Changes],
) -> Rig:
    """Simulated rigs to step with a controller of one's own.

    Args:
        scenario: A shipped scenario or a TOML file; or several, one per rig, which must agree in
            engine, step, control period and duration.
        settings: What is changed of them, by dotted keys or as texts ``KEY=VALUE``.
        count: So many rigs of the one scenario that differ in their noise: its seed, the next one,
            and so on.
        changes: What is changed of them, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown, out of range or
            cannot be assembled.

    Examples:
        >>> import ballplate as bp
        >>> with bp.rig("hold", ["plant.kind=lagrange"], count=16, duration=0.2) as rig:
        ...     while not rig.done:
        ...         x, phi, y, theta = rig.measurement.y.T
        ...         _ = rig.step(-8 * rig.measurement.y[:, 1::2])  # keeps the plates level
        >>> rig.measurement.y.shape, rig.result(15).outcome
        ((16, 4), 'finished')
    """
    names = [scenario] if isinstance(scenario, str | Path) else list(scenario or ())
    if not names:
        raise TwinError("scenario: name at least one")
    changed = changes_of(settings, changes)
    scenarios = [scenario_of(name, changed) for name in names]
    if count is not None:
        if not isinstance(count, Integral) or len(scenarios) != 1 or count < 1:
            raise TwinError(f"count: must be at least 1, of one scenario, got {count!r}")
        (first,) = scenarios
        scenarios = [
            first.model_copy(update={"seed": first.seed + number}) for number in range(count)
        ]
    return Rig(scenarios)


EXACT_PLANT = {"plant.kind": "lagrange"}
NO_NOISE = {
    f"{key}.variance": [0, 0] for key in ("sensors.touch", "sensors.encoders", "disturbance")
} | {f"sensors.touch.{key}": 0 for key in ("dead_time_spread", "jitter", "lost")}
"""Without any noise; a vibration that is random is left out, too."""


def fmu(
    scenario: str | Path,
    file: str | Path,
    settings: Settings = (),
    *,
    fmi: int = 2,
    with_reference: bool = False,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Path:
    """Write the rig of a scenario as an FMU for co-simulation: C source, and a binary for Linux.

    The rig is the exact equations with rolling friction, drives, touch screen, encoders and limits;
    the mechanism is not in it. ``ballplate export circle rig.fmu`` does the same.

    Args:
        scenario: A shipped scenario, one of ``scenarios()``, or a TOML file.
        file: The file, its ending ``.fmu``.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        fmi: Version of the standard, 2 for FMI 2.0 or 3 for FMI 3.0.
        with_reference: Whether the scenario's reference is an output, too, with two derivatives.
        reporter: Receives the reason why there is no binary in it.
        changes: What is changed of it, by tables: ``plant={"friction": {"rolling_mm": 0}}``.

    Returns:
        The file.

    Raises:
        TwinError: If there is no such scenario, the exact equations cannot follow it, or the file
            cannot be written.

    Examples:
        >>> import zipfile
        >>> import ballplate as bp
        >>> file = bp.fmu("circle", "rig.fmu")
        >>> "modelDescription.xml" in zipfile.ZipFile(file).namelist()
        True
    """
    path = _check_ending(file)
    try:
        find(str(scenario))
    except ScenarioError as error:
        from twin.fmu.bus_node import DRIVE_KINDS

        if str(scenario) not in DRIVE_KINDS:
            raise
        raise ScenarioError(
            f"'{scenario}' is a drive, not a scenario; to export it: "
            f"ballplate export {scenario} {path} --bus"
        ) from error
    given = [*changes_of(settings, changes), *changes_of(EXACT_PLANT, {})]
    chosen = scenario_of(scenario, given)
    still = NO_NOISE | ({"plant.servo.vibration": 0} if chosen.plant.servo.vibration_wander else {})
    quiet = scenario_of(scenario, [*given, *changes_of(still, {})])
    from twin.fmu.export import export

    if lacking := export(path, chosen, quiet, fmi=fmi, with_reference=with_reference):
        (reporter or default()).warn(f"{path}: source only, without a binary: {lacking}")
    return path


def drive_fmu(kind: str, file: str | Path, *, reporter: Reporter | None = None) -> Path:
    """Write an emulated drive as an FMU that is a node of a simulated CAN bus.

    It is FMI 3.0 with FMI-LS-BUS 1.0 (low cut): C source, and a binary for Linux. The drive
    answers over the bus as the emulated one of ``ballplate emulate`` does.
    ``ballplate export akd drive.fmu --bus`` does the same.

    Args:
        kind: The drive: ``akd``.
        file: The file, its ending ``.fmu``.
        reporter: Receives the reason why there is no binary in it.

    Returns:
        The file.

    Raises:
        TwinError: If there is no such drive, or the file cannot be written.

    Examples:
        >>> import zipfile
        >>> import ballplate as bp
        >>> file = bp.drive_fmu("akd", "drive.fmu")
        >>> "terminalsAndIcons/terminalsAndIcons.xml" in zipfile.ZipFile(file).namelist()
        True
    """
    path = _check_ending(file)
    from twin.fmu.bus_node import export_drive

    if lacking := export_drive(path, kind):
        (reporter or default()).warn(f"{path}: source only, without a binary: {lacking}")
    return path


def controller_fmu(
    scenario: str | Path,
    file: str | Path,
    settings: Settings = (),
    *,
    fmi: int = 2,
    real: str = "double",
    reference_inputs: bool = False,
    reporter: Reporter | None = None,
    **changes: Unpack[Changes],
) -> Path:
    """Write the controller of a scenario as an FMU for co-simulation; needs ``casadi``.

    Within is exactly the C source of ``controller_source``. Inputs are what a rig measures, outputs
    plate rates in rad/s. Step it before the rig: a step from a time t gives the commands from t on.
    ``ballplate export circle controller.fmu --controller`` does the same.

    Args:
        scenario: A shipped scenario, one of ``scenarios()``, or a TOML file.
        file: The file, its ending ``.fmu``.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        fmi: Version of the standard, 2 for FMI 2.0 or 3 for FMI 3.0.
        real: Type of the controller's numbers, ``double`` or ``float``.
        reference_inputs: Whether the desired position and its four derivatives are inputs, in place
            of the scenario's reference.
        reporter: Receives the reason why there is no binary in it.
        changes: What is changed of it, by tables.

    Returns:
        The file.

    Raises:
        TwinError: If there is no such scenario, its controller has no form in C, CasADi is lacking,
            or the file cannot be written.

    Examples:
        >>> import zipfile
        >>> import ballplate as bp
        >>> file = bp.controller_fmu("hold", "controller.fmu", duration=0.2)
        >>> "sources/controller.c" in zipfile.ZipFile(file).namelist()
        True
    """
    path = _check_ending(file)
    chosen = _with_symbols(scenario, changes_of(settings, changes), real, "controller_fmu")
    from twin.fmu.controller import export_fmu

    lacking = export_fmu(path, chosen, fmi=fmi, real=real, reference_inputs=reference_inputs)
    if lacking:
        (reporter or default()).warn(f"{path}: source only, without a binary: {lacking}")
    return path


def _with_symbols(
    scenario: str | Path, changes: Sequence[KeyChange], real: str, wanted_by: str
) -> Scenario:
    """A scenario of which the controller can be exported, CasADi being installed.

    Raises:
        TwinError: If there is no such scenario or type of numbers, or CasADi is lacking.
    """
    if real not in {"double", "float"}:
        raise TwinError(f"real: must be double or float, got {real!r}")
    chosen = scenario_of(scenario, changes)
    with extra("casadi", wanted_by):
        import casadi  # noqa: F401
    return chosen


def controller_source(
    scenario: str | Path,
    file: str | Path,
    settings: Settings = (),
    *,
    real: str = "double",
    **changes: Unpack[Changes],
) -> Path:
    """Write the controller of a scenario as C99 source for a board; needs ``casadi``.

    Law, observer, predictor, limits and reference, with a test program and a reference run. Laws
    that plan ahead or solve an optimisation have no form in C and are refused.
    ``ballplate export circle controller.c`` does the same.

    Args:
        scenario: A shipped scenario, one of ``scenarios()``, or a TOML file.
        file: Name of the C file, ``FOLDER/NAME.c``; the folder ``FOLDER/NAME`` is written, and the
            names of the C functions begin with ``NAME``.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        real: Type of numbers, ``double`` or ``float``.
        changes: What is changed of it, by tables.

    Returns:
        The folder.

    Raises:
        TwinError: If there is no such scenario, its controller has no form in C, the name is no
            name in C, CasADi is lacking, or the folder cannot be written.

    Examples:
        >>> import ballplate as bp
        >>> folder = bp.controller_source("hold", "board.c", duration=0.2)
        >>> sorted(file.name for file in folder.iterdir())
        ['README.md', 'board.c', 'board.h', 'cortex-m4', 'reference_run.csv', 'test_board.c']
    """
    path = Path(file)
    if path.suffix != ".c":
        raise RecordError(f"{path}: a controller's file must end in .c")
    chosen = _with_symbols(scenario, changes_of(settings, changes), real, "controller_source")
    from twin.run.controller_source import export

    return export(path, chosen, real=real)


def _check_ending(file: str | Path) -> Path:
    path = Path(file)
    if path.suffix != ".fmu":
        raise RecordError(f"{path}: an FMU's file must end in .fmu")
    return path
