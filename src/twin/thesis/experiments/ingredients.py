"""What each ingredient of the explanation explains, and what other hypotheses would change.

Every variant is the explanation with something left out, put in, or in place of something else,
all remaining parameters fitted again to all tables from where they were.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from twin.fit.misfit import cells, computed
from twin.fit.runs import Runs
from twin.fit.schema import Experiment, FitTable, FittedParameter
from twin.fit.search import Descent, searched
from twin.study.store import Store
from twin.thesis.experiments.explained import sample, stored
from twin.thesis.experiments.explanation import INDICATORS, PARAMETERS, table
from twin.thesis.experiments.tables import tables
from twin.thesis.reproduce.cases import DISTURBANCE

COLUMNS = {indicator: column for column, indicator in INDICATORS.items()}


@dataclass(frozen=True)
class Variant:
    """The explanation, changed.

    Attributes:
        name: In words.
        without: Parameters that it has not; what they stand for is left out.
        overrides: Further settings of all experiments.
        case_2: Whether the sliding mode has the settings of Table 8.10 or those printed.
        why: Where a size comes from.
    """

    name: str
    without: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    case_2: bool = True
    why: str = ""


EXPLANATION = Variant("the explanation")
LEFT_OUT = (
    Variant(
        "friction alone, as documented",
        ("without_predictor", "start", "play"),
        case_2=False,
        why="one number, fitted to all tables",
    ),
    Variant("start of three quarters of a turn", ("start",)),
    Variant("no play", ("play",)),
    Variant("one friction for all series", ("without_predictor",)),
    Variant("sliding mode as printed", case_2=False),
)
"""With an ingredient left out."""
OTHERS = (
    Variant(
        "hysteresis of 0.44 deg in place of play",
        ("play",),
        ("plant.servo.hysteresis_deg=0.44",),
        why="as wide as the play",
    ),
    Variant(
        "hysteresis of 0.8 deg in place of play",
        ("play",),
        ("plant.servo.hysteresis_deg=0.8",),
        why="twice as wide",
    ),
    Variant(
        "steady vibration in place of play",
        ("play",),
        ("plant.servo.vibration=0.21", "plant.servo.vibration_hz=1.4"),
        why="0.11 deg rms at 1.4 Hz",
    ),
    Variant(
        "random vibration in place of play",
        ("play",),
        (
            "plant.servo.vibration=0.21",
            "plant.servo.vibration_hz=1.4",
            "plant.servo.vibration_wander=2.0",
        ),
        why="0.11 deg rms about 1.4 Hz",
    ),
    Variant("drives of 8 Hz", overrides=("plant.servo.bandwidth_hz=8.0",), why="lag of 20 ms"),
    Variant(
        "axes coupled by 10 %",
        overrides=("rig.cam_coupling_percent=10.0",),
        why="chapter 10 saw coupling",
    ),
    Variant(
        "dead time 50 ms", overrides=("sensors.touch.dead_time=0.05",), why="predictor knows 42"
    ),
    Variant(
        "disturbance of Table B.1 besides",
        overrides=(f"disturbance.variance={list(DISTURBANCE)}",),
        why="the other reading of Table B.1",
    ),
    Variant(
        "plate encoders of 16384 counts",
        overrides=("sensors.encoders.counts=16384",),
        why="4096 x 4",
    ),
)
"""With something else put in or in place of something."""
VARIANTS = (EXPLANATION, *LEFT_OUT, *OTHERS)


@dataclass(frozen=True, kw_only=True)
class VariantResult:
    """What a variant makes of the tables.

    Attributes:
        variant: Which.
        values: Its parameters by name.
        chi2: Sum of squared residuals of all cells.
        rows: Its cells: table, row, column, thesis, explained.
    """

    variant: Variant
    values: dict[str, float]
    chi2: float
    rows: list[dict[str, Any]]


def evaluated(advance: Callable[[float], None] = lambda _: None) -> list[VariantResult]:
    """Every variant fitted again; all of them side by side, as experiments of one table.

    Args:
        advance: Called with the share done, 0 to 1.

    Raises:
        TwinError: If a run cannot be carried out.
    """
    about = _side_by_side()
    numbers = cells(about)
    start = sample(stored()["all"])
    descents = [
        Descent(
            about,
            [cell for cell in numbers if cell.group.startswith(f"{index}:")],
            start,
            [name for name in PARAMETERS if name not in variant.without],
            variant.name,
        )
        for index, variant in enumerate(VARIANTS)
    ]
    with TemporaryDirectory() as folder:
        runs = Runs(about, Store(Path(folder)))
        searched(descents, runs, advance)
        wanted = [(d.best, place) for d in descents for place in d.experiments]
        found = runs.indicators(wanted)
    results = []
    for variant, descent in zip(VARIANTS, descents, strict=True):
        values = computed(descent.cells, descent.best, found).tolist()
        results.append(
            VariantResult(
                variant=variant,
                values={
                    name: value
                    for name, value in zip(PARAMETERS, descent.best, strict=True)
                    if name not in variant.without
                },
                chi2=descent.chi2,
                rows=[
                    {
                        "table": cell.group.partition(":")[2],
                        "row": cell.label.partition(", ")[2],
                        "column": COLUMNS[cell.indicator],
                        "thesis": cell.measured,
                        "explained": value,
                    }
                    for cell, value in zip(descent.cells, values, strict=True)
                ],
            )
        )
    return results


def _side_by_side() -> FitTable:
    """All variants as one table, whose groups are ``index:table``."""
    experiments: list[Experiment] = []
    for index, variant in enumerate(VARIANTS):
        own = table(overrides=variant.overrides, case_2=variant.case_2)
        experiments += [
            each.model_copy(
                update={
                    "name": f"{index}: {each.label}",
                    "group": f"{index}:{each.group}",
                    "set": (*own.set, *each.set),
                }
            )
            for each in own.experiments
        ]
    parameters: dict[str, FittedParameter] = {}
    for name, parameter in PARAMETERS.items():
        groups = tuple(
            f"{index}:{group}"
            for index, variant in enumerate(VARIANTS)
            if name not in variant.without
            for group in parameter.groups or tables()
        )
        parameters[name] = parameter.model_copy(update={"groups": groups})
    return FitTable(title="variants", parameters=parameters, experiments=tuple(experiments))
