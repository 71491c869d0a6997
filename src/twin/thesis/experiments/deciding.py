"""What a measurement on the rig would show if one ingredient were so or otherwise; own starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from controllers.arrays import Array
from twin.fit.misfit import cells
from twin.fit.runs import Runs
from twin.fit.schema import FitTable
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import Scenario
from twin.study.build import Builder
from twin.study.store import Store
from twin.thesis.experiments.explained import sample, stored
from twin.thesis.experiments.explanation import table
from twin.thesis.experiments.tables import LATE, chosen

STARTS = (1.6, 1.9, 2.2, 2.6, 3.0, 3.5, 4.0)
"""Lengths of the start in s that each run may have of its own."""
SLOW = 2.5
"""Parts of the plate's motion below so many times the reference's frequency are its own."""
LONG = 25.0
"""Seconds of a run."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What the rig's records would show of a run.

    Attributes:
        table: Whose experiment.
        row: Which.
        case: What is so.
        time: When |phi| is largest, s.
        frequency: Of the plate's oscillation about what the reference asks for, Hz.
        amplitude: Its root mean square in deg.
    """

    table: str
    row: str
    case: str
    time: float
    frequency: float
    amplitude: float


CASES: dict[str, dict[str, float | None]] = {
    "the explanation": {},
    "start of three quarters of a turn": {"reference.start": None},
    "no play": {"plant.servo.backlash_deg": 0.0},
}
"""What may be so: settings over those of the explanation; None for the default."""


def outcomes(rows: Sequence[tuple[str, float]]) -> list[Outcome]:
    """What records of circles would show, by table and frequency in rad/s, for every case."""
    known = stored()["all"]
    found, scenarios, omegas = [], [], []
    for number, omega in rows:
        (experiment,) = [e for e in chosen([number]) if e.omega == omega]
        about = next(e for e in table().experiments if e.name == f"{number}, {experiment.name}")
        build = Builder(experiment.scenario)
        for case, changes in CASES.items():
            point = {
                "plant.friction.rolling_mm": known["friction"]
                * (known["without_predictor"] if number in LATE else 1.0),
                "reference.start": known["start"],
                "plant.servo.backlash_deg": known["play"],
                **changes,
            }
            given = {key: value for key, value in point.items() if value is not None}
            scenarios.append(build((*table().set, *about.set, f"duration={LONG:g}"), given))
            found.append((number, experiment.name, case))
            omegas.append(omega)
    time, angle = _recorded(scenarios)
    results = []
    for k, (number, name, case) in enumerate(found):
        frequency, amplitude = oscillation(time, angle[:, k], omegas[k])
        at = float(time[np.argmax(np.abs(angle[:, k]))])
        results.append(
            Outcome(
                table=number,
                row=name,
                case=case,
                time=at,
                frequency=frequency,
                amplitude=float(np.degrees(amplitude)),
            )
        )
    return results


def _recorded(scenarios: Sequence[Scenario]) -> tuple[Array, Array]:
    """Time in s and the encoders' phi in rad of each, shapes (K,) and (K, N)."""
    rig, controller = assemble(scenarios, threads=1)
    record = Recorder(
        round(LONG / rig.period), len(scenarios), rig.period, keep=("measured",), every=5
    )
    drive(rig, controller, LONG, record)
    return record.time, record["measured"][:, :, 1]


def oscillation(time: Array, angle: Array, omega: float) -> tuple[float, float]:
    """Frequency in Hz and rms of what is faster than the reference, from 10 s on.

    Args:
        time: Seconds, evenly spaced.
        angle: Of the plate, same shape.
        omega: Of the reference, rad/s.
    """
    late = time >= 10.0
    values, step = angle[late] - angle[late].mean(), float(time[1] - time[0])
    spectrum = np.fft.rfft(values * np.hanning(len(values)))
    frequencies = np.fft.rfftfreq(len(values), step)
    fast = frequencies > SLOW * omega / (2 * np.pi)
    power = np.abs(spectrum) ** 2
    share = power[fast].sum() / power.sum()
    return (
        float(frequencies[fast][np.argmax(power[fast])]),
        float(values.std() * np.sqrt(share)),
    )


def own_starts(
    advance: Callable[[float], None] = lambda _: None,
) -> list[tuple[str, str, float, float, float]]:
    """The start that each circle's two angle maxima alone would ask for.

    Returns:
        Per run table, row, length in s, and the sum of squared logarithms of computed over measured
        maxima with it and with the common length.
    """
    about: FitTable = table()
    numbers = cells(about)
    whole = sample(stored()["all"])
    place = list(about.parameters).index("start")
    lengths = (*STARTS, whole[place])
    samples = [(*whole[:place], length, *whole[place + 1 :]) for length in lengths]
    circles = [k for k, experiment in enumerate(about.experiments) if experiment.own_group != "9.1"]
    with TemporaryDirectory() as folder:
        found = Runs(about, Store(Path(folder))).indicators(
            (each, k) for each in samples for k in circles
        )
    advance(1.0)
    results = []
    for k in circles:
        maxima = [c for c in numbers if c.experiment == k and c.indicator.endswith("_max_deg")]
        misfit = [
            sum((c.scale * c.residual(found[each, k][c.indicator])) ** 2 for c in maxima)
            for each in samples
        ]
        best = int(np.argmin(misfit))
        experiment = about.experiments[k]
        number, _, name = experiment.label.partition(", ")
        results.append((number, name, lengths[best], misfit[best], misfit[-1]))
    return results
