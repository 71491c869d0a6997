"""From recorded rows to columns for Rerun: a stream per run and one of its twin, fed by blocks."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rerun as rr
from numpy.typing import NDArray

from controllers.arrays import Array, Mask
from controllers.interfaces import Reference
from twin.errors import RecordError
from twin.hal.cams import CamTable
from twin.hal.supervisor import State
from twin.run.assemble import build_friction, build_limits, build_reference
from twin.run.finished import Run, columns, states_of
from twin.scenario.schema import Scenario
from twin.settings import changed
from twin.sim.plant.interface import Parts
from twin.sim.plant.model import load_model
from twin.view.scene import Scene, fixed, in_view, rolled
from twin.view.signals import (
    BLACK,
    GREY,
    PINK,
    RUNS,
    VERMILION,
    WORDS,
    Colour,
    Signal,
    signals,
    tinted,
)

TIMELINE = "simulated time [s]"
FRAMES = 50.0
"""Poses and trails per second; the plots have every period."""
TRAIL = 3.0
"""Seconds of the ball's path that its trail shows."""
FORCE_SCALE = {"phi": 0.001, "theta": 0.001, "ball": 0.25}
"""Metres of arrow per newton: a wheel bears some 50 N, the ball presses with 0.24 N."""
COLOURS = {
    State.OFF: 0x757575FF,
    State.INITIALISING: 0x56B4E9FF,
    State.READY: 0xE69F00FF,
    State.RUNNING: 0x009E73FF,
    State.HOLDING: 0xD55E00FF,
    State.FAULT: 0xCC0000FF,
}


class Batch(NamedTuple):
    """What goes to one entity in one call: times in s, shape (K,), and columns of components."""

    entity: str
    time: Array
    columns: rr.ComponentColumnList


class RunStream:
    """One run as entities under its name.

    Args:
        name: The run's name, the root of its entities.
        scenario: What is run.
        among: Which of the runs shown together it is, from 0; None if it is alone.
        reference: Where the ball is to be; that of the scenario by default.

    Raises:
        TwinError: If the scenario cannot be assembled.
    """

    def __init__(
        self,
        name: str,
        scenario: Scenario,
        among: int | None = None,
        reference: Reference | None = None,
    ) -> None:
        self.name = name
        self._among = among
        self._colour = RUNS[(among or 0) % len(RUNS)]
        self.root = f"/{rr.escape_entity_path_part(name)}"
        self._reference = build_reference(scenario) if reference is None else reference
        self._limits = build_limits(scenario.rig.limits)
        self._scenario = scenario
        model = load_model(parts=changed(Parts, scenario))
        self.scene = Scene(model, f"{self.root}/mechanism")
        self._cams = CamTable.packaged()
        self._turn = np.array([0.0, 0.0, 0.0, 1.0])
        self._last: Array | None = None
        self._trail = np.empty((0, 3))
        self._next_frame = -1.0
        self._state = -1
        self._marks: dict[str, bool] = {}

    def fixed(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """What does not change over the run: shapes, top view of the plate, reference path."""
        yield from self.scene.shapes(self._colour)
        times = np.linspace(0, self._scenario.duration, 2000)
        path = self._reference(times)[0]
        friction = build_friction([self._scenario])
        surface = friction.map if friction is not None else None
        yield from fixed(
            f"{self.root}/plate_mm",
            path,
            self._scenario.rig.limits.area,
            surface,
            colour=self._colour,
        )
        lifted = np.column_stack((path, np.full(len(path), self.scene.surface + 0.001)))
        yield (
            f"{self.scene.plate}/reference_path",
            rr.LineStrips3D([lifted], colors=[[235, 235, 235]], radii=0.0008),
        )
        yield (
            f"{self.root}/supervisor",
            rr.StateConfiguration(
                values=[state.name.lower() for state in State],
                colors=np.array([COLOURS[state] for state in State], dtype=np.uint32),
            ),
        )

    def batches(self, rows: Mapping[str, Array]) -> Iterator[Batch]:
        """A block of rows, shape (K,) per column, as columns for the viewer."""
        time = rows["time"]
        if len(time) == 0:
            return
        reference = self._reference(time)[0]
        for group, plot in self.plots(rows).items():
            for name, signal in plot.items():
                seen = np.isfinite(signal.values) if signal.points else np.full(len(time), True)
                if seen.any():
                    shown = rr.Scalars.columns(scalars=signal.values[seen])
                    yield Batch(f"{self.root}/{group}/{name}", time[seen], shown)
        yield from self._states_and_events(rows)
        keep = self._frames(time)
        if len(keep):
            frames = {name: column[keep] for name, column in rows.items()}
            ball = states_of(frames)[:, 0::4]
            before = ball[:1] if self._last is None else self._last
            turns = rolled(self._turn, np.concatenate((before, ball)), self.scene.radius)[1:]
            self._last, self._turn = ball[-1:], turns[-1]
            yield from self._moving(frames, turns)
            yield from self._on_plate(frames, reference[keep])

    def plots(self, rows: Mapping[str, Array]) -> dict[str, dict[str, Signal]]:
        """The lines of the time plots: group to name to signal."""
        reference = self._reference(rows["time"])[0]
        dead_time = self._scenario.sensors.touch.dead_time
        plots = signals(rows, reference, self._limits, dead_time)
        if self._among is None:
            return plots
        return {group: tinted(plot, self._among) for group, plot in plots.items()}

    def styles(self, rows: Mapping[str, Array]) -> Iterator[tuple[str, rr.AsComponents]]:
        """Colour, width and name of each line of the plots, as the rows have them."""
        for group, plot in self.plots(rows).items():
            for name, signal in plot.items():
                called = name.replace("_", " ")
                if self._among is not None:
                    called = f"{self.name}: {called}"
                look = _look(signal.colour, signal.width, called, points=signal.points)
                yield f"{self.root}/{group}/{name}", look

    def _frames(self, time: Array) -> NDArray[np.integer]:
        """Indices of the rows of which a picture is made, FRAMES per second."""
        slot = np.floor(time * FRAMES + 1e-6)
        first = slot > np.concatenate(([self._next_frame], slot[:-1]))
        self._next_frame = float(slot[-1])
        return np.flatnonzero(first)

    def _states_and_events(self, rows: Mapping[str, Array]) -> Iterator[Batch]:
        """Supervisor states and events as they change."""
        time, state = rows["time"], rows["supervisor"].astype(int)
        changed = np.flatnonzero(np.diff(state, prepend=self._state))
        self._state = int(state[-1])
        names = [State(value).name.lower() for value in state[changed]]
        events = [(time[k], f"supervisor: {name}") for k, name in zip(changed, names, strict=True)]
        if names:
            yield Batch(
                f"{self.root}/supervisor", time[changed], rr.StateChange.columns(state=names)
            )
        active = {"ball off the screen's touch": rows.get("touched", np.ones(len(time))) < 0.5}
        for axis in ("phi", "theta"):
            requested, applied = rows[f"requested_{axis}_acc"], rows[f"applied_{axis}_acc"]
            active[f"{axis} effort limited"] = np.abs(requested - applied) > 0.01
            if f"wheel_{axis}_N" in rows:
                active[f"wheel {axis} lifted off its cam"] = rows[f"wheel_{axis}_N"] <= 0
        for what, mask in active.items():
            began = np.flatnonzero(np.diff(mask.astype(int), prepend=self._marks.get(what, 0)) > 0)
            self._marks[what] = bool(mask[-1])
            events += [(time[k], what) for k in began[:20]]
        yield from _told(self.root, sorted(events, key=lambda event: event[0]), "INFO")

    def _moving(self, rows: Mapping[str, Array], turns: Array) -> Iterator[Batch]:
        time, state = rows["time"], states_of(rows)
        if "motor_phi_rad" in rows:
            motor = np.stack((rows["motor_phi_rad"], rows["motor_theta_rad"]), axis=1)
        else:
            motor = self._cams.motor(state[:, 2::4])
        for entity, pose in self.scene.poses(state, motor, turns).items():
            yield Batch(entity, time, rr.Transform3D.columns(**pose))
        for axis, (at, way) in self.scene.wheels(state, motor).items():
            if f"wheel_{axis}_N" in rows:
                force = FORCE_SCALE[axis] * rows[f"wheel_{axis}_N"][:, None] * way
                yield _arrows(f"{self.scene.root}/force_wheel_{axis}", time, at, force)
        if "ball_N" in rows:
            push = np.zeros((len(time), 3))
            push[:, 2] = FORCE_SCALE["ball"] * rows["ball_N"]
            at = np.column_stack((state[:, 0], state[:, 4], np.full(len(time), self.scene.surface)))
            yield _arrows(f"{self.scene.plate}/force_ball", time, at, push)

    def _on_plate(self, rows: Mapping[str, Array], reference: Array) -> Iterator[Batch]:
        time, ball = rows["time"], states_of(rows)[:, 0::4]
        self._trail = np.concatenate((self._trail, np.column_stack((time, ball))))
        starts = np.searchsorted(self._trail[:, 0], time - TRAIL)
        ends = np.searchsorted(self._trail[:, 0], time, side="right")
        trails = [self._trail[a:b, 1:] for a, b in zip(starts, ends, strict=True)]
        self._trail = self._trail[starts[-1] :]
        estimate = columns(rows, "estimated")[:, 0::4]
        measured = np.stack((rows["measured_x"], rows["measured_y"]), axis=1)
        for name, points in (
            ("reference", reference),
            ("estimate", estimate),
            ("measured", measured),
            ("ball", ball),
        ):
            yield Batch(
                f"{self.root}/plate_mm/{name}",
                time,
                rr.Points2D.columns(positions=in_view(points)),
            )
        strips = [in_view(trail) for trail in trails]
        yield Batch(f"{self.root}/plate_mm/trail", time, rr.LineStrips2D.columns(strips=strips))
        high = self.scene.surface + 0.0015
        lifted = [np.column_stack((trail, np.full(len(trail), high))) for trail in trails]
        yield Batch(f"{self.scene.plate}/trail", time, rr.LineStrips3D.columns(strips=lifted))


def _look(colour: Colour, width: float, called: str, *, points: bool) -> rr.AsComponents:
    """How a line of the plots is drawn, or its points."""
    if not points:
        return rr.SeriesLines(colors=[colour], widths=[width], names=[called])
    return rr.SeriesPoints(
        colors=[colour], marker_sizes=[width], names=[called], markers=["circle"]
    )


def _told(root: str, events: Sequence[tuple[float, str]], level: str) -> Iterator[Batch]:
    """Times in s and texts of what happened, if anything did."""
    if events:
        times, texts = zip(*events, strict=True)
        lines = rr.TextLog.columns(text=texts, level=[level] * len(events))
        yield Batch(f"{root}/events", np.array(times), lines)


def _arrows(entity: str, time: Array, at: Array, way: Array) -> Batch:
    return Batch(entity, time, rr.Arrows3D.columns(origins=at, vectors=way))


def fingerprint(x: Array, y: Array) -> int:
    """Tells one record from another, by the measured ball, shape (K,) each."""
    return crc32(np.ascontiguousarray(np.stack((x, y)), dtype=float).tobytes())


GHOST = (204, 121, 167, 150)
"""Colour of the twin's ball, half transparent."""
TWIN_WORDS = {
    "twin_score": f"replay error over predicted spread {WORDS[VERMILION]}, "
    f"1 as predicted {WORDS[BLACK]}",
    "twin_error_mm": f"distance of the ball from its twin {WORDS[GREY]}, 95 % band {WORDS[PINK]}",
}
"""Group of the plots of the twin, and which line has which colour."""

TWIN_RANGES = {"twin_score": (-0.4, 12.0), "twin_error_mm": (-0.4, 12.0)}
"""What their axes show: where a ball may or may not stop, its band is as wide as the plate."""


class Scores(NamedTuple):
    """What is drawn of replays.

    Attributes:
        time: When each ended, s, shape (W,).
        score: Error over predicted spread, shape (W,).
        distance: Error in mm, shape (W,).
        band: How far the 95 % band reaches in its direction, mm, shape (W,).
        ball_time: When the twin's ball was where, s, shape (K,).
        ball: There, m, shape (K, 2).
    """

    time: Array
    score: Array
    distance: Array
    band: Array
    ball_time: Array
    ball: Array

    @classmethod
    def of(
        cls, told: Mask, begin: Array, end: Array, values: Sequence[Array], path: Array, step: float
    ) -> Scores:
        """Those of replays.

        Args:
            told: Which tell anything, shape (W,).
            begin: Of each, s, shape (W,).
            end: Of each, s, shape (W,).
            values: Score, and error and band in m, shape (W,) each.
            path: Where the twin's ball is from the begin on, m, shape (W, N, 2).
            step: Seconds from one place to the next.
        """
        score, distance, band = (each[told] for each in values)
        times = begin[:, None] + step * np.arange(path.shape[1])
        errors = score, 1000 * distance, 1000 * band
        return cls(end[told], *errors, times.ravel(), path.reshape(-1, 2))


class TwinStream:
    """The twin of one run, drawn among the run's entities.

    Args:
        name: The run's name, the root of its entities.
        scenario: What is run.
    """

    def __init__(self, name: str, scenario: Scenario) -> None:
        self.root = f"/{rr.escape_entity_path_part(name)}"
        model = load_model(parts=changed(Parts, scenario))
        self._scene = Scene(model, f"{self.root}/mechanism")
        self._ball = f"{self._scene.plate}/twin_ball"

    def fixed(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """What does not change: the ghost's shape, and the looks of the lines."""
        radius = self._scene.radius
        solid = rr.components.FillMode.Solid
        yield (
            f"{self._ball}/ball",
            rr.Ellipsoids3D(half_sizes=[3 * [radius]], colors=[GHOST], fill_mode=solid),
        )
        yield (
            f"{self.root}/plate_mm/twin",
            rr.Points2D.from_fields(colors=[GHOST], radii=[9.0]),
        )
        for entity, colour, width, called, points in (
            ("twin_score/score", VERMILION, 4.0, "score", True),
            ("twin_error_mm/distance", GREY, 4.0, "distance", True),
            ("twin_score/as_predicted", BLACK, 1.2, "as predicted", False),
            ("twin_error_mm/band", PINK, 1.2, "95 % band", False),
        ):
            yield f"{self.root}/{entity}", _look(colour, width, called, points=points)

    def batches(
        self, scores: Scores | None, events: Sequence[tuple[float, str]]
    ) -> Iterator[Batch]:
        """What is new, as columns for the viewer.

        Args:
            scores: Of replays.
            events: Time in s and text of what happened.
        """
        if scores is not None and len(scores.time):
            for entity, values in (
                ("twin_score/score", scores.score),
                ("twin_score/as_predicted", np.ones(len(scores.time))),
                ("twin_error_mm/distance", scores.distance),
                ("twin_error_mm/band", scores.band),
            ):
                yield Batch(
                    f"{self.root}/{entity}", scores.time, rr.Scalars.columns(scalars=values)
                )
        if scores is not None and len(scores.ball_time):
            high = np.full(len(scores.ball), self._scene.surface + self._scene.radius)
            place = np.column_stack((scores.ball, high))
            yield Batch(self._ball, scores.ball_time, rr.Transform3D.columns(translation=place))
            yield Batch(
                f"{self.root}/plate_mm/twin",
                scores.ball_time,
                rr.Points2D.columns(positions=in_view(scores.ball)),
            )
        yield from _told(self.root, events, "WARN")


COLUMNS = ("time", "told", "score", "distance", "band", "twin_x", "twin_y")


class Saved(NamedTuple):
    """Scores as they are drawn, and time in s and text of every alarm."""

    scores: Scores
    events: list[tuple[float, str]]


def saved_twin(run: Run) -> Saved | None:
    """What was said of this very record; None if nothing was, or only of another one before it.

    Raises:
        RecordError: If a file is damaged.
    """
    folder = run.folder
    if folder is None or not (folder / "shadow.parquet").is_file():
        return None
    try:
        table = pq.read_table(folder / "shadow.parquet")
        about = json.loads(table.schema.metadata[b"ballplate"])
        measured = run.rows["measured_x"], run.rows["measured_y"]
        if about.get("record") != fingerprint(*measured):
            return None
        scores = _scores({name: table[name].to_pylist() for name in COLUMNS}, about)
        alarms = json.loads((folder / "shadow.json").read_text(encoding="utf-8"))["alarms"]
        events = [(float(each["time"]), f"alarm at {each['words']}") for each in alarms]
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise RecordError(
            f"{folder}/shadow.parquet: not what `ballplate shadow` writes ({error}); run it again"
        ) from error
    return Saved(scores, events)


def _scores(columns: dict[str, list[Any]], about: dict[str, Any]) -> Scores:
    told = np.array(columns["told"]) > 0
    end, *values = (
        np.array(columns[name], dtype=float) for name in ("time", "score", "distance", "band")
    )
    path = np.stack([np.array(columns[name], dtype=float) for name in ("twin_x", "twin_y")], -1)
    begin, step = end - float(about["horizon"]), float(about["step"])
    return Scores.of(told, begin, end, values, path, step)
