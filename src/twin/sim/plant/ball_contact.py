"""How the one friction object acts in the engine: on each rig's ball, when it has to."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from controllers.arrays import Array, put
from twin.errors import ModelError
from twin.sim.plant.friction import Friction
from twin.sim.plant.level import from_plate

LEAST = mujoco.mjMINMU
"""Smallest rolling friction in m the engine can simulate; it lifts anything below to this."""


class BallContact:
    """The contact of ball and screen of every rig of a batch.

    Friction that is constant is written once and costs nothing; one that changes with the ball's
    speed, rest or place is updated by ``feel``. The engine knows no arm between 0 and 0.01 mm:
    a rig without any resistance rolls freely, the others have at least that much. Where a contact
    bends before it resists in full, the ball rolls freely in the engine and a force resists it.

    Args:
        batch: The rigs.
        friction: Their rolling resistance.

    Raises:
        ModelError: If a rolling resistance is too small for the engine.
    """

    def __init__(self, batch: Batch, friction: Friction) -> None:
        self.friction = friction
        model = batch.model
        roll = np.broadcast_to(np.asarray(friction.rolling, float), (batch.nsim,))
        free = np.broadcast_to(friction.absent, (batch.nsim,))
        if not np.all((roll == 0) | (roll >= LEAST)):
            raise ModelError(f"rolling friction must be 0 or at least {LEAST} m, got {roll.min()}")
        pair = model.pair("ball_plate").id
        self._arm = batch.expand("pair_friction")[:, pair, 3:5]
        self._arm[:] = np.maximum(roll, LEAST)[:, None]
        rolls = free | (np.asarray(friction.presliding) > 0)
        batch.expand("pair_dim")[:, pair] = np.where(rolls, free_dimension(model), 6)
        self.varying = not friction.constant and not (free.all() and friction.map is None)
        """Whether ``feel`` has to be called."""
        self._sloping = friction.map is not None and friction.map.sloping
        ball = model.body("ball").id
        self._force = batch.bind("xfrc_applied")[:, ball, :3]
        self._forced = self._sloping or friction.bending
        if self._forced:
            mass = batch.expanded("body_mass")
            masses = model.body_mass if mass is None else mass
            self._weight = masses[..., ball] * np.linalg.norm(model.opt.gravity)
            sizes = batch.expanded("geom_size")
            sizes = model.geom_size if sizes is None else sizes
            self._radius = sizes[..., model.geom("ball").id, 0]

    def start(self, x: Array) -> None:
        """Begin with the state x, (N, 8); a ball at rest is taken to have rested long."""
        self.age = self._settled(x)
        """Age of each contact, shape (N,)."""
        self.bend: Array = np.zeros((len(x), 2))
        """How far each contact is bent, m, shape (N, 2); 0 of one that does not."""

    def begin(self, rigs: NDArray[np.integer], x: Array) -> None:
        """Begin with some rigs of the state x, (N, 8), anew."""
        self.age = put(self.age, rigs, self._settled(x)[rigs])
        self.bend = put(self.bend, rigs, np.zeros((len(rigs), 2)))

    def _settled(self, x: Array) -> Array:
        """Age of contacts that have long been in the state x, shape (N,)."""
        return self.friction.settled(np.hypot(x[:, 1], x[:, 5]))

    def go_on(self, before: BallContact, x: Array) -> None:
        """Begin where another contact of the same balls ends, in the state x, (N, 8)."""
        self.age = before.age if before.friction.ageing else self._settled(x)
        self.bend = before.bend
        self._force[:] = 0.0

    def feel(self, x: Array, time: float) -> None:
        """Set friction and slope for the state x, shape (N, 8), which will last a time in s."""
        friction = self.friction
        position, speed = x[:, 0::4], np.hypot(x[:, 1], x[:, 5])
        if friction.ageing:
            self.age = friction.aged(self.age, speed, time)
            arm = friction.arm(speed, position, self.age)
        else:
            arm = friction.arm(speed, position)
        self._arm[:] = np.maximum(arm, LEAST)[:, None]
        if not self._forced:
            return
        phi, theta = x[:, 2], x[:, 6]
        normal = (self._weight * np.cos(phi) * np.cos(theta))[:, None]
        along = np.zeros((len(x), 3))
        if self._sloping:
            assert friction.map is not None
            along[:, :2] = -normal * friction.map(position)[1]
        if friction.bending:
            self.bend = friction.bent(self.bend, x[:, 1::4], time)
            along[:, :2] -= normal * (arm / self._radius)[:, None] * friction.share(self.bend)
        self._force[:] = from_plate(along, phi, theta)


def free_dimension(model: mujoco.MjModel) -> int:
    """Dimension of the contact of a ball that rolls freely: 4 resists spin, 3 only slides."""
    return 4 if model.pair_friction[model.pair("ball_plate").id, 2] > LEAST else 3
