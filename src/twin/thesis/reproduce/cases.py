"""The thesis's Tables 8.1 to 8.21: what was simulated, with which law and observer, what came out.

The observers of chapter 7 are here as the thesis writes them, in continuous time; those in
``controllers`` are discrete and are checked to tend to these.
"""

from __future__ import annotations

import math
import tomllib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from controllers.controller import PerRigReference
from controllers.design import place_poles
from controllers.interfaces import Law, Observer, Reference
from controllers.observers import ExtendedKalman, Kalman, Luenberger, NonlinearLuenberger
from controllers.observers.linear import axis_poles, bucy_covariance
from controllers.smith import Smith
from twin.errors import ScenarioError
from twin.run.loop import Ending, Outcome
from twin.run.metrics import Motion, measure
from twin.scenario.schema import checked_settings, choices

FILES = {"full_state": 4.0, "observers": 5.0, "tracking": 5.0}
"""Data file to the deviation in % that a value may have from the thesis's."""


@dataclass(frozen=True, kw_only=True)
class SimulatedRow:
    """A row: one simulation of the thesis.

    Attributes:
        name: What distinguishes it from the table's other rows.
        detail: Its settings in words.
        setup: Its settings; see ``twin.thesis.reproduce.cases``.
        cells: Column to the thesis's value.
        notes: Column to a remark on the cell.
        causes: Column to what made the thesis's values of this kind inexact.
        exceptions: Column to the reason why this cell cannot be reproduced.
    """

    name: str
    detail: str
    setup: Mapping[str, Any]
    cells: Mapping[str, float]
    notes: Mapping[str, str]
    causes: Mapping[str, str]
    exceptions: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class SimulatedTable:
    """A table of the thesis.

    Attributes:
        id: Its number.
        title: What it compares.
        group: The data file it stands in.
        bound: Deviation in % that a value may have.
        shared: How all tables of the group were made, as far as that was found out.
        own: How this one was made.
        rows: Its rows.
        fitted: Settings, and their label, that fit better than those of the text; or None.
    """

    id: str
    title: str
    group: str
    bound: float
    shared: tuple[str, ...]
    own: tuple[str, ...]
    rows: tuple[SimulatedRow, ...]
    fitted: Mapping[str, Any] | None

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns, in the thesis's order."""
        return tuple(self.rows[0].cells)


@cache
def tables() -> dict[str, SimulatedTable]:
    """All tables by number, in the thesis's order."""
    found = {}
    for group, bound in FILES.items():
        text = files(__package__).joinpath("data", f"{group}.toml").read_text(encoding="utf-8")
        content = tomllib.loads(text)
        for entry in content["table"]:
            found[entry["id"]] = _table(entry, group, bound, content)
    return dict(sorted(found.items(), key=lambda item: int(item[0].split(".")[1])))


def chosen(ids: Iterable[str]) -> list[SimulatedTable]:
    """The tables of these numbers, or all of them for none, in the thesis's order.

    Raises:
        ScenarioError: If there is no such table.
    """
    wanted = list(ids)
    for name in wanted:
        if name not in tables():
            raise ScenarioError(f"no table '{name}' to reproduce; there are {', '.join(tables())}")
    return [table for name, table in tables().items() if not wanted or name in wanted]


def merged(settings: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with more of them laid over; of another ``kind``, a table is replaced whole."""
    out = dict(settings)
    for key, value in more.items():
        old = out.get(key)
        if isinstance(value, dict) and isinstance(old, dict) and value.get("kind") in _same(old):
            out[key] = merged(old, value)
        else:
            out[key] = value
    return out


def _same(settings: Mapping[str, Any]) -> tuple[Any, ...]:
    return (None, settings.get("kind"))


def _table(
    entry: Mapping[str, Any], group: str, bound: float, content: Mapping[str, Any]
) -> SimulatedTable:
    setup = merged(content["setup"], entry.get("setup", {}))
    rows = tuple(
        SimulatedRow(
            name=row["name"],
            detail=row.get("detail", ""),
            setup=merged(setup, row.get("setup", {})),
            cells=row["cells"],
            notes=row.get("notes", {}),
            causes={**content.get("causes", {}), **entry.get("causes", {})},
            exceptions=row.get("exceptions", {}),
        )
        for row in entry["row"]
    )
    return SimulatedTable(
        id=entry["id"],
        title=entry["title"],
        group=group,
        bound=bound,
        shared=tuple(content["remarks"]),
        own=tuple(entry.get("remarks", ())),
        rows=rows,
        fitted=entry.get("fitted"),
    )


# ruff: noqa: N803, N806 - equations of the thesis in its letters


OUTPUTS = slice(0, 8, 2)
"""The measured states x, phi, y, theta."""


@dataclass(frozen=True)
class Estimator(ABC):
    """x_hat' = model(x_hat, u) + L (y - h(x_hat)), with memory of its own beside x_hat."""

    model: BallPlate

    width = 0
    """Numbers of memory a rig."""

    def start(self, rigs: int) -> Array:
        """Memory at the origin, shape (N, width)."""
        return np.zeros((rigs, self.width))

    @abstractmethod
    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates of estimate (N, 8) and memory for input (N, 2) and innovation (N, 4)."""


@dataclass(frozen=True)
class ConstantGain(Estimator):
    """A gain that stays as it is, on the linear model (7.1) or on the exact one (7.9)."""

    L: Array
    exact: bool = False

    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates by (7.1) or (7.9)."""
        if self.exact:
            return self.model.derivative(x, u) + e @ self.L.T, memory
        A, B, _ = self.model.linear()
        return x @ A.T + u @ B.T + e @ self.L.T, memory


@dataclass(frozen=True)
class ExtendedKalmanBucy(Estimator):
    """(7.9) with the gain S C' R^-1 (7.17), S following the Riccati equation of (7.16) in time."""

    Q: Array
    R: Array
    input_terms: bool

    width = 64

    def start(self, rigs: int) -> Array:
        """The covariance in which the filter about the level plate settles."""
        A, B, C = self.model.linear()
        S = bucy_covariance(A, B, C, np.diag(self.Q), np.diag(self.R))
        return np.tile(S.ravel(), (rigs, 1))

    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates by (7.9) and S' = A S + S A' - S C' R^-1 C S + g Q g'."""
        S = memory.reshape(-1, 8, 8)
        A = self.model.jacobian(x, u if self.input_terms else None)
        g = self.model.g(x)
        L = S[:, :, OUTPUTS] / self.R
        AS = A @ S
        slope = AS + AS.swapaxes(1, 2) - L @ S[:, OUTPUTS] + (g * self.Q) @ g.swapaxes(1, 2)
        gained = self.model.derivative(x, u) + (L @ e[..., None])[..., 0]
        return gained, slope.reshape(memory.shape)


@dataclass(frozen=True)
class FlatLuenberger(Estimator):
    """(7.11) with the gain O(x)^-1 G of (7.13), from the ball's position alone."""

    G: Array

    def rate(self, x: Array, memory: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """Rates by (7.11)."""
        out = self.model.flat(x, u)
        k = self.model.k1 * np.array((1.0, -1.0))
        axes = x.reshape(-1, 2, 4)
        sine, cosine, turn = np.sin(axes[..., 2]), np.cos(axes[..., 2]), axes[..., 3]
        L = self.G * e[:, 0::2, None]
        L[..., 2] /= k * cosine
        L[..., 3] = (L[..., 3] / k + sine * turn * L[..., 2]) / cosine
        return out + L.reshape(x.shape), memory


def continuous(observer: Observer) -> Estimator:
    """The continuous-time form of an observer with its settings.

    Raises:
        TypeError: If there is none.
    """
    model = observer.model
    A = model.linear().A
    match observer:
        case Luenberger():
            return ConstantGain(model, _placed(A, axis_poles(observer.poles)))
        case Kalman():
            return ConstantGain(model, kalman_gain(model, observer.Q, observer.R))
        case ExtendedKalman():
            Q, R = np.array(observer.Q), np.array(observer.R)
            return ExtendedKalmanBucy(model, Q, R, observer.input_terms)
        case NonlinearLuenberger(plate_observer=False):
            poles = axis_poles(observer.poles)
            return FlatLuenberger(model, np.array([np.poly(mine)[1:].real for mine in poles]))
        case _:
            raise TypeError(f"no continuous form of {observer!r}")


def kalman_gain(model: BallPlate, Q: tuple[float, ...], R: tuple[float, ...]) -> Array:
    """Gain S C' R^-1 (7.8) about the level plate, shape (8, 4)."""
    A, B, C = model.linear()
    S = bucy_covariance(A, B, C, np.diag(Q), np.diag(R))
    L: Array = S @ C.T / np.array(R)
    return L


def _placed(A: Array, poles: tuple[tuple[complex, ...], ...]) -> Array:
    """Gain that gives A - L C the poles, axis by axis, shape (8, 4)."""
    L = np.zeros((8, 4))
    for axis, mine in enumerate(poles):
        own, outputs = slice(4 * axis, 4 * axis + 4), slice(2 * axis, 2 * axis + 2)
        C = np.eye(4)[0::2]
        L[own, outputs] = place_poles(A[own, own].T, C.T, mine).T
    return L


BALL = (7.2538e-7, 1.7721e-7)
"""Variances of x and y in m^2, Table B.1."""
PLATE = (1.5433e-10, 1.1580e-10)
"""Variances of phi and theta in rad^2, Table B.1."""
DISTURBANCE = (1.0816e-4, 2.8090e-5)
"""Variances of the plate accelerations in (rad/s^2)^2, Table B.1."""


@dataclass(frozen=True, kw_only=True)
class SimulationCase:
    """One simulation of the thesis, the ball at rest on the centre at t = 0.

    Attributes:
        duration: Seconds.
        controller: Kind and settings of the law.
        reference: Kind and settings of the path.
        observer: Kind and settings of the observer; None for full state feedback.
        dead_time: Delay of the measured ball position in s.
        predicted: Whether a Smith predictor makes up for it.
        noise_hold: Seconds for which noise and disturbance of Table B.1 are held; 0 for none.
        seeds: Number of runs that differ in their noise.
        steady_from: Time in s from which steady tracking is judged.
        bands: Settling band in %, then the narrowest and the widest it may have been read with.
        constant_gain: Whether an EKF's gain stays at its value at the origin.
    """

    duration: float
    controller: Mapping[str, Any]
    reference: Mapping[str, Any]
    observer: Mapping[str, Any] | None = None
    dead_time: float = 0.0
    predicted: bool = False
    noise_hold: float = 0.0
    seeds: int = 1
    steady_from: float = 0.0
    bands: tuple[float, float, float] = (5.0, 5.0, 5.0)
    constant_gain: bool = False
    model: BallPlate = field(default_factory=BallPlate, repr=False)

    def law(self) -> Law:
        """The state feedback."""
        law: Law = _build("controller", self.controller, model=self.model)
        return law

    def path(self) -> Reference:
        """The reference."""
        path: Reference = _build("reference", self.reference)
        return path

    def sampled_observer(self, period: float) -> Observer:
        """The observer at a control period, in the predictor if there is one."""
        settings = self.observer or {"kind": "ideal"}
        observer: Observer = _build("observer", settings, model=self.model, period=period)
        if self.predicted:
            return Smith(observer=observer, delay=self.dead_time, model=self.model, period=period)
        return observer

    def estimator(self) -> Estimator | None:
        """The observer in continuous time; None for full state feedback."""
        if self.observer is None:
            return None
        observer: Observer = _build("observer", self.observer, model=self.model)
        if self.constant_gain:
            gain = kalman_gain(self.model, self.observer["Q"], self.observer["R"])
            return ConstantGain(self.model, gain, exact=True)
        return continuous(observer)


def laws(cases: Sequence[SimulationCase]) -> list[Law]:
    """The law of every run, case by case: the same object where the settings are the same."""
    made: list[tuple[Mapping[str, Any], Law]] = []
    found: list[Law] = []
    for case in cases:
        same = [law for settings, law in made if settings == case.controller]
        law = same[0] if same else case.law()
        made.append((case.controller, law))
        found += [law] * case.seeds
    return found


def paths(cases: Sequence[SimulationCase], period: float) -> PerRigReference:
    """The reference of every run, case by case."""
    members = [case.path() for case in cases]
    each = [path for case, path in zip(cases, members, strict=True) for _ in range(case.seeds)]
    return PerRigReference(each, period)


def _build(table: str, choice: Mapping[str, Any], **given: object) -> Any:
    settings = dict(choice)
    cls = choices(table)[settings.pop("kind")]
    return cls(**checked_settings(cls, settings), **given)


class HeldNoise(NamedTuple):
    """Draws of K intervals for N rigs."""

    hold: float
    """Length of an interval in s."""
    measured: Array
    """Added to x, phi, y, theta; shape (K, N, 4)."""
    disturbance: Array
    """Added to the plate accelerations in rad/s^2; shape (K, N, 2)."""


def streams(runs: int, cases: int = 1) -> list[np.random.SeedSequence]:
    """Seeds of the rigs: ``runs`` neighbouring ones per case, the same for every case."""
    return [
        np.random.SeedSequence(0, spawn_key=(run,)) for _ in range(cases) for run in range(runs)
    ]


def draw(duration: float, runs: int, hold: float) -> HeldNoise:
    """What simulated devices with these seeds draw, to the last bit.

    Each rig's seed has children: of the screen's noise (0) and of the phase of its frames (1), of
    the encoders (2) and of the disturbance (3).

    Args:
        duration: Seconds to be covered, both ends included.
        runs: Number of runs.
        hold: Seconds for which a draw is held.
    """
    intervals = math.floor(duration / hold + 1e-9) + 1

    def source(child: int, variance: tuple[float, float]) -> Array:
        seeds = [seed.spawn(child + 1)[child] for seed in streams(runs)]
        draws = [np.random.default_rng(s).standard_normal((intervals, 2)) for s in seeds]
        return np.stack(draws, axis=1) * np.sqrt(variance)

    measured = np.empty((intervals, runs, 4))
    measured[..., 0::2] = source(0, BALL)
    measured[..., 1::2] = source(2, PLATE)
    return HeldNoise(hold, measured, source(3, DISTURBANCE))


def repeated(noise: HeldNoise, cases: int) -> HeldNoise:
    """The same draws for several cases side by side."""
    times = (1, cases, 1)
    return HeldNoise(noise.hold, np.tile(noise.measured, times), np.tile(noise.disturbance, times))


@dataclass(frozen=True, kw_only=True)
class SimulationTrace:
    """K instants of the N runs of one case, or how they ended early.

    Attributes:
        time: Seconds, shape (K,), the end of the run included.
        state: True state, shape (K, N, 8).
        u: Commanded plate accelerations in rad/s^2, shape (K, N, 2).
        reference: Desired ball position in m, shape (K, 2).
        estimate: The observer's state, shape (K, N, 8).
        ended: Why a run ended early, in words; empty if all lasted.
        until: When the first run ended, s.
    """

    time: Array
    state: Array
    u: Array
    reference: Array
    estimate: Array
    ended: str = ""
    until: float = math.inf

    def motion(self, run: int) -> Motion:
        """One run as ``twin.run.metrics`` wants it."""
        state = self.state[:, run]
        return Motion(
            time=self.time,
            ball=state[:, 0::4],
            plate=state[:, 2::4],
            u=self.u[:, run],
            reference=self.reference,
        )

    def excerpt(self, step: float) -> SimulationTrace:
        """The first run until it ended, one instant per step in s, for a figure."""
        every = max(1, round(step / (self.time[1] - self.time[0])))
        rows = slice(0, np.searchsorted(self.time, self.until, "right"), every)
        return SimulationTrace(
            time=self.time[rows],
            state=self.state[rows, :1].copy(),
            u=self.u[rows, :1].copy(),
            reference=self.reference[rows].copy(),
            estimate=self.estimate[rows, :1].copy(),
            ended=self.ended,
            until=self.until,
        )


@dataclass(frozen=True, kw_only=True)
class ThesisColumn:
    """A column of the thesis's tables.

    Attributes:
        label: What it shows, as the thesis calls it.
        unit: Its unit.
        judged: "value" against the bound, "reading" against what was read by eye from a figure,
            "noise" against the range of the seeds.
        zero: Absolute bound where the thesis prints 0.
    """

    label: str
    unit: str
    judged: str = "value"
    zero: float = 0.0

    @property
    def name(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]"


COLUMNS = {
    "e_ss": ThesisColumn(label="e_ss", unit="m"),
    "overshoot": ThesisColumn(label="overshoot", unit="%", zero=0.5),
    "t_ss": ThesisColumn(label="t_ss", unit="s", judged="reading"),
    "rms_error": ThesisColumn(label="average tracking error", unit="m"),
    "max_steady_error": ThesisColumn(label="max. steady tracking error", unit="m"),
    "e_tt": ThesisColumn(label="tracking error e_tt", unit="%", judged="noise"),
    "phi_max": ThesisColumn(label="phi_max", unit="deg"),
    "u1_max": ThesisColumn(label="u1_max", unit="rad/s^2"),
    "theta_max": ThesisColumn(label="theta_max", unit="deg"),
    "u2_max": ThesisColumn(label="u2_max", unit="rad/s^2"),
    "x1_error": ThesisColumn(label="x1 estimation error", unit="m", judged="noise"),
    "x2_error": ThesisColumn(label="x2 estimation error", unit="m/s", judged="noise"),
    "x3_error": ThesisColumn(label="x3 estimation error", unit="rad", judged="noise"),
    "x4_error": ThesisColumn(label="x4 estimation error", unit="rad/s", judged="noise"),
}
"""The columns by the names the data files use."""

METRICS = {
    "e_ss": "steady_error",
    "t_ss": "settling_time",
    "rms_error": "rms_error",
    "max_steady_error": "max_steady_error",
    "e_tt": "tracking_error_percent",
    "phi_max": "phi_max_deg",
    "u1_max": "u1_max",
    "theta_max": "theta_max_deg",
    "u2_max": "u2_max",
}
"""Columns that are indicators of ``twin.run.metrics``, too.

The "average tracking error" is not (C.4), but a root mean square over the run. e_tt (C.7) and the
"max. steady tracking error" are taken from ``steady_from`` on.
"""


def overshoot_beyond_end(trace: SimulationTrace, run: int) -> float:
    """How far x passes its value at the end, in % of that value."""
    x = trace.state[:, run, 0]
    return max(0.0, float(100 * (x.max() / x[-1] - 1)))


def estimation_error(state: int) -> Callable[[SimulationTrace, int], float]:
    """Root mean square over the run of a state's estimation error (C.1)."""

    def error(trace: SimulationTrace, run: int) -> float:
        difference = trace.state[:, run, state] - trace.estimate[:, run, state]
        return float(np.sqrt((difference**2).mean()))

    return error


OWN: dict[str, Callable[[SimulationTrace, int], float]] = {
    "overshoot": overshoot_beyond_end,
    **{f"x{i + 1}_error": estimation_error(i) for i in range(4)},
}
"""Columns that only the thesis's tables have."""


def judge(
    trace: SimulationTrace, case: SimulationCase, columns: tuple[str, ...]
) -> dict[str, list[float]]:
    """The columns' values for every run of a case; for t_ss also those of the bands' ends.

    A run that ended early has no values.
    """
    found: dict[str, list[float]] = {column: [] for column in columns}
    if trace.ended:
        return found
    end = Outcome(Ending.FINISHED, float(trace.time[-1]))
    for run in range(trace.state.shape[1]):
        motion = trace.motion(run)
        for band in case.bands if "t_ss" in columns else case.bands[:1]:
            metrics = measure(motion, end, start=case.steady_from, band_percent=band)
            if "t_ss" in columns:
                settled = metrics.settling_time
                found["t_ss"].append(end.time if settled is None else settled)
            if band is case.bands[0]:
                values = metrics.as_dict()
                for column in columns:
                    if column in OWN:
                        found[column].append(OWN[column](trace, run))
                    elif column != "t_ss":
                        found[column].append(values[METRICS[column]])
    return found
