"""Builds the plants of scenarios, and the transmissions that their rigs assume.

What scenarios state differently of plant, surface, linkage and friction becomes an array with one
entry per rig.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.arrays import Number
from controllers.ballplate import BallPlate
from controllers.references import ALONG_X
from twin.base.errors import ModelError
from twin.base.settings import from_changes, from_scenarios, per_rig, settings_of
from twin.hal.cams import CamTable, FixedRatio
from twin.hal.interface import SCREEN_SIZE_M, Transmission
from twin.hal.linkage import Linkage, TiltTable, Transmitting
from twin.scenario.rig_tables import PLANT_KINDS
from twin.scenario.schema import Scenario
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction, SurfaceMap, SurfaceModel
from twin.sim.plant.interface import BallStart, Parts, Plant
from twin.sim.plant.rim import Rim
from twin.sim.sensors import TouchModel
from twin.sim.transmission import PerRigTransmission, TransmissionError, WrongTransmission

if TYPE_CHECKING:
    from mujoco import MjModel


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


def start_plant(plant: Plant, scenarios: Sequence[Scenario]) -> None:
    """Put the balls where the scenarios start, the plates level."""
    start = from_scenarios(BallStart, scenarios)
    ball = np.array(np.broadcast_to(start.ball, (plant.rigs, 4)))
    if scenarios[0].plant.axes == 1:
        ball[:, 2:] = 0.0
    plant.start(ball, start.spin)
