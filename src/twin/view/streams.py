"""A run as entities and columns for Rerun: mechanism, plate and ball, time plots."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from controllers.arrays import Array
from controllers.interfaces import Reference
from twin.base.data_file import read_packaged
from twin.hal.cams import CamTable
from twin.hal.interface import AXIS_NAMES
from twin.hal.supervisor import State
from twin.run.controller_building import build_reference
from twin.run.finished import columns, states_of
from twin.run.plants import drawn_mechanism, parts_of
from twin.run.record import of_axes
from twin.scenario.schema import Scenario
from twin.sim.plant.model import screen_of
from twin.view.lanes import (
    STATE_COLOURS,
    RunLanes,
    find_lifted,
    find_limited,
    find_undetected,
    lane_columns,
    looks,
)

Colour = tuple[int, int, int]


def rolling_attitude(turn: Array, position: Array, radius: float) -> Array:
    """How a ball lies that rolls without slip along positions (K, 2), quaternions (K, 4).

    A way d along the screen turns it by |d| / radius about the axis (-d_y, d_x, 0), in plate axes.
    The first entry is ``turn``, the way it lay at the first position. Spin about the normal is not
    seen in positions and so left out.
    """
    x, y = np.diff(position, axis=0).T / radius
    steps = Rotation.from_rotvec(np.stack((-y, x, np.zeros(len(x))), axis=1))
    found = [Rotation.from_quat(turn)]
    for step in steps:
        found.append(step * found[-1])
    return np.stack([each.as_quat() for each in found])


def in_view(points: Array) -> Array:
    """Points in m, (..., 2), as the view draws them: mm, y upwards (its own y goes down)."""
    return points * np.array([1000.0, -1000.0])


VISIBLE_GROUPS = 3
"""Geoms of groups below this are drawn, as MuJoCo's own viewer does."""
STEEL_COLOUR = (128, 133, 140)
TURNED_PARTS = ("cardan", "plate", "motor_phi", "motor_theta")


Pose = dict[str, Array]
"""Where an entity is over time: ``translation`` (K, 3) in m and ``quaternion`` (K, 4) xyzw."""


class Scene:
    """The shapes of a compiled mechanism under one entity, and their motion.

    The entities hang together like the mechanism: the plate under the cardan cross, the ball in
    plate axes under the plate, so that each carries only its own joint's motion.

    Args:
        model: The compiled mechanism.
        root: Entity under which it stands.
    """

    def __init__(self, model: mujoco.MjModel, root: str) -> None:
        self._model = model
        self.root = root
        self.plate = f"{root}/cardan/plate"
        self.ball = f"{self.plate}/ball"
        self._paths = {
            0: f"{root}/base",
            model.body("cardan").id: f"{root}/cardan",
            model.body("plate").id: self.plate,
            model.body("motor_phi").id: f"{root}/motor_phi",
            model.body("motor_theta").id: f"{root}/motor_theta",
            model.body("ball").id: self.ball,
        }
        ball = model.geom("ball")
        self.surface = screen_of(model).height
        """Height of the screen over the cardan joint, m."""
        self.radius = float(ball.size[0])
        self._lift = float(ball.size[2]) if ball.size[2] > 0 else self.radius
        seen = {int(body) for body in model.geom_bodyid[model.geom_group < VISIBLE_GROUPS]}
        self._turned = [name for name in TURNED_PARTS if model.body(name).id in seen]
        self._lines = {
            f"{root}/{model.tendon(i).name}": model.wrap_objid[model.tendon_adr[i] :][:2].tolist()
            for i in range(model.ntendon)
            if model.tendon_group[i] < VISIBLE_GROUPS
        }
        """Sites at both ends of the spring or the rods, as far as they are drawn."""

    def shapes(self, colour: Colour) -> Iterator[tuple[str, rr.AsComponents]]:
        """What does not change: entity and shape, to be logged once; the trail in a colour."""
        yield self.root, rr.ViewCoordinates.RIGHT_HAND_Z_UP
        model = self._model
        for i in range(model.ngeom):
            if model.geom_group[i] < VISIBLE_GROUPS and model.geom(i).name not in ("ball", "floor"):
                entity = f"{self._paths[int(model.geom_bodyid[i])]}/{model.geom(i).name}"
                yield entity, self._shape(i)
        yield (
            f"{self.plate}/trail",
            rr.LineStrips3D.from_fields(colors=[colour], radii=[0.0022]),
        )
        # rings on the ball, so that one sees it roll
        for name, wide, rgb, mode in (
            ("ball", 1.0, [248, 246, 238], rr.components.FillMode.Solid),
            ("rings", 1.01, [238, 120, 20], rr.components.FillMode.MajorWireframe),
        ):
            sizes = wide * np.array([self.radius, self.radius, self._lift])
            look = {"colors": [rgb], "fill_mode": mode, "line_radii": 0.001}
            yield f"{self.ball}/{name}", rr.Ellipsoids3D(half_sizes=[sizes], **look)
        for entity in self._lines:
            thick, colour = (
                (0.006, (26, 115, 64)) if entity.endswith("spring") else (0.003, STEEL_COLOUR)
            )
            yield entity, rr.LineStrips3D.from_fields(colors=[colour], radii=[thick])

    def _shape(self, i: int) -> rr.AsComponents:
        """A box, a cylinder or a capsule: what else there is is not drawn."""
        model = self._model
        material = int(model.geom_matid[i])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[i]
        w, x, y, z = model.geom_quat[i]
        place: dict[str, Any] = {
            "quaternions": [[x, y, z, w]],
            "colors": [np.round(255 * rgba).astype(np.uint8)],
        }
        size, centre, kind = model.geom_size[i], [model.geom_pos[i]], model.geom_type[i]
        place |= {"fill_mode": rr.components.FillMode.Solid}
        if kind == mujoco.mjtGeom.mjGEOM_BOX:
            return rr.Boxes3D(half_sizes=[size], centers=centre, **place)
        place |= {"lengths": [2 * size[1]], "radii": [size[0]]}
        if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
            return rr.Cylinders3D(centers=centre, **place)
        # a capsule of Rerun begins at its lower cap's centre, one of MuJoCo in its middle
        turn = Rotation.from_quat(model.geom_quat[i], scalar_first=True)
        start = model.geom_pos[i] - size[1] * turn.as_matrix()[:, 2]
        return rr.Capsules3D(translations=[start], **place)

    def poses(self, state: Array, motor: Array, roll: Array) -> dict[str, Pose]:
        """How the entities lie at K instants.

        Args:
            state: States of (5.5), shape (K, 8).
            motor: Motor shaft angles (phi, theta) in rad, shape (K, 2).
            roll: Turn of the ball in plate axes, quaternions xyzw, shape (K, 4).
        """
        model, count = self._model, len(state)
        phi, theta = state[:, 2], state[:, 6]
        angle = dict(zip(TURNED_PARTS, (theta, phi, motor[:, 0], motor[:, 1]), strict=True))
        poses: dict[str, Pose] = {}
        for name in self._turned:
            body = model.body(name)
            axis = model.jnt_axis[int(body.jntadr[0])]
            poses[self._paths[body.id]] = {
                "translation": np.broadcast_to(body.pos, (count, 3)),
                "quaternion": Rotation.from_rotvec(angle[name][:, None] * axis).as_quat(),
            }
        height = np.full(count, self.surface + self._lift)
        place = np.stack((state[:, 0], state[:, 4], height), axis=1)
        poses[self.ball] = {"translation": place, "quaternion": roll}
        return poses

    def lines(self, state: Array, motor: Array) -> dict[str, Array]:
        """Where spring or rods begin and end in rig axes at K instants, m, shape (K, 2, 3) each."""
        model, data = self._model, mujoco.MjData(self._model)
        joints = [int(model.body(name).jntadr[0]) for name in TURNED_PARTS]
        places = np.empty((len(state), model.nsite, 3))
        for k, angles in enumerate(zip(state[:, 6], state[:, 2], *motor.T, strict=True)):
            data.qpos[model.jnt_qposadr[joints]] = angles
            mujoco.mj_kinematics(model, data)
            places[k] = data.site_xpos
        return {entity: places[:, sites] for entity, sites in self._lines.items()}


# Okabe and Ito's colours: distinct with any colour vision; black is white on the dark ground.
BLUE, VERMILION, GREEN, PINK = (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167)
ORANGE, SKY, GREY, BLACK = (230, 159, 0), (86, 180, 233), (150, 150, 150), (235, 235, 235)


LINE_COLOURS = (BLUE, VERMILION, GREEN, PINK)
"""The colours of the lines of a plot, in their order."""
LINE_LOOKS = {
    "ball": (BLUE, 2.0),
    "estimate": (ORANGE, 1.5),
    "measured": (GREY, 1.0),
    "reference": (BLACK, 1.0),
    "distance": (GREY, 1.0),
}
"""Colour and width of the lines that have their own."""
RUN_LINE_COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
"""The colours of runs that are shown together."""
SHARED_LINES = ("reference", "dead_time")
"""Lines that are the same in all of them: the first run has them."""


def shade(run: int, number: int) -> Colour:
    """The colour of a run in the shade of one of its lines, by their number in a plot."""
    share = (0.0, 0.35, 0.6)[number % 3]
    red, green, blue = (
        round(c + share * (255 - c)) for c in RUN_LINE_COLOURS[run % len(RUN_LINE_COLOURS)]
    )
    return red, green, blue


def telling(plot: Mapping[str, Array], run: int) -> dict[str, Array]:
    """The lines of a plot that differ between runs, and those common to all, once."""
    left_out = ("estimate", "measured", *("xy" if "distance" in plot else ()))
    left_out += SHARED_LINES if run else ()
    return {name: values for name, values in plot.items() if name not in left_out}


PLOT_TABLES: dict[str, dict[str, str]] = read_packaged("twin.view", "plots.toml")
"""Entity of each plot and its title with the unit, by the tab it stands in."""

LINE_TABLES = read_packaged("twin.view", "lines.toml")
"""Plots and the columns that are their lines; the file defines both."""


def signals(
    rows: Mapping[str, Array], reference: Array, dead_time: float = 0.0, axes: int = 2
) -> dict[str, dict[str, Array]]:
    """Group entity to the values of its lines, shape (K,), by name.

    Args:
        rows: Recorded columns, (K,) each.
        reference: Desired ball position in m, shape (K, 2).
        dead_time: Dead time of the simulated screen, s.
        axes: Number of axes of the rig; of 1 no line is of the second.
    """
    kind = "true" if "true_x" in rows else "estimated"
    error = reference - states_of(rows)[:, 0::4]
    own = {**rows, "distance": np.hypot(*error.T)}
    if "age" in rows:
        own["dead_time"] = np.full(len(error), dead_time)
    for i, axis in enumerate("xy"):
        own[f"goal_{axis}"], own[f"error_{axis}"] = reference[:, i], error[:, i]
        own[f"seen_{axis}"] = np.where(own.get("touched", 1.0), rows[f"measured_{axis}"], np.nan)
        if kind == "true":
            own[f"off_{axis}"] = rows[f"true_{axis}"] - rows[f"estimated_{axis}"]
    found = {}
    for entity, about in LINE_TABLES.items():
        at = {name: column.replace("STATE", kind) for name, column in about["lines"].items()}
        drawn = {name: c for name, c in at.items() if c in own and of_axes([c], axes)}
        plot = {name: about.get("factor", 1.0) * own[c] for name, c in drawn.items()}
        if plot:
            found[entity] = plot
    return found


LANES_GROUP = "states"
"""Group of the lanes of states."""
TIMELINE_NAME = "simulated time [s]"
POSES_PER_SECOND = 50.0
"""Poses and trails per second; the plots have every period."""
TRAIL_S = 3.0
"""Seconds of the ball's path that its trail shows."""


class Batch(NamedTuple):
    """Data of one entity in one call: times in s, shape (K,), and columns of components."""

    entity: str
    time: Array
    columns: rr.ComponentColumnList


class RunStream:
    """One run as entities under its name.

    Args:
        name: The run's name, the root of its entities.
        scenario: What is run.
        among: Which of the runs shown together it is, from 0; None if it is alone.
        reference: Desired position of the ball; by default the scenario's reference.

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
        self._colour = RUN_LINE_COLOURS[(among or 0) % len(RUN_LINE_COLOURS)]
        self.root = f"/{rr.escape_entity_path_part(name)}"
        self._reference = build_reference(scenario) if reference is None else reference
        self.scenario = scenario
        self.scene = Scene(drawn_mechanism(scenario), f"{self.root}/mechanism")
        self._cams = parts_of(scenario).linkage or CamTable.packaged()
        self._turn = np.array([0.0, 0.0, 0.0, 1.0])
        self._last: Array | None = None
        self._trail = np.empty((0, 3))
        self._next_frame = -1.0
        self._state = -1
        self._lanes = RunLanes(scenario)
        self._marks: dict[str, bool] = {}

    def fixed(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """The constant parts of the run: shapes, top view of the plate, reference path."""
        yield from self.scene.shapes(self._colour)
        times = np.linspace(0, self.scenario.duration, 2000)
        path = self._reference(times)[0]
        yield from self._top_view(path)
        for name in STATE_COLOURS:
            yield f"{self.root}/{LANES_GROUP}/{name}", looks(name)
        lifted = np.column_stack((path, np.full(len(path), self.scene.surface + 0.001)))
        yield (
            f"{self.scene.plate}/reference_path",
            rr.LineStrips3D([lifted], colors=[[235, 235, 235]], radii=0.0008),
        )

    def _top_view(self, path: Array) -> Iterator[tuple[str, rr.AsComponents]]:
        """What does not move in the top view; the reference path in m, shape (K, 2)."""
        root, plate = f"{self.root}/plate_mm", self.scenario.dimensions
        half = 500 * np.array(plate.screen)
        for name, sides, dot, thick, order in (
            ("screen", half, (120, 130, 140), 1.2, 1.0),
            ("operating_area", 1000 * np.array(plate.area), (120, 170, 200), 0.7, 2.0),
        ):
            look = {"colors": [dot], "radii": thick, "draw_order": order}
            outline: rr.AsComponents = rr.Boxes2D(centers=[[0, 0]], half_sizes=[sides], **look)
            if plate.round and name == "screen":
                turn = np.linspace(0, 2 * np.pi, 121)
                rim = half * np.column_stack((np.cos(turn), np.sin(turn)))
                outline = rr.LineStrips2D([rim], **look)
            yield f"{root}/{name}", outline
        corner = 0.9 * np.array([-0.5, -0.5]) * plate.screen
        tips = in_view(np.array([[0.06, 0.0], [0.0, 0.06]]))
        yield (
            f"{root}/axes",
            rr.Arrows2D(
                origins=[in_view(corner)] * 2,
                vectors=tips,
                colors=[[230, 80, 80], [80, 200, 90]],
                labels=["x", "y"],
                radii=1.5,
            ),
        )
        yield (
            f"{root}/reference_path",
            rr.LineStrips2D([in_view(path)], colors=[[235, 235, 235]], radii=0.6, draw_order=10.0),
        )
        for name, dot, radius, order in (
            ("ball", self._colour, 1000 * plate.ball, 15.0),
            ("measured", (160, 160, 160), 5.0, 20.0),
            ("estimate", (230, 159, 0), 5.0, 21.0),
            ("reference", (255, 255, 255), 5.0, 22.0),
        ):
            point = rr.Points2D.from_fields(colors=[dot], radii=[radius], draw_order=order)
            yield f"{root}/{name}", point
        trail = rr.LineStrips2D.from_fields(colors=[self._colour], radii=[1.6], draw_order=12.0)
        yield f"{root}/trail", trail

    def batches(self, rows: Mapping[str, Array]) -> Iterator[Batch]:
        """A block of rows, shape (K,) per column, as columns for the viewer."""
        time = rows["time"]
        if len(time) == 0:
            return
        reference = self._reference(time)[0]
        for group, plot in self.plots(rows).items():
            for name, values in plot.items():
                shown = rr.Scalars.columns(scalars=values)
                yield Batch(f"{self.root}/{group}/{name}", time, shown)
        for name, lane in self._lanes.take(rows):
            yield Batch(f"{self.root}/{LANES_GROUP}/{name}", lane.time, lane_columns(lane.states))
        yield from self._states_and_events(rows)
        keep = self._frames(time)
        if len(keep):
            frames = {name: column[keep] for name, column in rows.items()}
            ball = states_of(frames)[:, 0::4]
            before = ball[:1] if self._last is None else self._last
            turns = rolling_attitude(self._turn, np.concatenate((before, ball)), self.scene.radius)[
                1:
            ]
            self._last, self._turn = ball[-1:], turns[-1]
            yield from self._moving(frames, turns)
            yield from self._on_plate(frames, reference[keep])

    def plots(self, rows: Mapping[str, Array]) -> dict[str, dict[str, Array]]:
        """The lines of the time plots: group to name to values."""
        reference = self._reference(rows["time"])[0]
        dead_time = self.scenario.sensors.touch.dead_time
        plots = signals(rows, reference, dead_time, self.scenario.plant.axes)
        if self._among is None:
            return plots
        return {group: telling(plot, self._among) for group, plot in plots.items()}

    def styles(self, rows: Mapping[str, Array]) -> Iterator[tuple[str, rr.AsComponents]]:
        """Colour, width and name of each line of the plots, as the rows have them."""
        for group, plot in self.plots(rows).items():
            for number, name in enumerate(plot):
                called = name.replace("_", " ")
                colour, width = LINE_LOOKS.get(
                    name, (LINE_COLOURS[number % len(LINE_COLOURS)], 1.5)
                )
                if self._among is not None:
                    called = f"{self.name}: {called}"
                    colour = colour if name in SHARED_LINES else shade(self._among, number)
                yield f"{self.root}/{group}/{name}", line(colour, width, called)

    def _frames(self, time: Array) -> NDArray[np.integer]:
        """Indices of the rows of which a picture is made, FRAMES per second."""
        slot = np.floor(time * POSES_PER_SECOND + 1e-6)
        first = slot > np.concatenate(([self._next_frame], slot[:-1]))
        self._next_frame = float(slot[-1])
        return np.flatnonzero(first)

    def _states_and_events(self, rows: Mapping[str, Array]) -> Iterator[Batch]:
        """States of the supervisor as they change, and what else happens, in words."""
        time, state = rows["time"], rows["supervisor"].astype(int)
        changed = np.flatnonzero(np.diff(state, prepend=self._state))
        self._state = int(state[-1])
        names = [State(value).name.lower() for value in state[changed]]
        events = [(time[k], f"supervisor: {name}") for k, name in zip(changed, names, strict=True)]
        active = {"ball not detected": find_undetected(rows)}
        active |= zip(
            ("phi effort limited", "theta effort limited"), find_limited(rows), strict=True
        )
        wheels = [f"wheel {axis} lifted off its cam" for axis in AXIS_NAMES]
        active |= zip(wheels, find_lifted(rows) or (), strict=False)
        for what, mask in active.items():
            began = np.flatnonzero(np.diff(mask.astype(int), prepend=self._marks.get(what, 0)) > 0)
            self._marks[what] = bool(mask[-1])
            events += [(time[k], what) for k in began[:20]]
        yield from event_texts(self.root, sorted(events, key=lambda event: event[0]), "INFO")

    def _moving(self, rows: Mapping[str, Array], turns: Array) -> Iterator[Batch]:
        time, state = rows["time"], states_of(rows)
        if "motor_phi_rad" in rows:
            motor = np.stack((rows["motor_phi_rad"], rows["motor_theta_rad"]), axis=1)
        else:
            motor = self._cams.motor(state[:, 2::4])
        for entity, pose in self.scene.poses(state, motor, turns).items():
            yield Batch(entity, time, rr.Transform3D.columns(**pose))
        for entity, ends in self.scene.lines(state, motor).items():
            yield Batch(entity, time, rr.LineStrips3D.columns(strips=ends))

    def _on_plate(self, rows: Mapping[str, Array], reference: Array) -> Iterator[Batch]:
        time, ball = rows["time"], states_of(rows)[:, 0::4]
        self._trail = np.concatenate((self._trail, np.column_stack((time, ball))))
        starts = np.searchsorted(self._trail[:, 0], time - TRAIL_S)
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


def line(colour: Colour, width: float, called: str) -> rr.AsComponents:
    """How a line of the plots is drawn."""
    return rr.SeriesLines(colors=[colour], widths=[width], names=[called])


def event_texts(root: str, events: Sequence[tuple[float, str]], level: str) -> Iterator[Batch]:
    """Times in s and texts of what happened, if anything did."""
    if events:
        times, texts = zip(*events, strict=True)
        lines = rr.TextLog.columns(text=texts, level=[level] * len(events))
        yield Batch(f"{root}/events", np.array(times), lines)


TWIN_PLOTS = ("twin_score", "twin_error_mm")
"""Groups of the plots of the twin."""

TWIN_RANGE = (-0.4, 12.0)
"""What their axes show: where a ball may or may not stop, its band is as wide as the plate."""
