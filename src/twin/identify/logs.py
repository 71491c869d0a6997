"""Reads logs: runs and files with columns of known names, and files of any rig with any columns.

A column of any rig is given as ``role=name:unit``: ``measured_x=X:mm``, ``time=3:ms`` for the
third, ``command_theta=-servo2:0.24deg`` with its sign turned and a factor.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.ballplate import BallPlate
from twin.base.errors import LogError, suggest
from twin.base.foreign import decode_text
from twin.base.shipped import shipped_in
from twin.base.validation import read_tables
from twin.identify.text_forms import plain_lines
from twin.run.files import is_record, log_file
from twin.run.foreign_logs import foreign_table
from twin.run.logs import (
    COLUMN_UNITS,
    NEEDED_COLUMNS,
    SECOND_AXIS_COLUMNS,
    UNIT_SCALES,
    read_columns,
    split_unit,
)
from twin.run.readers import ForeignTable
from twin.scenario.schema import Scenario
from twin.sim.plant.rim import UNLIMITED_REACH, Reach

MORE_COLUMNS = ("age", "touched", "applied_phi_acc", "applied_theta_acc", "lateness")
RATE_COLUMNS = ("applied_phi_rate", "applied_theta_rate")
LOG_COLUMN_UNITS = {
    name: COLUMN_UNITS[name] for name in (*NEEDED_COLUMNS, *MORE_COLUMNS)
} | dict.fromkeys(RATE_COLUMNS, "rad/s")
"""Columns that are read from a run or a log, and their SI units; it may have more."""

MECHANISM_LAG = 0.0025
"""Lag in s of the mechanism's own servos: fitted to runs of it without a bandwidth limit."""
MECHANISM_GRIP = 0.0248
"""Time constant in s of its rolling contact, (d t) / 2 with solreffriction t = 0.05 s, d = 0.99."""
PLANT_GRIPS = {"mujoco": (MECHANISM_GRIP,), "lagrange": (0.0,)}
"""What is known of the twin's own plants; of a rig it is not."""


@dataclass(frozen=True, kw_only=True)
class Log:
    """A recorded run as it was measured, in SI units, one entry per row.

    Attributes:
        source: Its name in messages.
        time: Seconds, shape (K,).
        ball: Measured x and y in m, shape (K, 2).
        plate: Measured phi and theta in rad, shape (K, 2).
        age: Seconds since the ball's position arrived, shape (K,).
        touched: Whether the screen detected the ball, shape (K,).
        command: Commanded plate rates in rad/s from each row on, shape (K, 2); None if unknown.
        model: The ball, which is weighed and measured, not identified.
        own_lag: Lag in s of the twin's own drives without a bandwidth limit.
        grips: Times in s within which friction may stop a ball, see ``replay``; more than one
            where it is not known.
        late: How long after its time each row was taken, s, shape (K,); None if unknown.
        axes: Number of axes of the rig; of 1 the second is 0 everywhere.
        walls: How far walls let the ball go.
        scenario: What a run of this program was started with; empty for any other log.
    """

    source: str
    time: Array
    ball: Array
    plate: Array
    age: Array
    touched: Mask
    command: Array | None
    model: BallPlate
    own_lag: float
    grips: tuple[float, ...]
    late: Array | None = None
    axes: int = 2
    walls: Reach = UNLIMITED_REACH
    scenario: Mapping[str, Any] = field(default_factory=dict)

    def with_ball(self, factor: float) -> Log:
        """This log with a different ball, given by the share of gravity that accelerates it.

        Raises:
            LogError: If it is a run, which knows its ball.
        """
        if self.scenario:
            raise LogError(f"{self.source}: --ball: not allowed; a run states its ball")
        inertia = ball_inertia(self.model.mass, self.model.radius, factor)
        return replace(self, model=replace(self.model, inertia=inertia))

    @property
    def columns(self) -> dict[str, Array]:
        """Its columns by their names in ``LOG_COLUMN_UNITS``, shape (K,) each."""
        pairs = {
            NEEDED_COLUMNS[1::2]: self.ball,
            NEEDED_COLUMNS[2::2]: self.plate,
            RATE_COLUMNS: self.command,
        }
        found = {"time": self.time, "age": self.age, "touched": self.touched.astype(float)}
        for names, values in pairs.items():
            if values is not None:
                found |= dict(zip(names, values.T, strict=True))
        return found

    def rows(self, chosen: Mask | NDArray[np.intp] | slice) -> Log:
        """Some of its rows."""
        names = ("time", "ball", "plate", "age", "touched", "command", "late")
        every = {name: getattr(self, name) for name in names}
        return replace(self, **{k: v[chosen] for k, v in every.items() if v is not None})


def read(path: Path) -> Log:
    """Read a log: a run folder, a Parquet file or a CSV file.

    Raises:
        LogError: If the file cannot be read, lacks a column, or has a wrong unit or no numbers.
    """
    path = log_file(path)
    run = path.resolve().parent.name
    source = f"{run}/{path.name}" if is_record(path) else path.name
    return of_columns(*read_columns(path, LOG_COLUMN_UNITS, NEEDED_COLUMNS), source)


def has_known_columns(source: str, content: ForeignTable | str) -> bool:
    """Whether a log has the columns of one axis by the names that this program knows.

    Args:
        source: What to call the file in messages.
        content: Its table or its text.

    Raises:
        LogError: If a text is empty, or its header does not fit its rows.
    """
    known = {name: ColumnWanted(name, "", 1.0) for name in NEEDED_COLUMNS}
    header, *_ = split_content(source, content, known)
    names = {split_unit(each)[0] for each in header}
    axes = (NEEDED_COLUMNS[1:3], SECOND_AXIS_COLUMNS)
    return "time" in names and any(names >= set(each) for each in axes)


def of_columns(columns: Mapping[str, Array], metadata: dict[str, Any], source: str) -> Log:
    """A log of columns in SI units.

    Args:
        columns: Of ``LOG_COLUMN_UNITS``, shape (K,) each; those that are required are there.
            Without those of the second axis it is of a rig of one axis.
        metadata: Of the run, with its scenario; empty for a log that is no run.
        source: What the log is called.

    Raises:
        LogError: If the metadata are not those of a run.
    """

    def pair(first: str, second: str) -> Array | None:
        if first not in columns or (second not in columns and axes == 2):
            return None
        return np.stack((columns[first], columns.get(second, nothing)), axis=-1)

    time = columns["time"]
    nothing = np.zeros_like(time)
    try:
        rig = _rig(metadata)
    except (AttributeError, TypeError, ValueError):
        raise LogError(f"{source}: its metadata is not of a run") from None
    if SECOND_AXIS_COLUMNS[0] not in columns:
        rig["axes"] = 1
    axes = rig["axes"]
    ball, plate = pair("measured_x", "measured_y"), pair("measured_phi", "measured_theta")
    assert ball is not None
    assert plate is not None
    command = pair(*RATE_COLUMNS)
    acceleration = pair("applied_phi_acc", "applied_theta_acc")
    if command is None and acceleration is not None and len(time) > 1:
        period = float(np.nanmedian(np.diff(time)))
        command = period * np.cumsum(np.nan_to_num(acceleration), axis=0)
    touched = columns.get("touched", np.ones_like(time))
    return Log(
        source=source,
        time=time,
        ball=ball,
        plate=plate,
        age=np.nan_to_num(columns.get("age", np.zeros_like(time))),
        touched=np.nan_to_num(touched) > 0.5,
        command=command,
        late=columns.get("lateness"),
        scenario=metadata.get("scenario") or {},
        **rig,
    )


def _rig(metadata: dict[str, Any]) -> dict[str, Any]:
    """The ball in a run's metadata and, if it was simulated, the plant."""
    scenario = metadata.get("scenario", {})
    plant = scenario.get("plant", {})
    period = float(scenario.get("rig", {}).get("period", 0.0))
    ball = {key: plant.get("ball", {}).get(key) for key in ("mass", "radius", "inertia")}
    ball["height"] = plant.get("plate", {}).get("height")
    model = BallPlate(**{key: float(v) for key, v in ball.items() if v is not None})
    between = plant.get("rim", {}).get("size", (0.0, 0.0))
    return {
        "model": model,
        "axes": int(plant.get("axes", 2)),
        "walls": Reach.of(between, model.radius, plant.get("shape", "")),
        "own_lag": period / 2 if plant.get("kind") == "lagrange" else MECHANISM_LAG,
        "grips": PLANT_GRIPS.get(plant.get("kind"), (MECHANISM_GRIP, 0.0)),
    }


def rig_of(scenario: Mapping[str, Any]) -> str:
    """Name of the shipped rig with the plate and ball of a run; empty if there is none."""
    plant = scenario.get("plant", {})
    for name, path in shipped_in("rigs").items():
        own = read_tables(path, name)["plant"]
        ball = plant.get("ball", {})
        if own["size"] == plant.get("size") and own["ball"].items() <= ball.items():
            return name
    return ""


ROLE_UNITS = {
    "time": "s",
    "measured_x": "m",
    "measured_y": "m",
    "command_phi": "rad",
    "command_theta": "rad",
    "measured_phi": "rad",
    "measured_theta": "rad",
    "age": "s",
    "touched": "1",
}
"""Roles of columns, and their SI units."""
ROLE_ALIASES = {"command_x": "command_phi", "command_y": "command_theta", "t": "time"}
"""Other names of a role: the command of phi moves the ball along x."""
AXIS_COLUMNS = {"x": ("measured_x", "phi"), "y": ("measured_y", "theta")}
"""The ball's column and the plate's angle that moves it, of each axis."""
COUNT_UNITS = dict.fromkeys(("counts", "count", "1", ""), 1.0)
"""Units of a command other than angles."""
GRAVITY_SHARES = {"hollow": 3 / 5, "solid": 5 / 7}
"""Share of gravity that accelerates a ball which rolls."""
BALL_HEIGHT_RANGE_M = -0.3, 0.5
"""Least and largest height in m of a ball's centre above the plate's axis."""
SEPARATOR_NAMES = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";"}


BLANK_CELLS = {"", "nan", "na", "n/a", "none", "null", "-", "--", "inf", "-inf"}


BOOLEAN_WORDS = {"true": 1.0, "false": 0.0, "yes": 1.0, "no": 0.0}


MIN_MOTION_M, MAX_MOTION_M = 1e-3, 3.0
"""Distance in m from the middle of its positions that a ball on a plate comes to."""
MAX_COMMAND_GAP_S = 0.5
"""Time in s without a row over which nothing is known of the command."""
FEW_ODD_ROWS = 0.02
"""Up to this share of rows, a row with a different number of cells counts as damaged."""
MAX_CUT_ROWS = 0.2
"""The same of rows with several different numbers of cells, as of a line that loses letters."""
MIN_SHARED_STAMPS, MIN_WHOLE_SHARE = 0.9, 0.95
"""Share of stamps with more than one row above which a clock is coarse, and the smallest share of
rows of such a log that have a command."""
SPEED_WINDOW_S = 0.2
"""Time in s over which a speed is seen."""
REST_SPEED_M_S = 0.005
"""Speed in m/s below which a ball may as well rest."""
MIN_JUMP_M = 0.004
"""Way in m at once before or after a repeated reading by which it is false or held."""


@dataclass(frozen=True)
class ColumnWanted:
    """The column of a role, and the conversion of its numbers to SI.

    Attributes:
        name: In the header, or its number from 1 on.
        unit: As given; empty for the unit of the header, or SI if that has none.
        sign: 1 or -1.
    """

    name: str
    unit: str
    sign: float


@dataclass(frozen=True)
class EndStops:
    """Walls between which the ball rolls.

    Attributes:
        low: Position of the ball at the lower one, m; minus infinity if there is none.
        high: Position at the upper one, m; infinity if there is none.
        restitution: Speed after a bounce over the speed before.
        touches: When the ball touches one: begin and end in s, by rising time, shape (2, N).
    """

    low: float
    high: float
    restitution: float
    touches: Array


@dataclass(frozen=True)
class AxisLog:
    """One axis of a log.

    Attributes:
        time: When each command begins, s, shape (K,).
        tilt: The command or the measured angle, rad or counts, shape (K,).
        held: Whether it is held from row to row, as commands are.
        sampled: When each sample of the ball was taken, s, shape (M,).
        ball: The samples, m, shape (M,).
        across: Times in s, and how fast the ball goes along the other axis, m/s, shape (2, N);
            nowhere if friction is to act on this axis by itself.
        lever: How far above the plate's axis the ball is known to be as good as, m; None if it is
            not.
        stops: Its end stops; None without any.
        recordings: When each recording after the first begins where several are joined, s, rising,
            shape (R - 1,); their clocks may differ by an offset each.
        added: Tilts that were added to the tilt, each by as much as the log itself shows, (K,).
    """

    time: Array
    tilt: Array
    held: bool
    sampled: Array
    ball: Array
    across: Array = field(default_factory=lambda: np.zeros((2, 1)))
    lever: float | None = field(default=None, kw_only=True)
    stops: EndStops | None = field(default=None, kw_only=True)
    recordings: Array = field(default_factory=lambda: np.zeros(0), kw_only=True)
    added: tuple[Array, ...] = field(default=(), kw_only=True)

    @property
    def touching(self) -> Mask:
        """Samples of a ball that touches an end stop, shape (M,)."""
        if self.stops is None:
            return np.zeros(len(self.sampled), bool)
        begin, end = self.stops.touches
        latest = np.searchsorted(begin, self.sampled, "right") - 1
        return np.asarray((latest >= 0) & (self.sampled <= np.maximum.accumulate(end)[latest]))

    def between(self, begin: float, end: float) -> AxisLog:
        """This log with only the samples between two times in s."""
        return self._where((self.sampled >= begin) & (self.sampled < end))

    def without(self, begin: Array, seconds: float) -> AxisLog:
        """This log without the samples of so many seconds from each of some times in s on."""
        since = self.sampled - begin[:, None]
        return self._where(np.asarray(((since < 0) | (since >= seconds)).all(axis=0)))

    def tilt_at(self, time: Array) -> Array:
        """The tilt at times in s."""
        if not self.held:
            return np.interp(time, self.time, self.tilt)
        return self.tilt[np.maximum(np.searchsorted(self.time, time, "right") - 1, 0)]

    def clock_columns(self, time: Array) -> Array:
        """How a dead time may change over a log, next to its mean: columns of a regression.

        By an offset of the clock of each recording after the first, and by a drift that all
        recordings have in common, which grows with the time in each.

        Args:
            time: At which the dead time acts, s, shape (N,).

        Returns:
            One column for each offset that shows at these times, then the drift's, in s; each with
            zero mean, shape (N, C).
        """
        which = np.searchsorted(self.recordings, time, "right")
        there = which[:, None] == np.unique(which)
        since = time - there @ ((there.T @ time) / there.sum(axis=0))
        columns = np.column_stack((there[:, 1:], since))
        return columns - columns.mean(axis=0)

    def with_clock(self, drift: float) -> AxisLog:
        """This log with the clock of its samples slowed down, which is faster by a share."""
        first = self.time[0]
        sampled, at = (
            first + (each - first) / (1 + drift) for each in (self.sampled, self.across[0])
        )
        return replace(self, sampled=sampled, across=np.stack((at, self.across[1])))

    def _where(self, there: Mask) -> AxisLog:
        return replace(self, sampled=self.sampled[there], ball=self.ball[there])


@dataclass(frozen=True)
class AnyLog:
    """A log of any rig.

    Attributes:
        source: Its name in messages.
        axes: Axis to what the log has of it.
        unit: Unit of the tilt of each axis: rad or counts.
        notes: What was left out or assumed, in words.
    """

    source: str
    axes: Mapping[str, AxisLog]
    unit: Mapping[str, str]
    notes: tuple[str, ...]

    def on(self, scenario: Scenario, later: float = 0.0) -> Log:
        """As the rig of a scenario would have recorded it, a row every control period.

        The plate is where its drives take it of what was commanded, or as it was measured; an axis
        without columns stays at zero.

        Args:
            scenario: The rig: its period, ball, plate, drives, and tilt per command.
            later: Time in s by which the plate is to come later.

        Raises:
            LogError: If a command is in counts, or the ball was off that rig's plate.
        """
        if counted := [axis for axis, unit in self.unit.items() if unit != "rad"]:
            role = f"command_{AXIS_COLUMNS[counted[0]][1]}"
            raise LogError(
                f"{self.source}: {role}: in counts; the twin needs the plate's angle, a count's as "
                f"{role}=NAME:0.24deg"
            )
        half = np.divide(scenario.dimensions.screen, 2)
        first = next(iter(self.axes.values()))
        period = scenario.rig.period
        begin = max(float(first.sampled[0]), *(float(own.time[0]) for own in self.axes.values()))
        time = np.arange(math.ceil(begin / period), int(first.sampled[-1] / period) + 1) * period
        newest = np.searchsorted(first.sampled, time, side="right") - 1
        ball, plate, rate = np.zeros((3, len(time), 2))
        for axis, own in self.axes.items():
            k = list(AXIS_COLUMNS).index(axis)
            far = float(np.percentile(np.abs(own.ball), 99))
            if far > half[k]:
                raise LogError(
                    f"{self.source}: {AXIS_COLUMNS[axis][0]}: reaches {far:.3g} m, the plate ends "
                    f"at {half[k]:.3g} m: a wrong unit, or a different rig (--on, plant.size)"
                )
            ball[:, k] = own.ball[newest]
            if own.held:
                sent = own.tilt[np.maximum(np.searchsorted(own.time, time - later, "right") - 1, 0)]
                corner = scenario.plant.servo.bandwidth_hz
                stay = math.exp(-2 * math.pi * corner * period) if corner else 0.0
                behind = scipy.signal.lfilter([1 - stay], [1, -stay], sent, zi=[stay * sent[0]])[0]
                plate[:, k] = (1 + scenario.rig.cam_error_percent[k] / 100) * behind
                # a drive with rate commands takes the time between two commands for the way between
                count = max(1, round(float(np.median(np.diff(own.time))) / period))
                asked = scipy.signal.lfilter(np.full(count, 1 / count), [1.0], sent - sent[0])
            else:
                asked = plate[:, k] = np.interp(time - later, own.time, own.tilt)
            rate[:, k] = np.diff(asked, append=asked[-1:]) / period
        age = time - first.sampled[newest]
        seen = age < MAX_COMMAND_GAP_S / 2
        ball[~seen] = np.nan
        return Log(
            source=self.source,
            time=time,
            ball=ball,
            plate=plate,
            age=age,
            touched=seen,
            command=rate,
            model=scenario.plant.model,
            own_lag=0.0,
            grips=(0.0,),
            axes=1 if list(self.axes) == ["x"] else 2,
            walls=scenario.plant.reach,
        )


def ball_factor(text: str | float) -> float:
    """Share of gravity that accelerates a ball: of ``hollow``, ``solid``, or a number.

    Raises:
        LogError: If it is neither, or no ball has it.
    """
    try:
        factor = GRAVITY_SHARES.get(str(text)) or float(text)
    except ValueError:
        factor = 0.0
    if not 0.5 <= factor <= 1.0:
        raise LogError(f"--ball {text}: give hollow (3/5), solid (5/7) or a share from 0.5 to 1")
    return factor


def ball_inertia(mass: float, radius: float, factor: float) -> float:
    """Moment of inertia in kg m^2 of a ball of which gravity accelerates a share when it rolls.

    Args:
        mass: kg.
        radius: m.
        factor: The share.
    """
    return mass * radius**2 * (1 / factor - 1)


def ball_heights(text: str | float) -> tuple[float, float]:
    """Heights of a ball's centre above the plate's axis along x and y, m: one for both, or two.

    Raises:
        LogError: If they are no such heights.
    """
    try:
        heights = [float(part) for part in str(text).split(",")]
    except ValueError:
        heights = []
    if len(heights) not in (1, 2) or not all(
        BALL_HEIGHT_RANGE_M[0] <= each <= BALL_HEIGHT_RANGE_M[1] for each in heights
    ):
        raise LogError(
            f"ball_height: {text}: give metres from the axis about which the plate tilts up to the "
            f"ball's centre, {BALL_HEIGHT_RANGE_M[0]:g} to {BALL_HEIGHT_RANGE_M[1]:g}, "
            "or two of them, along x and y: X,Y"
        )
    return heights[0], heights[-1]


def wanted_columns(text: str) -> dict[str, ColumnWanted]:
    """Read the wanted columns from a list ``role=name:unit,...``.

    Raises:
        LogError: If a role is unknown, given twice, or required and missing.
    """
    found: dict[str, ColumnWanted] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        role, equals, name = (each.strip() for each in part.partition("="))
        role = ROLE_ALIASES.get(role, role)
        if role not in ROLE_UNITS or not equals or not name:
            meant = "" if role in ROLE_UNITS else suggest(role, ROLE_UNITS)
            raise LogError(
                f"--columns: '{part}'{meant or ':'} give ROLE=NAME:UNIT, role one of "
                + ", ".join(ROLE_UNITS)
            )
        if role in found:
            raise LogError(f"--columns: {role}: given twice")
        sign = -1.0 if name.startswith("-") and len(name) > 1 else 1.0
        name, _, unit = name.removeprefix("-").rpartition(":")
        name, unit = (name, unit) if name else (unit, "")
        if unit and unit_factor(unit, ROLE_UNITS[role]) is None:
            known = ", ".join(filter(None, _unit_scales(ROLE_UNITS[role])))
            raise LogError(
                f"--columns: {role}: unit '{unit}'; known: {known}, each with a factor before it"
            )
        found[role] = ColumnWanted(name.strip(), unit, sign)
    lacking: list[str] = []
    if not any(ball in found for ball, _ in AXIS_COLUMNS.values()):
        lacking.append("measured_x or measured_y")
    for ball, angle in AXIS_COLUMNS.values():
        if ball in found and not {f"command_{angle}", f"measured_{angle}"} & set(found):
            lacking.append(f"command_{angle} or measured_{angle}, for {ball}")
    if lacking:
        raise LogError(f"--columns: give {'; '.join(lacking)}, too")
    return found


def unit_factor(unit: str, si: str) -> float | None:
    """Factor from a unit such as ``mm``, ``0.5mm`` or ``0.24`` to SI; None if it is none."""
    unit = unit.replace("°", "deg").replace("µ", "u")
    match = re.fullmatch(r"\s*([0-9.]+(?:[eE][-+]?\d+)?)?\s*\*?\s*([A-Za-z1]*)\s*", unit)
    if match is None:
        return None
    scale = _unit_scales(si).get(match[2], 1.0 if match[1] and not match[2] else None)
    try:
        factor = float(match[1] or 1.0) * (scale or 0.0)
    except ValueError:
        return None
    return factor if 0.0 < factor < math.inf else None


def _unit_scales(si: str) -> dict[str, float]:
    """The units of a quantity and their factors."""
    return UNIT_SCALES[si] | (COUNT_UNITS if si == "rad" else {})


def read_any(
    path: Path,
    wanted: Mapping[str, ColumnWanted],
    separator: str | None = None,
) -> AnyLog:
    """Read a log of any rig.

    Args:
        path: A text file with columns, with or without a header, or a file of one of
            ``foreign_logs.READERS_BY_KIND``.
        wanted: Role to column.
        separator: Between columns of text; None to find it.

    Raises:
        LogError: If it cannot be read, lacks a column, or a column is of an unknown unit.
    """
    header, cells, clocks, notes = split_content(path.name, open_content(path), wanted, separator)
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    times: dict[str, Array] = {}
    roles: dict[int, str] = {}
    for role, column in wanted.items():
        index, unit = _find_column(path.name, header, role, column)
        if (other := roles.setdefault(index, role)) != role:
            raise LogError(
                f"--columns: {other} and {role}: both are column {column.name} of {path.name}; "
                "give each role its own"
            )
        unit = column.unit or unit
        factor = unit_factor(unit, ROLE_UNITS[role]) if unit else 1.0
        if factor is None:
            raise LogError(
                f"{path.name}: {role}: unit '{unit}' of {column.name}; tell it, as "
                f"{role}=NAME:{list(UNIT_SCALES[ROLE_UNITS[role]])[-1]}, with a factor before it "
                "(a pixel of half a millimetre as NAME:0.5mm, a count as NAME:0.24deg)"
            )
        if index >= len(cells):
            raise LogError(f"{path.name}: {role}: no column {column.name}: there are {len(cells)}")
        values, broken = parse_numbers(cells[index])
        if broken > 0.2 * len(values) or not np.isfinite(values).any():
            raise LogError(f"{path.name}: {role}: {column.name} contains hardly any numbers")
        if broken:
            notes.append(f"{broken} cells of {column.name} are no numbers: taken as empty")
        columns[role] = column.sign * factor * values
        if index in clocks:
            times[role] = clocks[index]
        counted = ROLE_UNITS[role] == "rad" and re.search(r"deg|°|rad$", unit) is None and unit
        units[role] = "count" if counted else ROLE_UNITS[role]
    rows = _on_one_clock(path.name, columns, times, notes)
    return _clean_log(path.name, rows, units, notes, merged=rows is not columns)


def with_unit(name: str, unit: str | None) -> str:
    """A column's name as a header has it."""
    return f"{name} [{unit}]" if unit else name


def open_content(path: Path) -> ForeignTable | str:
    """The table of a file of one of ``foreign_logs.READERS_BY_KIND``, or else its text.

    Raises:
        TwinError: If it cannot be read.
    """
    try:
        table = foreign_table(path)
        return decode_text(path.read_bytes()) if table is None else table
    except OSError as error:
        raise LogError(f"{path.name}: cannot be read: {error.strerror or error}") from error


def split_content(
    source: str,
    content: ForeignTable | str,
    wanted: Mapping[str, ColumnWanted],
    separator: str | None = None,
) -> tuple[list[str], list[Array | list[str]], dict[int, Array], list[str]]:
    """Every column of a log.

    Args:
        source: What to call the file in messages.
        content: Its table or its text.
        wanted: Role to column; names that may be in the header.
        separator: Between columns of text; None to find it.

    Returns:
        Headers, empty of a text without them; numbers or texts of each column; number of a column
        to its own times in s; notes.

    Raises:
        LogError: If a text is empty, or its header does not fit its rows.
    """
    if isinstance(content, str):
        header, cells, notes = _split_columns(source, content, wanted, separator)
        return header, cells, {}, notes
    header = [with_unit(name, content.units.get(name)) for name in content.columns]
    clocks = {k: content.clocks[n] for k, n in enumerate(content.columns) if n in content.clocks}
    return header, list(content.columns.values()), clocks, list(content.notes)


def _on_one_clock(
    source: str, columns: dict[str, Array], times: Mapping[str, Array], notes: list[str]
) -> dict[str, Array]:
    """The columns as rows of one time, empty where a column has no sample.

    Args:
        source: What to call the file in messages.
        columns: Role to values in SI units.
        times: Role to times in s, of columns that have times of their own.
        notes: Receives what was done.

    Raises:
        LogError: If there is no time, or a column has a different number of rows.
    """
    if "time" in columns:
        base = times.get("time")

        def shares_rows(each: Array) -> bool:
            if base is None:
                return len(each) == len(columns["time"])
            return np.array_equal(each, base)

        times = {k: each for k, each in times.items() if k != "time" and not shares_rows(each)}
    missing = [role for role in columns if role not in times]
    if missing and "time" not in columns:
        raise LogError(f"{source}: {missing[0]} has no times; give time in --columns, too")
    for role in missing:
        if len(columns[role]) != len(columns["time"]):
            raise LogError(
                f"{source}: {role}: has {len(columns[role])} rows, time {len(columns['time'])}"
            )
    if not times:
        return columns
    clocks = {role: times[role] if role in times else columns["time"] for role in columns}
    if "measured_y" in columns and "measured_x" in columns:
        x, y = clocks["measured_x"], clocks["measured_y"]
        if len(x) != len(y) or (x != y).any():
            columns["measured_y"] = _interpolate(x, y, columns["measured_y"])
            clocks["measured_y"] = x
            notes.append("measured_y has times of its own: taken at those of measured_x")
    every = np.unique(np.concatenate(list(clocks.values())))
    every = every[np.isfinite(every)]
    rows = {"time": every}
    for role in filter(lambda role: role != "time", columns):
        at, first = np.unique(clocks[role], return_index=True)
        at, first = at[np.isfinite(at)], first[np.isfinite(at)]
        rows[role] = np.full(len(every), np.nan)
        rows[role][np.searchsorted(every, at)] = columns[role][first]
    for role in {"age", "touched"} & columns.keys():
        rows[role] = _hold(rows[role])
    rates = sorted({float(f"{_rate(each):.3g}") for each in clocks.values()})
    if len(rates) > 1:
        listed = ", ".join(f"{each:g} Hz" for each in rates)
        notes.append(f"columns have times of their own, at {listed}")
    return rows


def _interpolate(at: Array, time: Array, values: Array) -> Array:
    """Values at some times by straight lines; NaN outside."""
    known = np.isfinite(time) & np.isfinite(values)
    order = np.argsort(time[known], kind="stable")
    return np.interp(at, time[known][order], values[known][order], left=np.nan, right=np.nan)


def _hold(values: Array) -> Array:
    """Values with the newest one where there is none."""
    newest = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), 0))
    return values[newest]


def _rate(time: Array) -> float:
    """Rows per second; 0 of a clock that stands."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return 1 / step if step > 0 else 0.0


def _split_columns(
    source: str,
    text: str,
    wanted: Mapping[str, ColumnWanted],
    separator: str | None,
) -> tuple[list[str], list[Array | list[str]], list[str]]:
    """The header and the columns of a text, as texts, and notes on rows that are left out.

    Rows that are cut are left out: the first and the last if they are shorter than usual, and
    others that are shorter or longer where these are few.

    Args:
        source: What to call the file in messages.
        text: All of it.
        wanted: Role to column.
        separator: Between columns; None to find it.

    Raises:
        LogError: If it is empty, or its header does not fit its rows.
    """
    lines = plain_lines(text)
    if not lines:
        raise LogError(f"{source}: is empty")
    split = _make_splitter(lines, SEPARATOR_NAMES.get(separator or "", separator))
    rows = [[cell.strip().strip("\"'") for cell in split(line)] for line in lines]
    header, at = _find_header(rows, wanted)
    rows = rows[at:]
    counts = np.array([len(row) for row in rows], dtype=int)
    usual = int(np.bincount(counts).argmax()) if len(rows) else 0
    named = len(header)
    known = {name for names in _name_columns(header) for name in names}
    by_name = any(each.name.casefold() in known for each in wanted.values())
    more = any(any(row[named:]) for row in rows if len(row) == usual)
    if by_name and (more or (named > usual > 0 and split is str.split)):
        raise LogError(
            f"{source}: its header names {named} columns, its rows have {usual}: give the header a "
            "name for each, or take it out and give numbers of columns"
        )
    odd = counts != usual
    share = float(odd.sum()) / max(len(odd), 1)
    several = len(set(counts[odd])) > 1 and share < MAX_CUT_ROWS
    if share > FEW_ODD_ROWS and not several:  # then the writing program pads rows like this
        odd[1:-1] = False
        odd &= counts < usual
    notes = []
    if odd.any():
        cut = "the first row" if odd[0] and odd.sum() == 1 else f"{int(odd.sum())} rows"
        notes.append(f"{cut} left out: not the usual {usual} cells")
    kept = [row for row, is_odd in zip(rows, odd, strict=True) if not is_odd]
    width = max(usual, named)
    columns = [[row[k] if k < len(row) else "" for row in kept] for k in range(width)]
    return header, list(columns), notes


def _make_splitter(lines: list[str], separator: str | None) -> Callable[[str], list[str]]:
    """Function that splits a line into cells: by the separator that most lines have equally often.

    Raises:
        LogError: If the given separator does not separate the columns.
    """
    if separator is None:
        some = lines[len(lines) // 2 :][:50]

        def alike(each: str) -> float:
            counts = [line.count(each) for line in some]
            usual = int(np.median(counts))
            return float(np.mean([count == usual for count in counts])) if usual else 0.0

        separator = next((s for s in (";", "\t", ",") if alike(s) > 0.8), " ")
    if separator == " ":
        return str.split
    if not separator or set(separator) & set('"\r\n'):
        raise LogError(
            f"--separator {separator!r}: separates no columns; give a sign such as ; or "
            f"one of the words {', '.join(word for word in SEPARATOR_NAMES if word.isalpha())}"
        )
    between = separator

    def split(line: str) -> list[str]:
        if '"' not in line or len(between) > 1:
            return line.split(between)
        return next(csv.reader([line], delimiter=between, skipinitialspace=True))

    return split


def _find_header(
    rows: list[list[str]], wanted: Mapping[str, ColumnWanted]
) -> tuple[list[str], int]:
    """The names of the columns, empty without any, and the row at which numbers begin."""
    for at, row in enumerate(rows[:50]):
        known = {name for names in _name_columns(row) for name in names}
        named = any(each.name.casefold() in known for each in wanted.values())
        if named and not _is_number(row[0]):
            return _join_units(row, rows[at + 1 :], at + 1)
    for at, row in enumerate(rows[:50]):
        if sum(_is_number(cell) for cell in row) > len(row) / 2:
            before = [each for each in rows[:at] if min(len(row), 2) <= len(each) >= len(row) - 1]
            if before and len(before) > 1 and _are_units(before[-1]):
                return _join_units(before[-2], before[-1:], at)[0], at
            return before[-1] if before and before[-1] == rows[at - 1] else [], at
    return [], 0


def _join_units(header: list[str], rows: list[list[str]], at: int) -> tuple[list[str], int]:
    """Names with the units that the first of some rows has, and the row at which numbers begin.

    Args:
        header: The names.
        rows: All rows behind them.
        at: The index of the first of these in the text.
    """
    if not rows or len(rows[0]) != len(header) or not _are_units(rows[0]):
        return header, at
    units = [cell.strip("[]()") for cell in rows[0]]
    known = [unit if _is_unit(unit) else "" for unit in units]
    return [with_unit(name, unit) for name, unit in zip(header, known, strict=True)], at + 1


def _are_units(row: list[str]) -> bool:
    """Whether some cells are units, and none a number or a longer word."""
    units = [cell.strip("[]()") for cell in row]
    return any(map(_is_unit, units)) and all(
        len(unit) < 5 and not _is_number(unit) for unit in units
    )


def _is_unit(unit: str) -> bool:
    """Whether a cell is a unit; a number alone, which is a factor elsewhere, is none."""
    named = re.match(r"[^\W\d]|[°%]", unit) is not None
    return named and any(unit_factor(unit, si) is not None for si in ROLE_UNITS.values())


def _name_columns(header: list[str]) -> tuple[list[str], list[str]]:
    """The names of columns as they stand and without their units, in small letters."""
    return [c.casefold() for c in header], [split_unit(c)[0].casefold() for c in header]


def _find_column(
    source: str, header: list[str], role: str, column: ColumnWanted
) -> tuple[int, str]:
    """Place of a column, and the unit that the header gives it."""
    for names in _name_columns(header):
        if names.count(column.name.casefold()) > 1:
            raise LogError(f"{source}: {role}: two columns are called {column.name}; give a number")
        if column.name.casefold() in names:
            index = names.index(column.name.casefold())
            return index, split_unit(header[index])[1] or ""
    if column.name.isdecimal() and int(column.name) >= 1:
        return int(column.name) - 1, ""
    has = ", ".join(header[:20]) or "no header: give numbers of columns, 1 for the first"
    meant = suggest(column.name, (split_unit(each)[0] for each in header))
    raise LogError(f"{source}: {role}: no column {column.name}{meant} (it has {has})")


def _is_number(cell: str) -> bool:
    return re.fullmatch(r"[-+]?[0-9]*[.,]?[0-9]+([eE][-+]?[0-9]+)?[.,]?", cell) is not None


TIME_OF_DAY = re.compile(
    r"(?:(?P<days>\d+) days? )?"
    r"(?:(?P<day>\d{1,2})(?P<sign>[./])(?P<month>\d{1,2})(?P=sign)(?P<year>\d{4}),? )?"
    r"(?P<hours>\d{1,2}):(?P<minutes>\d\d):(?P<seconds>\d\d(?:\.\d+)?)(?: (?P<half>am|pm))?"
)
"""A time of day, after a number of days or a date that does not begin with the year."""


def parse_numbers(cells: Array | list[str]) -> tuple[Array, int]:
    """Numbers of cells, NaN where there is none, and how many are neither number nor blank.

    A comma is a decimal sign, or with a point in the same cell whichever of the two is last.
    """
    if not isinstance(cells, list):
        return np.where(np.isfinite(cells), cells, np.nan), 0
    values, broken = np.full(len(cells), np.nan), 0
    for k, cell in enumerate(cells):
        word = cell.casefold()
        if ":" in word:
            word = re.sub(r",(?=\d)", ".", word)
        elif "," in word:
            if word.rfind(".") > word.rfind(","):
                word = word.replace(",", "")
            elif "." in word:
                word = word.replace(".", "")
            word = word.replace(",", ".")
        try:
            values[k] = BOOLEAN_WORDS[word] if word in BOOLEAN_WORDS else float(word)
        except ValueError:
            try:
                values[k] = _parse_time(word)
            except ValueError:
                broken += word not in BLANK_CELLS
    values[~np.isfinite(values)] = np.nan
    return values, broken


def _parse_time(word: str) -> float:
    """Seconds of a date, a time of day or a number of days and hours.

    Raises:
        ValueError: If it is none.
    """
    found = TIME_OF_DAY.fullmatch(word)
    if found is None:
        return datetime.fromisoformat(word.upper()).replace(tzinfo=UTC).timestamp()
    seconds = 3600.0 * int(found["hours"]) + 60.0 * int(found["minutes"]) + float(found["seconds"])
    if found["half"]:
        seconds += 43200.0 * ((found["half"] == "pm") - (int(found["hours"]) == 12))
    if found["year"]:
        day, month = int(found["day"]), int(found["month"])
        if found["sign"] == "/" and day <= 12:  # as in the United States
            day, month = month, day
        return datetime(int(found["year"]), month, day, tzinfo=UTC).timestamp() + seconds
    return 86400.0 * int(found["days"] or 0) + seconds


def _clean_log(
    source: str,
    columns: dict[str, Array],
    units: dict[str, str],
    notes: list[str],
    *,
    merged: bool = False,
) -> AnyLog:
    """A log of columns in SI units, without what is false in it.

    Args:
        source: What to call the file in messages.
        columns: Role to values, shape (K,) each.
        units: Role to unit.
        notes: What was left out or assumed before.
        merged: Whether columns with times of their own became rows of one time.

    Raises:
        LogError: If too little is left.
    """
    columns = _keep_rising_rows(columns, notes)
    time = columns["time"]
    balls = [columns[ball] for ball, _ in AXIS_COLUMNS.values() if ball in columns]
    ball = np.stack(balls, axis=-1)
    # of columns with times of their own two may be as close as it happens
    sampled_at = time[np.isfinite(ball).all(axis=-1)] if merged else time
    step = float(np.median(np.diff(sampled_at))) if len(sampled_at) > 1 else 0.0
    if len(time) < 50 or not 2e-5 < step < MAX_COMMAND_GAP_S:
        hint = "; milliseconds? tell time=NAME:ms" if step >= MAX_COMMAND_GAP_S else ""
        raise LogError(
            f"{source}: {len(time)} usable rows, {step:.3g} s apart: at least 50 are needed, at "
            f"most {MAX_COMMAND_GAP_S:g} s apart{hint}"
        )
    seen = columns.get("touched", np.ones_like(time)) > 0.5
    sampled = time - np.nan_to_num(columns.get("age", np.zeros_like(time)))
    middle = np.nanmedian(ball, axis=0)
    far = float(np.nanpercentile(np.abs(ball - middle), 99))
    # on a plate, and hardly moved from there: no other unit makes a moving ball of it
    resting = far < MIN_MOTION_M < np.abs(middle).max() < MAX_MOTION_M
    if far == 0 or resting:
        raise LogError(
            f"{source}: the ball does not move: it stays within {far:.3g} m of one place, and must "
            f"roll for {MIN_MOTION_M:g} m at least"
        )
    if not MIN_MOTION_M < far < MAX_MOTION_M:
        either = "the ball hardly moves, or " if far <= MIN_MOTION_M else ""
        raise LogError(
            f"{source}: the ball's positions lie within {far:.3g} m of their middle, a plate's "
            f"within {MIN_MOTION_M:g} to {MAX_MOTION_M:g} m: {either}tell the unit, as "
            "measured_x=NAME:mm"
        )
    seen &= np.isfinite(ball).all(axis=-1)
    false = _find_false_samples(ball, seen)
    if false.any():
        notes.append(
            f"{int(false.sum())} ball positions left out: held, or far off their neighbours"
        )
    shown = np.flatnonzero(seen & ~false)
    if len(shown) < 10:
        raise LogError(
            f"{source}: the ball is seen in {len(shown)} rows, too few to identify; record "
            "a longer log"
        )
    shown = shown[np.argsort(sampled[shown], kind="stable")]
    # rows of one frame, recognised by its age, are one sample
    shown = shown[np.diff(sampled[shown], prepend=-np.inf) > min(step / 2, 1e-4)]
    axes, tilts = {}, {}
    seen_along = {
        axis: columns[name][shown] for axis, (name, _) in AXIS_COLUMNS.items() if name in columns
    }
    for axis, place in seen_along.items():
        angle = AXIS_COLUMNS[axis][1]
        role = f"measured_{angle}" if f"measured_{angle}" in columns else f"command_{angle}"
        known = np.isfinite(columns[role])
        held, at = role.startswith("command"), sampled[shown]
        across = (_speed(at, e) for e in seen_along.values() if e is not place and not held)
        axes[axis] = AxisLog(time[known], columns[role][known], held, at, place, *across)
        tilts[axis] = units[role]
    return AnyLog(source, axes, tilts, tuple(notes))


def _keep_rising_rows(columns: Mapping[str, Array], notes: list[str]) -> dict[str, Array]:
    """Columns with the rows whose time is later than all before, from zero on.

    Args:
        columns: Role to values, shape (K,) each.
        notes: Of the log, to which is added what was done.
    """
    there = np.isfinite(columns["time"])
    columns = {role: values[there] for role, values in columns.items()}
    false = _find_false_times(columns["time"])
    if false.any():
        notes.append(f"{int(false.sum())} rows left out whose time is between no others")
    columns = {role: values[~false] for role, values in columns.items()}
    time: Array = columns["time"] - columns["time"][:1]
    back = np.flatnonzero(np.diff(time) < -MAX_COMMAND_GAP_S)
    for row in back:  # a clock that begins anew: a new part, after a gap
        time[row + 1 :] += time[row] - time[row + 1] + 10 * MAX_COMMAND_GAP_S
    if len(back):
        notes.append(f"the clock begins anew {len(back)} times: taken as parts of their own")
    time = _spread_coarse_stamps(time, columns, notes)
    kept = np.concatenate(([True], np.diff(np.maximum.accumulate(time)) > 0))
    joined = _join_rows_of_one_time(time, kept, columns)
    if joined:
        notes.append(f"{joined} rows joined with the one before them, which is of the same time")
    if (left := int((~kept).sum()) - joined) > 0:
        notes.append(f"{left} rows of a time that does not rise left out")
    return {role: values[kept] for role, values in (columns | {"time": time}).items()}


def _find_false_times(time: Array) -> Mask:
    """Rows whose time is far from that of both neighbours, which follow each other, shape (K,)."""
    before, here, after = time[:-2], time[1:-1], time[2:]
    follow = (after > before) & (after - before < MAX_COMMAND_GAP_S)
    far = (here < before - MAX_COMMAND_GAP_S) | (here > after + MAX_COMMAND_GAP_S)
    return np.pad(follow & far, 1)[: len(time)]


def _spread_coarse_stamps(time: Array, columns: Mapping[str, Array], notes: list[str]) -> Array:
    """Times of rows that share stamps nearly everywhere, as of a clock in whole seconds, spread.

    The first row of each stamp keeps it, and the others follow evenly. Rows without a command are
    halves of one row and stay, see ``_join_rows_of_one_time``.

    Args:
        time: Of the rows, s, shape (K,).
        columns: Role to values, shape (K,) each.
        notes: Of the log, to which is added what was done.
    """
    tilts = [columns[angle] for angle in columns if angle.endswith(("_phi", "_theta"))]
    whole = all(np.isfinite(values).mean() > MIN_WHOLE_SHARE for values in tilts)
    first = np.flatnonzero(np.diff(time, prepend=-np.inf) != 0)
    counts = np.diff(first)
    if len(first) < 4 or not whole or np.mean(counts > 1) < MIN_SHARED_STAMPS:
        return time
    spread = np.interp(np.arange(len(time)), first, time[first])
    step = float(np.median(np.diff(time[first]))) / float(np.median(counts))
    # the first stamp may begin earlier than the log, and the last one ends with it
    early, late = np.arange(first[1]), np.arange(first[-1], len(time))
    spread[early] = time[first[1]] - step * (first[1] - early)
    spread[late] = time[first[-1]] + step * (late - first[-1])
    notes.append(
        f"about {np.median(counts):g} rows share each stamp of {np.median(np.diff(time[first])):g} "
        "s: taken as evenly spread"
    )
    return np.asarray(spread)


def _join_rows_of_one_time(time: Array, kept: Mask, columns: dict[str, Array]) -> int:
    """Fill the empty cells of rows from later rows of the same time, in place; how many of these.

    Programs write what they measure and what they command as rows of their own.

    Args:
        time: Of the rows, s, shape (K,).
        kept: Rows whose time is later than all before, shape (K,).
        columns: Role to values, shape (K,) each.
    """
    first = np.flatnonzero(kept)[np.cumsum(kept) - 1]
    again = np.flatnonzero(~kept & (time == time[first]))
    used = np.zeros(len(time), bool)
    for values in columns.values():
        fills = again[np.isfinite(values[again]) & ~np.isfinite(values[first[again]])]
        fills = fills[np.unique(first[fills], return_index=True)[1]]  # of several the earliest
        values[first[fills]] = values[fills]
        used[fills] = True
    return int(used.sum())


def _speed(time: Array, place: Array) -> Array:
    """Times in s and speeds in m/s, 0 of a slow ball, by parabolas over ``SEEN``, shape (2, N)."""
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], step)
    count = min(2 * round(SPEED_WINDOW_S / step / 2) + 3, (len(even) - 1) // 2 * 2 + 1)
    speed = scipy.signal.savgol_filter(np.interp(even, time, place), count, 2, deriv=1, delta=step)
    return np.stack((even, np.where(np.abs(speed) > REST_SPEED_M_S, np.abs(speed), 0.0)))


def _find_false_samples(ball: Array, seen: Mask) -> Mask:
    """Samples that repeat an earlier one or show no ball, shape (K,).

    A reading that repeats before or after a jump is a value held while no ball was detected; a
    ball at rest does not jump. Single false ones are found by the median of their neighbours.
    """
    false = np.zeros_like(seen)
    at = np.flatnonzero(seen)
    if len(at) < 9:
        return false
    here = ball[at]
    grid = max(resolution(here[:, axis]) for axis in range(here.shape[1]))
    usual = np.median(np.abs(np.diff(here, n=2, axis=0)), axis=0).max()
    jump = max(MIN_JUMP_M, 2.5 * grid, 8 * usual)
    step = np.concatenate((np.abs(np.diff(here, axis=0)).max(axis=1), [0.0]))
    for first, stop in runs(np.asarray(step[:-1] == 0)):
        after = step[stop]
        before = step[first - 1] if first else 0.0
        if stop - first >= 2 and max(before, after) > jump:
            false[at[first + (before <= jump) : stop + 1]] = True
    at = np.flatnonzero(seen & ~false)
    here = ball[at]
    off = np.abs(here - scipy.ndimage.median_filter(here, size=(9, 1), mode="nearest")).max(axis=1)
    false[at[off > np.maximum(jump, 3 * np.percentile(off, 90))]] = True
    return false


def resolution(measured: Array) -> float:
    """Smallest step between two different readings, 0 if there is none."""
    steps = np.diff(np.unique(measured))
    steps = steps[steps > 1e-9]
    return float(steps.min()) if len(steps) else 0.0


def find_noise(samples: Array) -> Array:
    """Standard deviation of the noise of evenly spaced samples of a smooth motion.

    The second difference of white noise of standard deviation s has sqrt(6) s, and the median of
    the absolute value of a normal number is 0.6745 standard deviations. What the motion itself
    bends in two steps is taken to be less than the noise.

    Args:
        samples: Along the first axis, shape (K,) or (K, A).

    Returns:
        In the unit of the samples, shape () or (A,).
    """
    bend = np.diff(samples, n=2, axis=0)
    return np.asarray(np.median(np.abs(bend), axis=0) / (0.6745 * np.sqrt(6)))


def runs(mask: Mask) -> list[tuple[int, int]]:
    """First index and one past the last of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
