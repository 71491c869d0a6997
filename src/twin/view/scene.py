"""Mechanism, plate and rolling ball as Rerun entities, in space and from above."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from controllers.arrays import Array
from twin.scenario.schema import Dimensions

Colour = tuple[int, int, int]


def rolled(turn: Array, position: Array, radius: float) -> Array:
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
    drawn: Array = points * np.array([1000.0, -1000.0])
    return drawn


def fixed(
    root: str,
    path: Array,
    plate: Dimensions,
    *,
    colour: Colour,
) -> Iterator[tuple[str, rr.AsComponents]]:
    """What does not move in the top view.

    Args:
        root: Entity of the top view.
        path: Reference path in m, shape (K, 2).
        plate: Screen, operating area and ball.
        colour: Of the ball and its trail.
    """
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
        ("ball", colour, 1000 * plate.ball, 15.0),
        ("measured", (160, 160, 160), 5.0, 20.0),
        ("estimate", (230, 159, 0), 5.0, 21.0),
        ("reference", (255, 255, 255), 5.0, 22.0),
    ):
        point = rr.Points2D.from_fields(colors=[dot], radii=[radius], draw_order=order)
        yield f"{root}/{name}", point
    trail = rr.LineStrips2D.from_fields(colors=[colour], radii=[1.6], draw_order=12.0)
    yield f"{root}/trail", trail


VISIBLE_GROUPS = 3
"""Geoms of groups below this are drawn, as MuJoCo's own viewer does."""
STEEL = (128, 133, 140)
TURNED = ("cardan", "plate", "motor_phi", "motor_theta")


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
        screen, ball = model.geom("plate"), model.geom("ball")
        self.surface = float(screen.pos[2] + screen.size[2])
        """Height of the screen over the cardan joint, m."""
        self.radius = float(ball.size[0])
        self._lift = float(ball.size[2]) if ball.size[2] > 0 else self.radius
        seen = {int(body) for body in model.geom_bodyid[model.geom_group < VISIBLE_GROUPS]}
        self._turned = [name for name in TURNED if model.body(name).id in seen]
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
            thick, colour = (0.006, (26, 115, 64)) if entity.endswith("spring") else (0.003, STEEL)
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
        angle = dict(zip(TURNED, (theta, phi, motor[:, 0], motor[:, 1]), strict=True))
        poses: dict[str, Pose] = {}
        for name in self._turned:
            body = model.body(name)
            axis = model.jnt_axis[int(body.jntadr[0])]
            poses[self._paths[body.id]] = {
                "translation": np.broadcast_to(body.pos, (count, 3)),
                "quaternion": about(axis, angle[name]).as_quat(),
            }
        height = np.full(count, self.surface + self._lift)
        place = np.stack((state[:, 0], state[:, 4], height), axis=1)
        poses[self.ball] = {"translation": place, "quaternion": roll}
        return poses

    def lines(self, state: Array, motor: Array) -> dict[str, Array]:
        """Where spring or rods begin and end in rig axes at K instants, m, shape (K, 2, 3) each."""
        model, plate = self._model, plate_to_rig(state[:, 2], state[:, 6])
        turned = {model.body("plate").id: plate}
        for column, name in enumerate(("motor_phi", "motor_theta")):
            body = model.body(name)
            turned[body.id] = about(model.jnt_axis[int(body.jntadr[0])], motor[:, column])

        def end(site: int) -> Array:
            body, place = int(model.site_bodyid[site]), model.site_pos[site]
            if body not in turned:
                return np.broadcast_to(place, (len(state), 3))
            return np.asarray(model.body_pos[body] + turned[body].apply(place))

        return {
            entity: np.stack([end(site) for site in sites], axis=1)
            for entity, sites in self._lines.items()
        }


def about(axis: Array, angle: Array) -> Rotation:
    """Turns by angles (K,) in rad about a unit axis (3,)."""
    return Rotation.from_rotvec(angle[:, None] * axis)


def plate_to_rig(phi: Array, theta: Array) -> Rotation:
    """Plate axes to rig axes, R = Rx(theta) Ry(phi) (4.5), for angles (K,) in rad."""
    return Rotation.from_euler("XY", np.stack((theta, phi), axis=1))
