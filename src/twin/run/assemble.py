"""Builds the objects that run scenarios: N simulated rigs and the controller of each.

There is one way: N scenarios make N rigs, one is N = 1. Whatever the scenarios say differently of
plant, surface, drives, sensors, cams, limits, start, law, observer and reference becomes an array
with one entry per rig; what the rigs of a batch have only once is refused by name. What the rigs
are made of may change while they run.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import FrozenInstanceError, replace
from functools import lru_cache, partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.arrays import Array, Number
from controllers.ballplate import BallPlate
from controllers.catalog import AnswerError, locate_error, wrong_answer
from controllers.controller import MEASURED_TIME, Controller, HeldLaw, needed_columns
from controllers.interfaces import ControlLaw, DelayedObserver, Law, Observer, Reference
from controllers.per_rig import PerRigLaw, PerRigObserver, PerRigReference
from controllers.references import ALONG_X, AlongX
from controllers.smith import Smith
from twin.base.errors import LawError, ModelError, ScenarioError, TwinError
from twin.base.settings import from_changes, from_scenarios, per_rig, settings_of, value_of
from twin.hal.cams import CamTable, FixedRatio
from twin.hal.interface import SCREEN_SIZE_M, Limits, Transmission
from twin.hal.linkage import Linkage, TiltTable, Transmitting
from twin.hal.rig import Rig
from twin.scenario import schema
from twin.scenario.changing import at_time, times
from twin.scenario.rig_tables import PLANT_KINDS
from twin.scenario.schema import TIME_TOLERANCE_S, Scenario, choices
from twin.sim.drives import DriveModel
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction, SurfaceMap, SurfaceModel
from twin.sim.plant.interface import BallStart, Parts, Plant
from twin.sim.plant.rim import Rim
from twin.sim.rig import SimulatedDevices, SimulatedRig
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import PerRigTransmission, TransmissionError, WrongTransmission

if TYPE_CHECKING:
    from mujoco import MjModel

    from twin.board.control import Control
    from twin.board.controller import Board


def build_plant(
    scenarios: Sequence[Scenario], *, threads: int = 0, as_alone: bool | None = None
) -> tuple[Plant, Transmission]:
    """The plant of N scenarios and the transmissions that its rigs believe in.

    Args:
        scenarios: One per rig.
        threads: Threads of the engine; 0 for one per processor.
        as_alone: Whether each rig gives the bits that it gives alone, or those that it gives in a
            batch of any size, where its kind has such ways (``PlantKind``); None for what is
            faster.

    Raises:
        ModelError: If the mechanism or its cam table cannot be used.
    """
    kind = PLANTS[scenarios[0].plant.kind]
    make = {None: None, True: kind.as_alone, False: kind.batched}[as_alone] or kind.make
    plant, known = make(scenarios, threads)
    return plant, with_calibration_error(known, scenarios)


def assumed_transmission(scenario: Scenario) -> Transmission:
    """Cam transmission that a scenario's rig assumes; the mechanism is built only for its ratio.

    Raises:
        ModelError: If the mechanism or its cam table cannot be used.
    """
    if scenario.plant.kind == "mujoco" and scenario.rig.cams != "ratio":
        return with_calibration_error(_build_transmission([scenario], 1.0), [scenario])
    return build_plant([scenario])[1]


def with_calibration_error(known: Transmission, scenarios: Sequence[Scenario]) -> Transmission:
    """A transmission with the errors that the scenarios have of it."""
    error = from_scenarios(TransmissionError, scenarios)
    return WrongTransmission(known, error) if error.any else known


OF_PLANTS = (Friction, SurfaceModel, Parts)
"""Dataclasses of what plants are made of."""
OF_DEVICES: tuple[type[Any], ...] = (TouchModel, EncoderModel, DriveModel)
"""Dataclasses of what is wrong with screen, encoders and drives."""


def differ(old: Sequence[Scenario], new: Sequence[Scenario], *classes: type) -> bool:
    """Whether scenarios say something else of the settings of some dataclasses."""
    pairs = [pair for pair in zip(old, new, strict=True) if pair[0] is not pair[1]]
    return any(
        about.of(before) != about.of(after)
        for cls in classes
        for about in settings_of(cls).values()
        for before, after in pairs
    )


def parts_of(scenario: Scenario) -> Parts:
    """Parts of a rig's mechanism that differ from the model file."""
    lengths, plant = from_scenarios(Linkage, [scenario]), scenario.plant
    other: dict[str, Any] = {"linkage": lengths} if lengths.given else {}
    if other or (plant.kind == "mujoco" and plant.size != SCREEN_SIZE_M):
        other |= {"size": plant.size, "rounded": plant.shape == "round"}
    return replace(from_changes(Parts, scenario), **other)


def drawn_mechanism(scenario: Scenario) -> MjModel:
    """The mechanism of a scenario for a picture; a plate of a different size is drawn alone."""
    from twin.sim.plant.model import drawn_model  # noqa: PLC0415  heavy: loaded when needed

    drawn = scenario.dimensions
    return drawn_model(parts_of(scenario), drawn.screen, drawn.area, rounded=drawn.round)


def linkage_of(scenario: Scenario) -> Transmitting | None:
    """Transmission between servos and plate of a scenario: its linkage or table, if it has one."""
    found = from_scenarios(Linkage, [scenario]), from_scenarios(TiltTable, [scenario])
    return next((each for each in found if each.given), None)


def _exact(scenarios: Sequence[Scenario], threads: int) -> tuple[Plant, Transmission]:
    linkage = linkage_of(scenarios[0])
    plant = ExactPlant(
        rigs=len(scenarios),
        step=scenarios[0].plant.step,
        linkage=linkage,
        **_equations(scenarios),
    )
    return plant, FixedRatio() if linkage is None else _build_transmission(scenarios, plant.ratio)


def _equations(scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """What scenarios say of the exact equations: ball and its spin, friction, level, screen."""
    level: Any = per_rig(settings_of(Parts)["level"], scenarios)
    if scenarios[0].plant.axes == 1:  # nothing rolls along y
        level = level * ALONG_X
    return {
        "model": scenarios[0].plant.model,
        "friction": build_friction(scenarios),
        "level": level,
        "size": per_rig(settings_of(TouchModel)["size"], scenarios),
        "rounded": [scenario.plant.shape == "round" for scenario in scenarios],
        "ball_spin": scenarios[0].plant.ball_spin,
        "rim": from_scenarios(Rim, scenarios),
    }


def _mechanism(
    scenarios: Sequence[Scenario], threads: int, *, sensing: bool | None = None
) -> tuple[Plant, Transmission]:
    from twin.sim.plant.mechanism import Mechanism  # noqa: PLC0415  heavy: loaded when needed

    plant = Mechanism(
        rigs=len(scenarios),
        step=scenarios[0].plant.step,
        threads=threads,
        friction=_friction(scenarios),
        parts=list(map(parts_of, scenarios)),
        rim=from_scenarios(Rim, scenarios),
        sensing=sensing,
    )
    return plant, _build_transmission(scenarios, plant.ratio)


def _build_transmission(scenarios: Sequence[Scenario], ratio: Number) -> Transmission:
    """Transmissions that the rigs assume: linkages, or cams, of a ratio at level."""
    linkage = linkage_of(scenarios[0])
    kinds = [scenario.rig.cams for scenario in scenarios]
    known: dict[str, Transmission] = {
        kind: FixedRatio(ratio) if kind == "ratio" else linkage or _table(kind)
        for kind in set(kinds)
    }
    if len(known) == 1:
        return known[kinds[0]]
    return PerRigTransmission([known[kind] for kind in kinds])


def _cannot_change(plant: Any, *_: Any) -> None:
    kind = type(plant).__name__
    raise ModelError(f"plant.kind: {kind} cannot be changed while it runs; see PlantKind")


class PlantKind(NamedTuple):
    """A plant that ``plant.kind`` can name.

    Attributes:
        make: From N scenarios and a number of threads; the plant, and what its rigs know of cams.
        label: Label of a run on it among runs on other plants.
        least: Smallest batch that gives the same bits as any larger one.
        change: Lets it go on as scenarios say; by default it cannot.
        rebuild: Lets rigs of some numbers be what the scenarios of all say.
        foresee: Does ahead of time what takes long of ``change``.
        as_alone: As ``make``, but each rig gives the bits that it gives alone; None if no such way
            is known.
        batched: As ``make``, but each rig gives the same bits in a batch of any size from
            ``least`` on; None for ``make`` itself.
    """

    make: Callable[[Sequence[Scenario], int], tuple[Plant, Transmission]]
    label: str
    least: int = 16
    change: Callable[[Any, Sequence[Scenario]], None] = _cannot_change
    rebuild: Callable[[Any, NDArray[np.integer], Sequence[Scenario]], None] = _cannot_change
    foresee: Callable[[Any, Sequence[Scenario]], None] = _cannot_change
    as_alone: Callable[[Sequence[Scenario], int], tuple[Plant, Transmission]] | None = None
    batched: Callable[[Sequence[Scenario], int], tuple[Plant, Transmission]] | None = None


PLANTS = {
    "lagrange": PlantKind(
        _exact,
        "exact equations",
        least=1,
        change=lambda plant, scenarios: plant.change(**_equations(scenarios)),
        rebuild=lambda plant, _, scenarios: plant.change(**_equations(scenarios)),
        foresee=lambda *_: None,
        as_alone=_exact,
    ),
    "mujoco": PlantKind(
        _mechanism,
        "honest twin",
        least=1,
        change=lambda plant, each: plant.change(_friction(each), list(map(parts_of, each))),
        rebuild=lambda plant, rigs, scenarios: plant.rebuild(
            rigs,
            [parts_of(scenarios[rig]) for rig in rigs],
            _friction(scenarios),
            from_scenarios(Rim, scenarios),
        ),
        foresee=lambda plant, scenarios: plant.foresee(list(map(parts_of, scenarios))),
        as_alone=partial(_mechanism, sensing=True),
        batched=partial(_mechanism, sensing=False),
    ),
}
"""The plants by what ``plant.kind`` calls them."""


def register(name: str, kind: PlantKind) -> None:
    """Let scenarios of this process name a further plant."""
    PLANTS[name] = kind
    if name not in PLANT_KINDS:
        PLANT_KINDS.append(name)


@lru_cache(maxsize=8)
def _table(kind: str) -> Transmission:
    """Cam transmission that a rig assumes."""
    table = CamTable.packaged()
    return table.per_axis() if kind == "per_axis" else table


def build_friction(scenarios: Sequence[Scenario]) -> Friction | None:
    """The resistance of N balls on their screens; None if all are level and without friction."""
    surfaces = SurfaceMap.stacked(
        [_draw_surface(_surface(each), each.plant.size, each.plant.model) for each in scenarios]
    )
    friction = from_scenarios(Friction, scenarios, map=surfaces)
    return None if friction.absent.all() and friction.map is None else friction


def _friction(scenarios: Sequence[Scenario]) -> Friction:
    return build_friction(scenarios) or Friction()


_surface = attrgetter(*(about.key for about in settings_of(SurfaceModel).values()))
"""The surface settings of a scenario."""


@lru_cache(maxsize=4096)
def _draw_surface(
    given: tuple[Any, ...], size: tuple[float, float], ball: BallPlate
) -> SurfaceMap | None:
    """The map of a surface, drawn once: rigs that go on are asked for theirs again and again."""
    settings = zip(settings_of(SurfaceModel).items(), given, strict=True)
    values = {name: about.unit.to_si(value) for (name, about), value in settings}
    return SurfaceModel(**values).map(size, ball)


Act = Callable[[Sequence[Scenario], Sequence[Scenario]], None]
"""Called with the former and the new scenarios of N rigs."""


class RigChanges:
    """Changes of N rigs while they run; call it with the time before each period passes.

    Args:
        scenarios: One per rig.
        act: Makes the rigs what the scenarios say from now on.
    """

    def __init__(self, scenarios: Sequence[Scenario], act: Act) -> None:
        self.scenarios = tuple(scenarios)
        self._act = act
        self._times = times(scenarios)
        self.done = 0
        """How many of the times at which something changes have passed."""

    def stages(self) -> list[list[Scenario]]:
        """Scenarios from each of those times on."""
        return [[at_time(each, time) for each in self.scenarios] for time in self._times]

    def now(self) -> list[Scenario]:
        """Present scenarios."""
        if not self.done:
            return list(self.scenarios)
        return [at_time(each, self._times[self.done - 1]) for each in self.scenarios]

    def catch_up(self, time: float) -> None:
        """Let everything have happened that was due by a time in s, and nothing else."""
        self.done = 0
        if any(each < time + TIME_TOLERANCE_S for each in self._times):
            self(time)

    def follow(self, scenarios: Sequence[Scenario], time: float) -> None:
        """Go on with scenarios that say the same until a time in s, and perhaps more from then."""
        self.scenarios = tuple(scenarios)
        self._times = times(scenarios)
        self.done = sum(each < time - TIME_TOLERANCE_S for each in self._times)

    def __call__(self, time: float) -> None:
        """Change what has to be changed by a time in s."""
        before = self.done
        while self.done < len(self._times) and time > self._times[self.done] - TIME_TOLERANCE_S:
            self.done += 1
        if self.done > before:
            old = self._times[before - 1] if before else -1.0
            self._act([at_time(each, old) for each in self.scenarios], self.now())


def change_devices(
    devices: SimulatedDevices,
    old: Sequence[Scenario],
    new: Sequence[Scenario],
    *,
    plant: bool = True,
) -> None:
    """Make simulated devices and their plant what scenarios say now.

    Args:
        devices: Of N rigs.
        old: The former scenarios, one per rig.
        new: The new scenarios.
        plant: Whether the plant is to go on as they say, too.

    Raises:
        ModelError: If a number is out of range.
    """
    if plant and differ(old, new, *OF_PLANTS):
        PLANTS[new[0].plant.kind].change(devices.plant, new)
    for model in OF_DEVICES:
        if differ(old, new, model):
            devices.change(from_scenarios(model, new))


def change_transmission(
    rig: Rig, known: Transmission, old: Sequence[Scenario], new: Sequence[Scenario]
) -> None:
    """Give rigs the errors of what they know of their cams that scenarios have now.

    Args:
        rig: The rigs.
        known: The transmission without errors.
        old: The former scenarios, one per rig.
        new: The new scenarios.
    """
    if differ(old, new, TransmissionError):
        rig.replace_transmission(with_calibration_error(known, new))


def without_error(transmission: Transmission) -> Transmission:
    """Cam transmission that a rig would assume without a calibration error."""
    if isinstance(transmission, WrongTransmission):
        return transmission.known
    return transmission


def changing(
    rig: Rig,
    devices: SimulatedDevices,
    transmission: Transmission,
    scenarios: Sequence[Scenario],
) -> RigChanges:
    """The changes of simulated rigs, made ready so that none of them takes long.

    Args:
        rig: The rigs.
        devices: What they are made of.
        transmission: Of the rigs.
        scenarios: One per rig.

    Raises:
        ScenarioError: If rigs on the exact equations would have different balls.
        ModelError: If a number is out of range.
    """
    known = without_error(transmission)

    def act(old: Sequence[Scenario], new: Sequence[Scenario]) -> None:
        change_devices(devices, old, new)
        change_transmission(rig, known, old, new)

    changes = RigChanges(scenarios, act)
    for stage in changes.stages():
        balls = {(each.plant.ball.mass, each.plant.ball.inertia) for each in stage}
        if len(balls) > 1 and stage[0].plant.kind == "lagrange":
            raise ScenarioError(
                "change: plant.ball: on the exact equations all rigs of a batch have one ball"
            )
        PLANTS[stage[0].plant.kind].foresee(devices.plant, stage)
    return changes


Made = TypeVar("Made")


@contextmanager
def own_errors() -> Iterator[None]:
    """Errors of laws, observers and references as one line within the context.

    There is no input to be had in it: who asks for some gets the end of it.

    Raises:
        LawError: What came out of one of them: file, line and error; also an exit.
    """
    stdin, sys.stdin = sys.stdin, io.StringIO()
    try:
        yield
    except TwinError:
        raise
    except (Exception, SystemExit) as error:
        if line := line_of(error):
            raise LawError(line) from error
        raise
    finally:
        sys.stdin = stdin


def line_of(error: BaseException) -> str:
    """What came out of a law, observer or reference; empty if it came of something else."""
    line = str(error) if isinstance(error, AnswerError) else locate_error(error)
    if isinstance(error, IndexError) and line:
        line += " (x is a state of shape (1, 8), or (N, 8) of N rigs: x[..., 4] is its fifth)"
    if isinstance(error, FrozenInstanceError) and line:
        line += " (many rigs share one law: what it remembers is its `memory`, see memory_rate)"
    if sys.flags.dev_mode or not line:
        return ""
    return ", ".join((line, *getattr(error, "__notes__", ())))


def build_controllers(scenarios: Sequence[Scenario]) -> Controller:
    """The controllers of N scenarios as one, each designed on the ball its designer knows.

    Equal laws, observers and references are made once and shared.

    Raises:
        ScenarioError: If a law, observer or reference refuses its settings, or several are to be
            measured.
    """
    period = scenarios[0].rig.period
    if len(scenarios) > 1 and any(
        each.controller.computing_time == MEASURED_TIME for each in scenarios
    ):
        raise ScenarioError(
            "controller.computing_time: 'measured' works for a single run only, as the rigs of a "
            "batch share their computer; give seconds"
        )
    laws = _each(scenarios, [law_of(each) for each in scenarios], build_law)
    estimation = [each.model_dump_json(include={"observer", "predictor"}) for each in scenarios]
    needs = [(each.designed_on, law.needs) for each, law in zip(scenarios, laws, strict=True)]
    observers = _each(scenarios, list(zip(estimation, needs, strict=True)), _observer)
    ways = [(each.reference.model_dump_json(), str(each.rig.limits.area)) for each in scenarios]
    references = _each(scenarios, ways, build_reference)
    for law, observer in zip(laws, observers, strict=True):
        try:
            needed_columns(law, observer)
        except ValueError as error:
            raise ScenarioError(f"controller: {error}") from error
    parts: tuple[ControlLaw, Observer, Reference, float]
    if len(scenarios) == 1:
        parts = laws[0], observers[0], references[0], period
    else:
        parts = (
            laws[0] if len(set(map(id, laws))) == 1 else PerRigLaw(laws),
            observers[0] if len(set(map(id, observers))) == 1 else PerRigObserver(observers),
            PerRigReference(references, period),
            period,
        )
    if all(each.board is None for each in scenarios):
        return Controller(*parts)
    from twin.board.controller import BoardController  # noqa: PLC0415  loaded when needed

    return BoardController(*parts, [_board(each) for each in scenarios])


def _board(scenario: Scenario) -> Board:
    """The board of a scenario.

    Raises:
        ScenarioError: If it has none.
    """
    from twin.board.controller import Board  # noqa: PLC0415  loaded when needed

    if scenario.board is None:
        raise ScenarioError("board: either all rigs of a batch have a board, or none")
    return Board(**dict(scenario.board), control=partial(control_of, scenario))


def control_of(scenario: Scenario) -> Control:
    """What the controller of a scenario in C is made of.

    Raises:
        ScenarioError: If its law, observer or reference refuses its settings.
    """
    from twin.board.control import Control  # noqa: PLC0415  loaded when needed

    return Control(
        scenario.title,
        build_law(scenario),
        _observer(scenario),
        build_reference(scenario),
        build_limits(scenario),
        scenario.rig.period,
        scenario.duration,
        (scenario.plant.start.x, scenario.plant.start.y),
    )


def build_controller(scenario: Scenario) -> Controller:
    """The controller of one scenario.

    Raises:
        ScenarioError: If its law, observer or reference refuses its settings.
    """
    return build_controllers([scenario])


def _each(
    scenarios: Sequence[Scenario], names: Sequence[Hashable], make: Callable[..., Made]
) -> list[Made]:
    """What is made of each scenario, once for those of one name."""
    made = {name: make(one) for name, one in dict(zip(names, scenarios, strict=True)).items()}
    return [made[name] for name in names]


def build_law(scenario: Scenario) -> ControlLaw:
    """The law of a scenario.

    Raises:
        ScenarioError: If it refuses its settings, or does not answer as a law does.
    """
    choice = scenario.controller
    cls = choices("controller")[choice.kind]
    return _design_law(cls, choice.model_dump_json(), scenario.law_ticks, scenario.designed_on)


@lru_cache(maxsize=1024)
def _design_law(cls: type, choice: str, ticks: int, model: BallPlate) -> ControlLaw:
    """A law has no state: one object serves all runs of this process."""
    chosen = schema.ControllerChoice.model_validate_json(choice)
    law: Law = _build("controller", chosen, model=model)
    if problem := wrong_answer(law):
        raise ScenarioError(problem)
    time = chosen.computing_time
    return HeldLaw(law, ticks, time) if ticks > 1 or time else law


def law_of(scenario: Scenario) -> tuple[str, BallPlate]:
    """Key that differs between the laws of scenarios."""
    return scenario.controller.model_dump_json(), scenario.designed_on


def _observer(scenario: Scenario) -> Observer:
    """The observer with what makes up for the dead time: itself, or a predictor around it."""
    model, period, predictor = scenario.designed_on, scenario.rig.period, scenario.predictor
    choice, delay = scenario.observer, 0.0 if predictor is None else predictor.delay
    given: dict[str, Any] = {"model": model, "period": period}
    if issubclass(choices("observer")[choice.kind], DelayedObserver):
        if predictor is not None and predictor.kind is not None:
            raise ScenarioError(
                f"predictor.kind: observer '{choice.kind}' compensates the dead time itself; "
                "leave kind out, predictor.delay then goes to the observer"
            )
        given |= {"delay": delay, "needed": build_law(scenario).needs}
        predictor = None
    observer: Observer = _build("observer", choice, **given)
    if predictor is None:
        return observer
    return Smith(observer=observer, delay=delay + predictor.wait, model=model, period=period)


def build_reference(scenario: Scenario, allowed: ArrayLike | None = None) -> Reference:
    """The reference of a scenario, which must stay within the operating area.

    Args:
        scenario: The scenario with the reference.
        allowed: Operating area |x|, |y| of the rig that it runs on, m; the scenario's by default.

    Raises:
        ScenarioError: If it leaves the area or refuses its settings.
    """
    area = np.asarray(scenario.rig.limits.area if allowed is None else allowed)
    times = np.linspace(0, scenario.duration, 2001)
    with np.errstate(over="ignore", invalid="ignore"):
        reference: Reference = _build("reference", scenario.reference)
        motion: Array = reference(times)
    if not np.isfinite(motion).all():
        raise ScenarioError("reference: the path or a derivative of it is not finite at some time")
    if scenario.plant.axes == 1 and motion[..., 1].any():
        reference, motion = AlongX(reference), motion * ALONG_X
    farthest = np.abs(motion[0]).max(axis=0)
    if (farthest > area + 1e-9).any():
        fits = "; a smaller rig (--on) makes it smaller" if allowed is not None else ""
        raise ScenarioError(
            f"reference: reaches |x|, |y| = {farthest[0]:.3f}, {farthest[1]:.3f} m; "
            f"rig.limits.area allows {area[0]:g}, {area[1]:g} m{fits}"
        )
    return reference


def _build(table: str, choice: schema.Choice, **given: object) -> Any:
    cls = choices(table)[choice.kind]
    settings = schema.checked_settings(cls, choice.settings)
    try:
        return cls(**settings, **given)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise ScenarioError(f"{table}: {error}") from error


SHARED_KEYS = (
    *("plant.kind", "plant.step", "plant.axes", "rig.period", "duration", "sensors.ideal"),
    *(about.key for cls in (Linkage, TiltTable) for about in settings_of(cls).values()),
)
"""Keys in which the rigs of a batch must agree: engine, time base, whether the truth is seen, and
what tilts the plate."""
SHARED_EXACT = (
    *("plant.ball_spin", "plant.plate.height"),
    *(f"plant.ball.{of}" for of in ("mass", "radius", "inertia")),
)
"""The same of rigs on the exact equations, besides."""


class Assembled(NamedTuple):
    """Rigs and the controller to drive them."""

    rig: SimulatedRig
    controller: Controller


def assemble(
    scenarios: Scenario | Sequence[Scenario],
    *,
    threads: int = 0,
    seeds: Sequence[np.random.SeedSequence] | None = None,
    anchor: float = Rig.ANCHOR,
    changeable: bool = False,
    unseen: bool = False,
    as_alone: bool | None = None,
) -> Assembled:
    """N rigs and their controllers from N scenarios.

    Args:
        scenarios: One per rig, or one for a single rig.
        threads: Threads of the engine; 0 for one per processor.
        seeds: Root of the noise, one per rig; made from each scenario's seed by default, so that a
            rig has the same noise alone and in a batch.
        anchor: Time in s from one look of the rig at its measured plate angle to the next.
        changeable: Whether it accepts further changes while it runs (``Changes.follow``).
        unseen: Whether nobody sees how the plate is left, so that it need not be levelled.
        as_alone: As for ``build_plant``.

    Raises:
        ScenarioError: If the parts do not fit together, or scenarios differ in what the rigs of a
            batch share.
        ModelError: If the mechanism or its cam table cannot be used.
    """
    each = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    for other in each[1:]:
        agree(batch_keys(each[0]), batch_keys(other), "rigs that run side by side")
    controller = build_controllers(each)
    plant, transmission = build_plant(each, threads=threads, as_alone=as_alone)
    rig = build_rig(each, plant, transmission, seeds, anchor, changeable=changeable)
    if unseen:
        rig.levelling_s = 0.0
    return Assembled(rig, controller)


def build_rig(
    scenarios: Sequence[Scenario],
    plant: Plant,
    transmission: Transmission,
    seeds: Sequence[np.random.SeedSequence] | None = None,
    anchor: float = Rig.ANCHOR,
    *,
    changeable: bool = False,
) -> SimulatedRig:
    """The rigs of scenarios that agree in what a batch shares, around their plant.

    Args:
        scenarios: One per rig.
        plant: All of them.
        transmission: Plate angles to motor angles, as the rigs believe.
        seeds: Root of the noise, one per rig.
        anchor: Time in s from one look of the rig at its measured plate angle to the next.
        changeable: Whether they may be changed while they run, also where no scenario has changes.
    """
    rig = SimulatedRig(
        build_devices(scenarios, plant, seeds=seeds),
        transmission=transmission,
        limits=from_scenarios(Limits, scenarios),
        period=scenarios[0].rig.period,
        ideal=scenarios[0].sensors.ideal,
        anchor=anchor,
    )
    rig.supervisor.axes = scenarios[0].plant.axes
    if changeable or any(scenario.change for scenario in scenarios):
        rig.changes = changing(rig, rig.devices, transmission, scenarios)
    return rig


def batch_keys(scenario: Scenario) -> dict[str, Any]:
    """Values of the keys that must be equal within a batch."""
    keys = SHARED_KEYS + (SHARED_EXACT if scenario.plant.kind == "lagrange" else ())
    return {key: value_of(scenario, key) for key in keys}


def agree(first: Mapping[str, Any], other: Mapping[str, Any], who: str) -> None:
    """Make sure that scenarios say the same of some keys.

    Raises:
        ScenarioError: If they do not, for ``who`` must.
    """
    for key, value in other.items():
        if first.get(key, value) != value:
            raise ScenarioError(f"{key}: {who} must agree, got {first[key]} and {value}")


def build_devices(
    scenarios: Sequence[Scenario],
    plant: Plant,
    *,
    period: float | None = None,
    seeds: Sequence[np.random.SeedSequence] | None = None,
    touch: TouchModel | None = None,
    encoders: EncoderModel | None = None,
) -> SimulatedDevices:
    """The scenarios' devices around their plant, the plant started.

    Args:
        scenarios: One per rig.
        plant: All of them.
        period: Control period in s; by default the period of the scenarios.
        seeds: Root of the noise, one per rig.
        touch: Imperfections of the touch screen in place of the scenarios' own.
        encoders: Imperfections of the plate encoders in place of the scenarios' own.
    """
    start_plant(plant, scenarios)
    period = period or scenarios[0].rig.period
    holds = [round(max(s.sensors.noise_hold, s.rig.period) / period) for s in scenarios]
    if seeds is None:
        seeds = [np.random.SeedSequence(s.seed, spawn_key=(0,)) for s in scenarios]
    return SimulatedDevices(
        plant,
        period=period,
        touch=touch or from_scenarios(TouchModel, scenarios),
        encoders=encoders or from_scenarios(EncoderModel, scenarios),
        drives=from_scenarios(DriveModel, scenarios),
        hold=holds[0] if len(set(holds)) == 1 else np.array(holds),
        axes=scenarios[0].plant.axes,
        seeds=seeds,
    )


def start_plant(plant: Plant, scenarios: Sequence[Scenario]) -> None:
    """Put the balls where the scenarios start, the plates level."""
    start = from_scenarios(BallStart, scenarios)
    ball = np.array(np.broadcast_to(start.ball, (plant.rigs, 4)))
    if scenarios[0].plant.axes == 1:
        ball[:, 2:] = 0.0
    plant.start(ball, start.spin)


def build_limits(scenario: Scenario) -> Limits:
    """Limits of the commands to the rig of a scenario, in SI units."""
    return from_scenarios(Limits, [scenario])
