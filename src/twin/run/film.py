"""A run as a moving picture: the ball on the plate, the plate's tilt, and the error over time.

Drawn by matplotlib without a screen; the same run gives the same bytes each time. Only
``render="mujoco"`` shows the mechanism in 3D, by MuJoCo's own renderer, which needs EGL or OSMesa.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from textwrap import shorten
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator
from PIL import Image

from controllers.arrays import Array
from twin.base.errors import RecordError
from twin.base.writing import write_whole
from twin.hal.interface import SCREEN_SIZE_M
from twin.run.finished import Run
from twin.run.indicators import LOST_ENDINGS
from twin.run.picture import RC_PARAMETERS, RUN_COLOURS, literal

DESIGN_WIDTH = 600
"""Width in which all lengths below are given; pictures of other sizes are in proportion."""
FILM_PANEL_PLACES = {
    "plate": (16, 194, 498, 281),
    "front": (16, 124, 498, 60),
    "right": (524, 194, 60, 281),
    "error": (40, 26, 544, 72),
}
"""Left, bottom, width and height of each panel."""
LEGEND_LEFT, LEGEND_ROW_HEIGHT, LEGEND_TITLE_HEIGHT = 478, 40, 48
"""Where the legend begins, height of each of its rows, and of the title above it."""
CARD, DARK, NEUTRAL_GREY, PATH, FAINT = "#f0f3f6", "#1f2933", "#5b6772", "#bac3cb", "#d5dbe1"
UNIT_CIRCLE = np.array([(math.cos(0.2 * k), math.sin(0.2 * k)) for k in range(33)]).T
"""A circle of radius 1."""
RING_RADII = (1.0, 0.74, 0.5, 0.87, 0.62)
"""Radii of the further runs' rings as shares of that: of balls in one place all are seen."""
TRAIL_FRAMES, TRAIL_TONES = 36, 6
"""Frames that a trail is long, tones in which it fades."""
MAX_TILT_FACTOR = 50
"""How many times as steep as it is the tilt may be drawn."""
MOST_FRAMES = 2000
OPTION_RANGES = {"fps": (1, 50), "size": (300, 1200), "seconds": (0.001, 3600)}
RENDERERS = ("plate", "mujoco")


@dataclass(frozen=True, kw_only=True)
class Cut:
    """The part of a run that a moving picture shows, its size and rate.

    Attributes:
        fps: Frames a second.
        since: Time of the run at which it begins, s; None for the first.
        until: Time at which it ends, s; None for the last of the longest run.
        seconds: How long the picture lasts, s; None for the duration of the shown time.
        size: Its width in pixels.
        render: ``plate``: from above; ``mujoco``: of the first run the mechanism in 3D instead.
        name_of: Gives the name of one of these in messages.

    Raises:
        RecordError: If one of them is out of range.
    """

    fps: int = 20
    since: float | None = None
    until: float | None = None
    seconds: float | None = None
    size: int = DESIGN_WIDTH
    render: str = "plate"
    name_of: Callable[[str], str] = str

    def __post_init__(self) -> None:
        """Refuse what no picture can be."""
        if self.render not in RENDERERS:
            allowed = " or ".join(RENDERERS)
            raise RecordError(f"{self.name_of('render')} {self.render}: must be {allowed}")
        for name, (least, most) in OPTION_RANGES.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise RecordError(
                    f"{self.name_of(name)} {value:g}: must be from {least:g} to {most:g}"
                )

    def times(self, begin: float, end: float) -> Array:
        """The instants of the frames of runs between two times, all in s.

        Raises:
            RecordError: If the runs have no such part, or it has too many frames.
        """
        since = begin if self.since is None else self.since
        until = end if self.until is None else self.until
        if not begin <= since <= until <= end + 1 / self.fps:
            part = f"{self.name_of('since')} {since:g}, {self.name_of('until')} {until:g} s"
            raise RecordError(f"{part}: must be within {begin:g} to {end:g} s of the run")
        lasts = until - since if self.seconds is None else self.seconds
        number = max(1, round(lasts * self.fps))
        if number > MOST_FRAMES:
            raise RecordError(
                f"{number} frames: at most {MOST_FRAMES}; show a part, or all in fewer seconds"
            )
        return np.linspace(since, min(until, end), number)


class Act:
    """Motion of a run in the frames.

    Args:
        run: The run.
        times: The instants of the frames in s, shape (N,).

    Attributes:
        way: Ball in m, after what the first frame's trail needs, shape (2, TRAIL + N); NaN where
            the run has ended or nothing is known.
        ball: The same of the frames, shape (N, 2).
        goal: Its reference in m, shape (N, 2).
        tilt: Plate angles phi, theta in rad, shape (N, 2).
        error: Distance from the reference in mm, shape (N,).
        lost: Where the ball was last seen, from when on it has left the plate, in m, shape (N, 2).
    """

    def __init__(self, run: Run, times: Array) -> None:
        motion = run.motion
        step = (times[-1] - times[0]) / max(1, len(times) - 1)
        when = np.concatenate((times[0] - step * np.arange(TRAIL_FRAMES, 0, -1), times))
        over = when > motion.time[-1] + 1e-9  # its last instant is a frame, whatever the rounding

        def at(values: Array) -> Array:
            each = [np.interp(when, motion.time, axis, left=np.nan) for axis in values.T]
            return np.where(over, np.nan, each)

        self.way = at(motion.ball)
        self.ball, self.goal, self.tilt = (
            each[:, TRAIL_FRAMES:].T for each in (self.way, at(motion.reference), at(motion.plate))
        )
        self.error = 1000 * np.hypot(*(self.goal - self.ball).T)
        self.lost = np.full_like(self.ball, np.nan)
        seen = motion.ball[np.isfinite(motion.ball).all(axis=1)]
        if run.outcome in LOST_ENDINGS and len(seen):
            self.lost[over[TRAIL_FRAMES:]] = run.scenario.dimensions.within(seen[-1], 0.013)


class Stage:
    """The mechanism of a run in 3D, drawn by MuJoCo's renderer.

    Args:
        run: The run.
        size: Width and height in pixels.

    Raises:
        RecordError: If there is neither EGL nor OSMesa.
    """

    CAMERA = {"azimuth": 112.0, "elevation": -26.0, "distance": 1.0, "lookat": (0.0, 0.0, -0.02)}  # noqa: RUF012
    CLEAR = (0.73, 0.76, 0.80, 1.0)
    """Colour of the reference's path."""
    PATH_LIFT_M = 0.0012
    """Height of the path above the plate's surface, in which it would be hidden, m."""
    SHADOW_MAP_SIZE = 1024
    """Width in pixels of the map of shadows; a renderer without a GPU fills all of it."""

    def __init__(self, run: Run, size: tuple[int, int]) -> None:
        import mujoco  # noqa: PLC0415  heavy, as are the others: a picture from above needs none

        from twin.hal.cams import CamTable  # noqa: PLC0415
        from twin.run.plants import drawn_mechanism, parts_of  # noqa: PLC0415
        from twin.sim.plant.mechanism import Addresses  # noqa: PLC0415

        self._gl = mujoco
        self._cams = parts_of(run.scenario).linkage or CamTable.packaged()
        self._model = drawn_mechanism(run.scenario)
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = size
        self._data, self._at = mujoco.MjData(self._model), Addresses.of(self._model)
        self._model.vis.quality.shadowsize = self.SHADOW_MAP_SIZE
        self._path_width = 2.0 * size[0] / FILM_PANEL_PLACES["plate"][2]
        self._renderer = _offscreen(self._model, size)
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(self._model, self._camera)
        for name, value in self.CAMERA.items():
            setattr(self._camera, name, value)
        self._camera.distance *= max(np.divide(run.scenario.plant.size, SCREEN_SIZE_M))
        mujoco.mj_resetDataKeyframe(self._model, self._data, self._at.level)
        self._height = float(self._data.qpos[self._at.ball_pose][2])

    def drawn(self, ball: Array, tilt: Array, path: Array) -> Image.Image:
        """One instant.

        Args:
            ball: Its place in plate axes, m, shape (2,); NaN leaves it out of sight.
            tilt: Plate angles phi, theta in rad, shape (2,).
            path: The reference in plate axes, m, shape (N, 2).
        """
        from twin.sim.plant.interface import from_plate  # noqa: PLC0415

        gl, data, at = self._gl, self._data, self._at

        def placed(points: Array, height: float) -> Array:
            lifted = np.column_stack((points, np.full(len(points), height)))
            return from_plate(lifted, *tilt)

        data.qpos[at.poses[:2]], data.qpos[at.shaft] = tilt, self._cams.motor(tilt)
        (centre,) = placed(ball[None], self._height)
        data.qpos[at.ball_pose] = np.where(np.isfinite(centre), centre, 9.0)
        gl.mj_forward(self._model, data)
        self._renderer.update_scene(data, self._camera)
        scene = self._renderer.scene
        surface = self._height - self._model.geom("ball").size[0]
        corners = path[:: max(1, len(path) // 200)]
        for one, other in pairwise(placed(corners, surface + self.PATH_LIFT_M)):
            if np.isfinite((one, other)).all():
                geom = scene.geoms[scene.ngeom]
                kind = gl.mjtGeom.mjGEOM_LINE  # hundreds of solids would take most of the time
                gl.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), self.CLEAR)
                gl.mjv_connector(geom, kind, self._path_width, one, other)
                scene.ngeom += 1
        return Image.fromarray(self._renderer.render())


def _offscreen(model: Any, size: tuple[int, int]) -> Any:
    """A renderer that needs no screen.

    Raises:
        RecordError: If there is neither EGL nor OSMesa.
    """
    from mujoco.rendering.classic import gl_context, renderer  # noqa: PLC0415

    why = []
    for name in ("egl", "osmesa"):
        try:  # in place of MUJOCO_GL as it was when mujoco was imported
            gl_context.GLContext = import_module(f"mujoco.{name}").GLContext
            return renderer.Renderer(model, size[1], size[0])
        except Exception as error:  # noqa: BLE001  whatever a missing driver raises
            why.append(f"{name}: {' '.join(str(error).split()) or type(error).__name__}")
    raise RecordError(
        f"render mujoco: needs EGL or OSMesa (libegl1 or libosmesa6) ({'; '.join(why)}); "
        "without them the picture from above is drawn"
    )


class Film:
    """Draws the frames of runs, one after the other.

    Args:
        runs: The run in the foreground by its label, then further ones; at most one per colour.
        cut: Which part, and how.

    Attributes:
        times: The instants of the frames in s, shape (N,).
        count: How many frames there are.
        size: Width and height in pixels.

    Raises:
        RecordError: If there is no such part, or there are too many runs.
    """

    def __init__(self, runs: Mapping[str, Run], cut: Cut) -> None:
        if len(runs) > len(RUN_COLOURS):
            raise RecordError(f"{len(runs)} runs: at most {len(RUN_COLOURS)} can be distinguished")
        spans = [run.motion.time[[0, -1]].tolist() for run in runs.values()]
        self.times = cut.times(min(first for first, _ in spans), max(last for _, last in spans))
        self.count, self.fps = len(self.times), cut.fps
        self._acts = [Act(run, self.times) for run in runs.values()]
        first = next(iter(runs.values())).scenario.dimensions
        self._screen, self._ball, self._round = np.array(first.screen), first.ball, first.round
        room = self._screen / FILM_PANEL_PLACES["plate"][2:]
        self._shown = self._screen * np.maximum(1, np.round(room[::-1] / room, 2))
        """What the panel shows, m: as wide and high as the plate where that has its shape."""
        self._columns = len(runs) if len(runs) < 5 else 3
        high = (
            LEGEND_LEFT
            + LEGEND_ROW_HEIGHT * math.ceil(len(runs) / self._columns)
            + LEGEND_TITLE_HEIGHT
        )
        self._whole = np.array((DESIGN_WIDTH, high))
        self._moving: list[tuple[Line2D, Callable[[int], Array]]] = []
        with mpl.rc_context(RC_PARAMETERS):
            dpi = (cut.size + 1e-3) / DESIGN_WIDTH * 100
            self._figure = Figure((DESIGN_WIDTH / 100, high / 100), dpi, facecolor=CARD)
            self._canvas: Any = FigureCanvasAgg(self._figure)
            self._panels = {
                name: self._figure.add_axes((*each[:2] / self._whole, *each[2:] / self._whole))
                for name, each in FILM_PANEL_PLACES.items()
            }
            self._lay_out()
            self._letter(runs, [self._add(*each) for each in enumerate(self._acts)])
        self.size: tuple[int, int] = self._canvas.get_width_height()
        self._moving.sort(key=lambda each: each[0].zorder)
        self._stage = None
        if cut.render == "mujoco":
            left, low, right, top = (round(edge) for edge in self._panels["plate"].bbox.extents)
            self._stage = Stage(next(iter(runs.values())), (right - left, top - low))
            self._corner = left, self.size[1] - top

    def _lay_out(self) -> None:
        """Say what each panel shows, and draw what no run changes."""
        (x, y), panels = self._shown / 2, self._panels
        thick = x * FILM_PANEL_PLACES["front"][3] / FILM_PANEL_PLACES["front"][2]
        edges = {"plate": (x, y), "front": (x, thick), "right": (thick, y)}
        for name, (width, height) in edges.items():
            panels[name].set(xlim=(-width, width), ylim=(-height, height), xticks=[], yticks=[])
            panels[name].spines[:].set(
                color=NEUTRAL_GREY if name == "plate" else FAINT, linewidth=0.7
            )
        panels["plate"].plot(0, 0, "+", color=FAINT, ms=18)
        if self._round or (self._shown > self._screen).any():
            turn = np.linspace(0, 2 * np.pi, 181)
            corners = np.array([(1, 1, -1, -1, 1), (1, -1, -1, 1, 1)])
            corners = np.array((np.cos(turn), np.sin(turn))) if self._round else corners
            panels["plate"].plot(
                *(self._screen[:, None] / 2 * corners), color=NEUTRAL_GREY, linewidth=0.7
            )
        panels["front"].axhline(0, color=FAINT, linewidth=1)
        panels["right"].axvline(0, color=FAINT, linewidth=1)
        error, span = panels["error"], self.times[-1] - self.times[0]
        error.set(xlim=(self.times[0], self.times[0] + max(span, 1e-3)), axisbelow=True)
        error.spines[:].set_visible(False)
        error.xaxis.set_major_locator(MaxNLocator(8))
        error.yaxis.set_major_locator(MaxNLocator(3))
        error.tick_params(labelsize=7, labelcolor=NEUTRAL_GREY, length=0, pad=2)
        tilts = np.abs(self._acts[0].tilt)
        steepest = float(tilts[np.isfinite(tilts)].max(initial=1e-3))
        self._steep = min(MAX_TILT_FACTOR, max(1, int(math.asin(0.73 * thick / x) / steepest)))

    def _add(self, index: int, act: Act) -> Line2D:
        """Add a run to what stays and to what moves; returns its entry of the legend."""
        colour, width = RUN_COLOURS[index], (1.0, 0.62, 0.4)[min(2, index)]
        path = _pale(colour, 0.5) if index else PATH
        self._panels["plate"].plot(*act.goal.T, color=path, linewidth=1.1, zorder=2 - index / 10)
        self._panels["error"].plot(self.times, act.error, color=_pale(colour, 0.72), linewidth=1)
        part = TRAIL_FRAMES // TRAIL_TONES
        for tone in range(TRAIL_TONES):
            old = 1 - (tone + 1) / TRAIL_TONES
            at = partial(_part, act.way, tone * part, (tone + 1) * part + 1)
            thick, pale = 3.4 * width * (1 - 0.6 * old), _pale(colour, 0.15 + 0.85 * old)
            self._moves("plate", at, color=pale, linewidth=thick, zorder=4 - old)
        entry = Line2D([], [], color=colour, marker="o", linestyle="", ms=10)
        if index:  # a ring, not a marker: those jump from pixel to pixel
            radius, thick = RING_RADII[index - 1] * self._ball, 2.0 if len(self._acts) < 5 else 1.3
            entry.set(mfc="none", mew=1.8, ms=12 * RING_RADII[index - 1])
        else:  # a disc
            radius = self._ball / 2
            thick = self._ball / self._shown[0] * FILM_PANEL_PLACES["plate"][2] * 0.72
            rod = np.stack((act.goal, act.ball), axis=2)
            self._moves("plate", rod.__getitem__, color=colour, linewidth=1, zorder=4.5)
        look = {"color": colour, "linewidth": thick, "zorder": 5 + index / 10}
        self._moves("plate", lambda k: act.ball[k, :, None] + radius * UNIT_CIRCLE, **look)
        lost = {"marker": "X", "ms": 11, "mew": 0}
        self._moves("plate", act.lost[..., None].__getitem__, color=colour, zorder=5, **lost)
        for long, thick, ink in ((9.5, 3.2, "white"), (8.6, 1.4, DARK)):
            look = {"marker": "+", "ms": long, "mew": thick, "color": ink}
            self._moves("plate", act.goal[..., None].__getitem__, zorder=6, **look)
        for side, name in enumerate(("front", "right")):
            half, tilt = 0.475 * self._screen[side], self._steep * act.tilt[:, side, None]
            plate = _profile(side, np.array((-half, half)), 0.0, tilt)
            self._moves(name, plate.__getitem__, color=colour, linewidth=2.9 * width)
            if not index:
                above = _profile(side, act.ball[:, side, None], 0.0125, tilt)
                self._moves(name, above.__getitem__, color=colour, marker="o", ms=8)
        curve = np.stack((self.times, act.error))
        self._moves("error", lambda k: curve[:, : k + 1], color=colour, linewidth=1.4)
        dot = {"marker": "o", "ms": 5 * width, "color": colour, "clip_on": False}
        self._moves("error", lambda k: curve[:, k : k + 1], **dot)
        return entry

    def _moves(self, panel: str, at: Callable[[int], Array], **look: Any) -> None:
        """Let a line go through the points, shape (2, P), that a function has of each frame."""
        (line,) = self._panels[panel].plot([], [], animated=True, solid_capstyle="round", **look)
        self._moving.append((line, at))

    def _letter(self, runs: Mapping[str, Run], entries: list[Line2D]) -> None:
        """Write what stays, and make room for the time."""
        self._panels["error"].set(ylim=(0, 1.05 * max(0.1, self._panels["error"].dataLim.y1)))
        self._figure.legend(
            entries,
            [_legend_entry(label, run) for label, run in runs.items()],
            labelcolor=[str(entry.get_color()) for entry in entries],
            loc="lower left",
            bbox_to_anchor=(8, LEGEND_LEFT) / self._whole,
            ncols=self._columns,
            frameon=False,
        )
        first, high = next(iter(runs.values())), self._whole[1] - 30
        title = shorten(first.scenario.title, 48, placeholder=" …")
        self._write(16, high, title, 11, DARK, fontweight="bold")
        self._clock = self._write(DESIGN_WIDTH - 16, high, "", 12, DARK, ha="right", animated=True)
        self._clock.set(fontweight="bold")
        fast = (self.times[-1] - self.times[0]) * self.fps / self.count
        if abs(fast - 1) > 0.02 and self.count > 1:
            self._write(DESIGN_WIDTH - 90, high, f"{fast:.2g}× speed", 8, NEUTRAL_GREY, ha="right")
        self._write(554, 146, f"tilt\n× {self._steep}", 8, NEUTRAL_GREY, ha="center")
        self._write(16, 104, "distance from the reference (+) [mm] over time [s]", 8, NEUTRAL_GREY)

    def _write(self, x: float, y: float, text: str, size: int, colour: str, **more: Any) -> Text:
        x, y = (x, y) / self._whole
        return self._figure.text(x, y, literal(text), fontsize=size, color=colour, **more)

    def frames(self) -> Iterator[Image.Image]:
        """The frames in their order, with one palette of at most 256 colours."""
        with mpl.rc_context(RC_PARAMETERS):
            self._canvas.draw()
        still, pen = self._canvas.copy_from_bbox(self._figure.bbox), self._canvas.get_renderer()
        palette = _palette(RUN_COLOURS[: len(self._acts)])
        for k, time in enumerate(self.times):
            self._canvas.restore_region(still)
            for line, at in self._moving:
                line.set_data(*at(k))
                line.draw(pen)
            self._clock.set_text(f"{time:.1f} s")
            self._clock.draw(pen)
            frame = Image.fromarray(np.asarray(self._canvas.buffer_rgba())).convert("RGB")
            if self._stage is not None:
                main = self._acts[0]
                frame.paste(self._stage.drawn(main.ball[k], main.tilt[k], main.goal), self._corner)
                if k == 0:
                    palette = frame.quantize(256, Image.Quantize.FASTOCTREE)
            yield frame.quantize(palette=palette, dither=Image.Dither.NONE)


def _part(points: Array, begin: int, end: int, k: int) -> Array:
    """The points of a frame's part of a trail, shape (2, end - begin)."""
    return points[:, k + begin : k + end]


def _profile(side: int, along: Array, above: float, tilt: Array) -> Array:
    """Points of a view of the plate from one side in m, shape (N, 2, P).

    Args:
        side: 0 from the front, below the plate; 1 from the right, next to it.
        along: Where on the plate, along x or y in m, shape (P,) or (N, P).
        above: How far above it in m, as drawn.
        tilt: Plate angle phi or theta in rad, shape (N, 1); the first lowers the right end, the
            second raises the far one. Outwards is downwards in both views.
    """
    up = -above if side else above
    cos, sin = np.cos(tilt), np.sin(tilt)
    points = along * cos + up * sin, up * cos - along * sin
    return np.stack(points[::-1] if side else points, axis=1)


def _pale(colour: str, share: float) -> Any:
    """A colour with a share of white."""
    return tuple(share + (1 - share) * part for part in to_rgb(colour))


def _palette(own: tuple[str, ...]) -> Image.Image:
    """The colours of the runs and of what is written, in tones: one palette keeps a picture small.

    Its tones towards both grounds are those of edges.
    """
    inks = np.array([to_rgb(ink) for ink in (*own, DARK, NEUTRAL_GREY, PATH, FAINT)])
    grounds = np.array([to_rgb(ground) for ground in ("white", CARD)])
    share = np.linspace(0, 1, 254 // (2 * len(inks)), endpoint=False)[:, None, None, None]
    tones = np.reshape(share * grounds[:, None] + (1 - share) * inks, (-1, 3))
    # what is nearly one of the grounds would be taken for it, all over the picture
    apart = (np.linalg.norm(tones[:, None] - grounds, axis=-1) > 0.04).all(axis=1)
    found = Image.new("P", (1, 1))
    found.putpalette(np.rint(255 * np.vstack((tones[apart], grounds))).astype(int).ravel().tolist())
    return found


def _legend_entry(label: str, run: Run) -> str:
    """A run's entry in the legend: its error, its label, and its law."""
    percent, law = run.metrics.get("tracking_error_percent"), run.scenario.controller.kind
    distance = run.metrics.get("rms_distance")
    score = run.outcome
    if score not in LOST_ENDINGS and percent is not None:
        score = f"{percent:.3g} % error"
    elif score not in LOST_ENDINGS and distance is not None:
        score = f"{1000 * distance:.3g} mm RMS"
    return f"{score}\n{label if label == law else f'{label}, {law}'}"


WRITER_OPTIONS: dict[str, dict[str, Any]] = {
    # key frames only where they are needed: each is as large as many others
    ".webp": {"lossless": True, "quality": 20, "method": 2, "kmin": 9999, "kmax": 10000},
    ".gif": {},
}
"""How Pillow writes each kind of moving picture; PyAV writes ``.mp4``."""


def moving(path: Path, film: Film, progress: Callable[[float], None] = lambda _: None) -> None:
    """Write a moving picture; the same runs give the same bytes.

    Args:
        path: ``.webp``, ``.gif`` or ``.mp4`` (by the extra ``video``).
        film: Its frames.
        progress: Receives the number of drawn frames.

    Raises:
        RecordError: If nothing can be written there.
    """

    def frames() -> Iterator[Image.Image]:
        for number, frame in enumerate(film.frames(), 1):
            progress(number)
            yield frame

    def write(target: Path) -> None:
        if path.suffix == ".mp4":
            return _video(target, film, frames())
        first, *others = frames()
        # in whole ms, of a .gif in 10 ms, that add up without drifting
        unit = 10 if path.suffix == ".gif" else 1
        ends = [round(1000 * k / (unit * film.fps)) * unit for k in range(film.count + 1)]
        lasting = [end - begin for begin, end in pairwise(ends)]
        how = {
            "append_images": others,
            "duration": lasting,
            "loop": 0,
            **WRITER_OPTIONS[path.suffix],
        }
        return first.save(target, path.suffix[1:].upper(), save_all=True, **how)

    write_whole(path, write)


def _video(target: Path, film: Film, frames: Iterator[Image.Image]) -> None:
    """Write frames as H.264, which takes an even number of pixels along x and y."""
    try:
        import av  # noqa: PLC0415  an extra
    except ImportError as error:
        raise RecordError(".mp4: needs the extra video: pip install 'ballplate[video]'") from error
    wide, high = (side - side % 2 for side in film.size)
    with av.open(str(target), "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=film.fps)
        stream.options = {"x264-params": "mbtree=0"}  # which gives other bytes now and then
        stream.width, stream.height, stream.pix_fmt = wide, high, "yuv420p"
        for frame in frames:
            image = frame.convert("RGB").crop((0, 0, wide, high))
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(image))))
        file.mux(stream.encode(None))
