"""A run as a moving picture: the ball on the plate, the plate's tilt, and the error over time.

Drawn in software, with the fonts that matplotlib brings: no screen and no OpenGL are needed, and
the same run gives the same bytes each time. Only ``render="mujoco"`` shows the mechanism in 3D, by
MuJoCo's own renderer, which needs EGL or OSMesa.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageColor

from controllers.arrays import Array
from twin.errors import RecordError
from twin.hal.interface import SCREEN
from twin.run import ink
from twin.run.finished import Run
from twin.run.indicators import LEFT
from twin.run.picture import COLOURS
from twin.writing import write_folder, write_whole

WIDE = 600
"""Width in which all lengths below are given; pictures of other sizes are in proportion."""
EDGE, GAP = 16, 10
CLOCK = (WIDE - EDGE, EDGE + 16)
"""Where the time ends; the title stands at its height."""
TITLE, ENTRY, LINE = 30, 40, 16
"""Heights of the title, of a row of the legend, and of a line of small text."""
PLATE, SIDE, STRIP = 498, 60, 72
"""Width of the plate and of the views of its tilt, height of the error strip."""
BALL = 0.02
"""Radius of the ball in m, as drawn."""
RINGS = (1.0, 0.74, 0.5, 0.87, 0.62)
"""Radii of the further runs' rings as shares of that: of balls in one place all are seen."""
TRAIL, TONES = 36, 9
"""Frames that a trail is long, tones in which it fades."""
FACTORS = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 60)
"""How many times as steep as it is the tilt may be drawn."""
MOST_FRAMES, MOST_FPS = 2000, 50
SIZES = (300, 1200)
RENDERERS = ("plate", "mujoco")

HALF = 0.475 * np.array(SCREEN)[:, None] * (-1, 1)
"""The plate's ends as its views draw it, along x and y in m."""
LEVELS = (0.0, 0.5, 1.0)
CROSS = np.array((((-1.0, 0.0), (1.0, 0.0)), ((0.0, -1.0), (0.0, 1.0))))
SALTIRE = np.array((((-1.0, -1.0), (1.0, 1.0)), ((-1.0, 1.0), (1.0, -1.0))))


@dataclass(frozen=True, kw_only=True)
class Cut:
    """Which part of a run a moving picture shows, and how.

    Attributes:
        fps: Frames a second.
        since: Time of the run at which it begins, s; None for the first.
        until: Time at which it ends, s; None for the last of the longest run.
        seconds: How long the picture lasts, s; None for as long as what it shows.
        size: Its width in pixels.
        render: ``plate``: from above; ``mujoco``: of the first run the mechanism in 3D instead.

    Raises:
        RecordError: If one of them is out of range.
    """

    fps: int = 20
    since: float | None = None
    until: float | None = None
    seconds: float | None = None
    size: int = WIDE
    render: str = "plate"

    def __post_init__(self) -> None:
        """Refuse what no picture can be."""
        if self.render not in RENDERERS:
            raise RecordError(f"render {self.render}: must be {' or '.join(RENDERERS)}")
        for name, value, (least, most) in (
            ("fps", self.fps, (1, MOST_FPS)),
            ("size", self.size, SIZES),
            ("seconds", 1.0 if self.seconds is None else self.seconds, (0.001, 3600)),
        ):
            if not least <= value <= most:
                raise RecordError(f"{name} {value:g}: must be from {least:g} to {most:g}")

    def times(self, begin: float, end: float) -> Array:
        """The instants of the frames of runs between two times, all in s.

        Raises:
            RecordError: If the runs have no such part, or it has too many frames.
        """
        since = begin if self.since is None else self.since
        until = end if self.until is None else self.until
        if not begin <= since <= until <= end + 1 / self.fps:
            raise RecordError(
                f"from {since:g} to {until:g} s: must be within {begin:g} to {end:g} s of the run"
            )
        lasts = until - since if self.seconds is None else self.seconds
        number = max(1, round(lasts * self.fps))
        if number > MOST_FRAMES:
            raise RecordError(
                f"{number} frames: at most {MOST_FRAMES}; show a part, or all in fewer seconds"
            )
        return np.linspace(since, min(until, end), number)


class Actor:
    """One of the runs, at the instants of the frames.

    Args:
        index: Which of the runs, from 0.
        label: What it is called.
        run: The run.
        times: The instants in s, shape (N,).

    Attributes:
        colour: Its colour in all pictures.
        ball: Ball in m, shape (N, 2); NaN where it has ended or nothing is known.
        goal: Its reference in m, shape (N, 2).
        tilt: Plate angles phi, theta in rad, shape (N, 2).
        error: Distance from the reference in mm, shape (N,).
        way: The same after what the first frame's trail needs, shape (TRAIL + N, 2).
        gone: Where the ball was last seen if it left the plate, in m, and when, in s.
    """

    def __init__(self, index: int, label: str, run: Run, times: Array) -> None:
        self.label, self.run = label, run
        self.colour = ink.mix(ink.BLACK, ImageColor.getrgb(COLOURS[index])[:3], 1)
        motion = run.motion
        step = (times[-1] - times[0]) / max(1, len(times) - 1)
        before = times[0] - step * np.arange(TRAIL, 0, -1)
        # the last instant of a run is one of the frames, whatever their rounding
        last = motion.time[-1] + 1e-9

        def at(values: Array, when: Array) -> Array:
            right = [
                np.where(when > last, np.nan, np.interp(when, motion.time, each, left=np.nan))
                for each in values.T
            ]
            return np.stack(right, axis=1)

        self.way = at(motion.ball, np.concatenate((before, times)))
        self.ball = self.way[TRAIL:]
        self.goal, self.tilt = at(motion.reference, times), at(motion.plate, times)
        self.error = 1000 * np.hypot(*(self.goal - self.ball).T)
        left = run.outcome in LEFT
        seen = motion.ball[np.isfinite(motion.ball).all(axis=1)]
        self.gone = (seen[-1], float(motion.time[-1])) if left and len(seen) else None

    @property
    def score(self) -> tuple[str, str]:
        """Its error as a number, and which error it is."""
        metrics = self.run.metrics
        if self.run.outcome in LEFT:
            return self.run.outcome, ""
        if (percent := metrics.get("tracking_error_percent")) is not None:
            return f"{percent:.3g} %", "error"
        if (distance := metrics.get("rms_distance")) is not None:
            return f"{1000 * distance:.3g} mm", "RMS"
        return self.run.outcome, ""


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

    def __init__(self, run: Run, size: tuple[int, int]) -> None:
        import mujoco  # noqa: PLC0415  heavy, as are the others: a picture from above needs none

        from twin.hal.cams import CamTable  # noqa: PLC0415
        from twin.settings import changed  # noqa: PLC0415
        from twin.sim.plant.mechanism import Addresses  # noqa: PLC0415
        from twin.sim.plant.model import load_model  # noqa: PLC0415
        from twin.sim.plant.parts import Parts  # noqa: PLC0415

        self._gl, self._cams = mujoco, CamTable.packaged()
        self._model = load_model(parts=changed(Parts, run.scenario))
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = size
        self._data, self._at = mujoco.MjData(self._model), Addresses.of(self._model)
        self._renderer = _offscreen(self._model, size)
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(self._model, self._camera)
        for name, value in self.CAMERA.items():
            setattr(self._camera, name, value)
        mujoco.mj_resetDataKeyframe(self._model, self._data, self._at.level)
        self._height = float(self._data.qpos[self._at.ball_pose][2])

    def drawn(self, ball: Array, tilt: Array, path: Array) -> Image.Image:
        """One instant.

        Args:
            ball: Its place in plate axes, m, shape (2,); NaN leaves it out of sight.
            tilt: Plate angles phi, theta in rad, shape (2,).
            path: The reference in plate axes, m, shape (N, 2).
        """
        from twin.sim.plant.kinematics import from_plate  # noqa: PLC0415

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
        radius = self._model.geom("ball").size[0]
        for one, other in pairwise(
            placed(path[:: max(1, len(path) // 200)], self._height - radius)
        ):
            if np.isfinite((one, other)).all():
                geom = scene.geoms[scene.ngeom]
                kind = gl.mjtGeom.mjGEOM_CAPSULE
                gl.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), self.CLEAR)
                gl.mjv_connector(geom, kind, 0.0012, one, other)
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
        try:  # in place of what MUJOCO_GL said when mujoco was imported
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
        if len(runs) > len(COLOURS):
            raise RecordError(f"{len(runs)} runs: at most {len(COLOURS)} can be told apart")
        motions = [run.motion for run in runs.values()]
        begin = min(float(motion.time[0]) for motion in motions)
        self.times = cut.times(begin, max(float(motion.time[-1]) for motion in motions))
        self.count = len(self.times)
        self.fps, self._scale = cut.fps, cut.size / WIDE
        self._actors = [Actor(i, *each, self.times) for i, each in enumerate(runs.items())]
        self._title = self._actors[0].run.scenario.title
        fast = (self.times[-1] - self.times[0]) * cut.fps / self.count
        self._fast = f"{fast:.2g}× speed" if abs(fast - 1) > 0.02 and self.count > 1 else ""
        self._columns = len(runs) if len(runs) < 5 else 3
        top = EDGE + TITLE + math.ceil(len(runs) / self._columns) * ENTRY + GAP / 2
        self._entry = (WIDE - 2 * EDGE) / self._columns
        self._entries: list[ink.Point] = [
            (EDGE + i % self._columns * self._entry, EDGE + TITLE + i // self._columns * ENTRY)
            for i in range(len(runs))
        ]
        self._per_m = PLATE / SCREEN[0]
        low = top + SCREEN[1] * self._per_m
        self._plate = (EDGE, top, EDGE + PLATE, low)
        self._below = (EDGE, low + GAP, EDGE + PLATE, low + GAP + SIDE)
        self._right = (WIDE - EDGE - SIDE, top, WIDE - EDGE, low)
        strip = low + 2 * GAP + SIDE + LINE
        self._strip = (EDGE + 24, strip, WIDE - EDGE, strip + STRIP)
        self.size = (cut.size, round((strip + STRIP + LINE + GAP) * self._scale))
        errors = np.concatenate([each.error for each in self._actors])
        self._top = _above(float(errors[np.isfinite(errors)].max(initial=0.1)))
        left, top, right, bottom = self._strip
        across = np.linspace(left, right, self.count)
        self._curves = [
            np.stack((across, bottom - (bottom - top) * each.error / self._top), axis=1)
            for each in self._actors
        ]
        tilts = np.abs(self._actors[0].tilt)
        steepest = float(tilts[np.isfinite(tilts)].max(initial=1e-3))
        room = (SIDE / 2 - 8) / (PLATE / 2)
        self._steep = max([f for f in FACTORS if math.sin(min(1.5, f * steepest)) <= room] or [1])
        self._stage = None
        if cut.render == "mujoco":
            left, top, right, bottom = self._pixels(self._plate)
            self._stage = Stage(self._actors[0].run, (right - left, bottom - top))

    def _pixels(self, edges: ink.Box) -> tuple[int, int, int, int]:
        """The pixels of a part of the picture, outwards to whole ones."""
        left, top = (math.floor(edge * self._scale) for edge in edges[:2])
        right, bottom = (math.ceil(edge * self._scale) for edge in edges[2:])
        return left, top, right, bottom

    def frames(self) -> Iterator[Image.Image]:
        """The frames in their order, with one palette of less than 256 colours."""
        scale, (wide, high) = self._scale * ink.FINE, self.size
        base = Image.new("RGB", (wide * ink.FINE, high * ink.FINE), ink.CARD)
        still = ink.Pen(base, scale)
        self._set(still)
        blank, colours = base.reduce(ink.FINE), ink.palette([each.colour for each in self._actors])
        self._letter(ink.Pen(blank, self._scale))
        for k in range(self.count):
            for each, curve in zip(self._actors, self._curves, strict=True):
                still.line(curve[max(0, k - 1) : k + 1], each.colour, 2)
            frame = blank.copy()
            for edges, play in self._windows:
                left, top, right, bottom = self._pixels(edges)
                if self._stage is not None and edges is self._plate:
                    main = self._actors[0]
                    shown = self._stage.drawn(main.ball[k], main.tilt[k], main.goal)
                    frame.paste(shown, (left, top))
                    continue
                image = base.crop(
                    (ink.FINE * left, ink.FINE * top, ink.FINE * right, ink.FINE * bottom)
                )
                play(ink.Pen(image, scale, (ink.FINE * left, ink.FINE * top)), k)
                frame.paste(image.reduce(ink.FINE), (left, top))
            clock = f"{self.times[k]:.1f} s"
            ink.Pen(frame, self._scale).write(CLOCK, clock, 16, ink.DARK, "rs")
            if self._stage is not None and k == 0:
                colours = frame.quantize(256 - ink.ALPHAS, Image.Quantize.FASTOCTREE)
            yield frame.quantize(palette=colours, dither=Image.Dither.NONE)

    @property
    def _windows(self) -> list[tuple[ink.Box, Callable[[ink.Pen, int], None]]]:
        """What moves, moves within these; the rest is drawn once."""
        left, top, right, bottom = self._strip
        return [
            (self._plate, self._play_plate),
            (self._below, partial(self._play_side, 0)),
            (self._right, partial(self._play_side, 1)),
            ((left - 3, top - 4, right + 4, bottom + 4), self._play_strip),
        ]

    def at(self, ball: Array) -> Array:
        """Where positions in m, shape (..., 2), are on the picture, in lengths of ``WIDE``."""
        placed: Array = np.reshape(self._plate, (2, 2)).mean(axis=0) + self._per_m * ball * (1, -1)
        return placed

    def _profile(self, side: int, along: Array, above: float, tilt: float) -> Array:
        """Points of a view of the plate from one side, shape (K, 2).

        Args:
            side: 0 from the front, below the plate; 1 from the right, beside it.
            along: Where on the plate, along x or y in m, shape (K,).
            above: How far above it, as drawn.
            tilt: Plate angle phi or theta in rad; the first lowers the right end, the second
                raises the far one. Outwards is downwards in both views.
        """
        angle = self._steep * tilt
        cos, sin = math.cos(angle), math.sin(angle)
        u = self._per_m * along
        left, top, right, bottom = self._below if side == 0 else self._right
        x, y = (left + right) / 2, (top + bottom) / 2
        if side == 0:
            return np.stack((x + u * cos + above * sin, y + 4 + u * sin - above * cos), axis=1)
        return np.stack((x + 4 - u * sin - above * cos, y - u * cos + above * sin), axis=1)

    def _set(self, pen: ink.Pen) -> None:
        """Draw what does not move."""
        pen.box(self._plate, ink.GROUND, ink.RIM, 7)
        for ends in CROSS * 0.018:
            pen.line(self.at(ends), ink.FAINT, 1.2)
        for actor in reversed(self._actors):  # one reference of all is that of the first
            main = actor is self._actors[0]
            pen.line(
                self.at(actor.goal),
                ink.PATH if main else ink.mix(actor.colour, ink.GROUND, 0.5),
                1.6,
            )
        for side, edges in enumerate((self._below, self._right)):
            pen.box(edges, ink.GROUND, ink.FAINT, 5)
            pen.line(self._profile(side, HALF[side], 0.0, 0.0), ink.FAINT, 1.2)
        left, top, right, bottom = self._strip
        pen.box(self._strip, ink.GROUND, ink.GROUND, 0)
        for level in LEVELS:
            y = bottom - level * (bottom - top)
            pen.line(np.array(((left, y), (right, y))), ink.FAINT, 1)
        for actor, at, curve in zip(self._actors, self._entries, self._curves, strict=True):
            pen.line(curve, ink.mix(actor.colour, ink.GROUND, 0.72), 1.4)
            self._mark(pen, actor, np.array((at[0] + 11, at[1] + 16)), 9)

    def _mark(self, pen: ink.Pen, actor: Actor, at: Array, radius: float) -> None:
        """Draw a run's ball: the first one solid, of the others a ring each."""
        if actor is self._actors[0]:
            pen.disc(at, radius, ink.mix(actor.colour, ink.BLACK, 0.3))
            pen.disc(at, radius - 1.3, actor.colour)
            pen.disc(at - 0.33 * radius, 0.24 * radius, ink.mix(actor.colour, ink.GROUND, 0.6))
            return
        size, few = radius * RINGS[self._actors.index(actor) - 1], len(self._actors) < 5
        if few:
            pen.disc(at, size + 0.8, ink.GROUND, 4.4)
        pen.disc(at, size, actor.colour, 2.8 if few else 2.0)

    def _width(self, actor: Actor, widest: float) -> float:
        """How wide a run's lines are: narrower from run to run, so that one on others is seen."""
        return widest * (1.0, 0.62, 0.4)[min(2, self._actors.index(actor))]

    def _play_plate(self, pen: ink.Pen, k: int) -> None:
        """Draw balls, trails and reference of frame ``k``."""
        main = self._actors[0]
        for actor in self._actors:
            trail = self.at(actor.way[k : k + TRAIL + 1])
            length = TRAIL // TONES
            for tone in range(TONES):
                old = 1 - (tone + 1) / TONES
                colour = ink.mix(actor.colour, ink.GROUND, 0.15 + 0.85 * old)
                width = self._width(actor, 4.8) * (1 - 0.6 * old)
                pen.line(trail[tone * length : (tone + 1) * length + 1], colour, width)
        pen.line(self.at(np.stack((main.goal[k], main.ball[k]))), main.colour, 1.4)
        for actor in self._actors:
            if np.isfinite(actor.ball[k]).all():
                self._mark(pen, actor, self.at(actor.ball[k]), BALL * self._per_m)
            elif actor.gone is not None and self.times[k] > actor.gone[1]:
                left, top, right, bottom = self._plate
                inside = np.clip(
                    self.at(actor.gone[0]), (left + 9, top + 9), (right - 9, bottom - 9)
                )
                for ends in SALTIRE * 7 + inside:
                    pen.line(ends, actor.colour, 4)
        for actor in self._actors:
            for width, colour in ((4.4, ink.GROUND), (2.0, ink.DARK)):
                for ends in CROSS * 6 + self.at(actor.goal[k]):
                    pen.line(ends, colour, width)

    def _play_side(self, side: int, pen: ink.Pen, k: int) -> None:
        """Draw the plate of frame ``k`` from one side; of the first run the ball as well."""
        for actor in self._actors:
            ends = self._profile(side, HALF[side], 0.0, float(actor.tilt[k, side]))
            pen.line(ends, actor.colour, self._width(actor, 4.0))
        main = self._actors[0]
        place, tilt = main.ball[k, side : side + 1], float(main.tilt[k, side])
        (at,) = self._profile(side, place, 8.0, tilt)
        if np.isfinite(at).all():
            pen.disc(at, 6, ink.mix(main.colour, ink.BLACK, 0.3))
            pen.disc(at, 4.8, main.colour)

    def _play_strip(self, pen: ink.Pen, k: int) -> None:
        """Draw where the errors are in frame ``k``."""
        for actor, curve in zip(self._actors, self._curves, strict=True):
            if np.isfinite(curve[k]).all():
                pen.disc(curve[k], self._width(actor, 3.6), actor.colour)

    def _letter(self, pen: ink.Pen) -> None:
        """Write what stays."""
        write, right = pen.write, WIDE - EDGE
        write((right - 78, CLOCK[1]), self._fast, 11, ink.GREY, "rs")
        room = WIDE - 2 * EDGE - (165 if self._fast else 85)
        write((EDGE, CLOCK[1]), self._title, 16, ink.DARK, room=room)
        for actor, (x, y) in zip(self._actors, self._entries, strict=True):
            number, which = actor.score
            dark = ink.mix(actor.colour, ink.BLACK, 0.12)
            wide = write((x + 27, y + 16), number, 18, dark)
            write((x + 32 + wide, y + 16), which, 11, ink.GREY)
            law = actor.run.scenario.controller.kind
            called = f"{actor.label}, {law}" if law != actor.label else law
            write((x + 27, y + 31), called, 11, ink.GREY, room=self._entry - 30)
        middle, y = (self._right[0] + self._right[2]) / 2, self._below[1]
        write((middle, y + 26), "tilt", 11, ink.GREY, "ms")
        write((middle, y + 41), f"× {self._steep}", 11, ink.GREY, "ms")
        left, top, _, bottom = self._strip
        write((EDGE, top - 6), "distance from the reference (+) [mm]", 11, ink.GREY)
        for level in LEVELS:
            y = bottom - level * (bottom - top) + 3.5
            write((left - 4, y), f"{level * self._top:g}", 10, ink.GREY, "rs")
        begin, end = self.times[0], self.times[-1]
        step = _above(max(end - begin, 1e-3) / 8)
        for tick in count(math.ceil(begin / step - 1e-9)):
            if tick * step > end - 0.1 * (end - begin):
                break
            x = left + (right - left) * (tick * step - begin) / max(end - begin, 1e-9)
            write((x, bottom + 13), f"{tick * step:g}", 10, ink.GREY, "ms")
        write((right, bottom + 13), "time [s]", 10, ink.GREY, "rs")


CORNER = 12
"""Radius of the picture's corners."""
# key frames only where they are needed: each is as large as many others
SMALL = {"lossless": True, "quality": 20, "method": 2, "kmin": 9999, "kmax": 10000}
KINDS: dict[str, dict[str, Any]] = {
    ".webp": {"format": "WEBP", **SMALL},
    ".gif": {"format": "GIF"},
    ".apng": {"format": "PNG"},
}
"""How Pillow writes each kind of moving picture."""


def moving(path: Path, film: Film, progress: Callable[[float], None] = lambda _: None) -> None:
    """Write a moving picture; the same runs give the same bytes.

    Args:
        path: ``.webp``, ``.gif``, ``.apng``, ``.mp4`` (by the extra ``video``), or a new folder for
            a .png of each frame.
        film: Its frames.
        progress: Is told how many of them are drawn.

    Raises:
        RecordError: If nothing can be written there, or the folder exists.
    """
    # pixels of a .gif are seen through or not: round corners would have steps
    drawn = film.frames()
    if path.suffix not in {".gif", ".mp4"}:
        drawn = ink.rounded(drawn, ink.FINE * CORNER * film.size[0] / WIDE)

    def frames() -> Iterator[Image.Image]:
        for number, frame in enumerate(drawn, 1):
            progress(number)
            yield frame

    def folder(target: Path) -> None:
        for number, frame in enumerate(frames(), 1):
            frame.save(target / f"frame-{number:04}.png")

    def file(target: Path) -> None:
        first, *others = frames()
        # in whole ms, of a .gif in 10 ms, that add up without drifting
        unit = 10 if path.suffix == ".gif" else 1
        ends = [round(1000 * k / (unit * film.fps)) * unit for k in range(film.count + 1)]
        lasting = [end - begin for begin, end in pairwise(ends)]
        animated: dict[str, Any] = {"save_all": True, "append_images": others, "loop": 0}
        first.save(target, duration=lasting, **animated, **KINDS[path.suffix])

    if path.suffix == ".mp4":
        write_whole(path, partial(_video, film=film, frames=frames()))
    elif path.suffix:
        write_whole(path, file)
    else:
        write_folder(path, folder)


def _video(target: Path, film: Film, frames: Iterator[Image.Image]) -> None:
    """Write frames as H.264, which takes an even number of pixels along x and y."""
    try:
        import av  # noqa: PLC0415  an extra
    except ImportError as error:
        raise RecordError(".mp4: needs the extra video: pip install 'ballplate[video]'") from error
    wide, high = (side - side % 2 for side in film.size)
    with av.open(str(target), "w", format="mp4") as file:
        stream = file.add_stream("libx264", rate=film.fps)
        stream.width, stream.height, stream.pix_fmt = wide, high, "yuv420p"
        for frame in frames:
            image = frame.convert("RGB").crop((0, 0, wide, high))
            file.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(image))))
        file.mux(stream.encode(None))


def _above(value: float) -> float:
    """The next round number that is not smaller."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(f * power for f in (1, 2, 3, 4, 5, 6, 8, 10) if f * power >= value * (1 - 1e-9))
