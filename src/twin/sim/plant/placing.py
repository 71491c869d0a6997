"""How balls are put, rolling, on the plates of a batch of mechanisms."""

from __future__ import annotations

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from controllers.arrays import Array, Number
from twin.sim.plant.addresses import Addresses
from twin.sim.plant.kinematics import rolling_ball


class BallPlacing:
    """Writes where the balls of N rigs are and how they roll.

    Args:
        batch: The rigs.
        at: Places in its arrays.
        surface: Height of the screen over the cardan joint, m.
        height: That of the balls' centres on a level plate, m, shape (N,).
    """

    def __init__(self, batch: Batch, at: Addresses, surface: float, height: Array) -> None:
        self._qpos: Array = batch.bind("qpos")
        self._qvel: Array = batch.bind("qvel")
        self._at, self._surface, self._height = at, surface, height

    def change(self, rigs: NDArray[np.integer], height: Array) -> None:
        """Give some rigs balls whose centres are at other heights in m, shape (k,)."""
        self._height[rigs] = height

    @property
    def _radius(self) -> Array:
        return self._height - self._surface

    def level(self, rigs: slice | NDArray[np.integer], ball: Array, spin: Number = 0.0) -> None:
        """Let balls of level plates roll at (x, x', y, y'), shape (k, 4).

        Positions in m, speeds in m/s; ``spin`` is their rate about the vertical in rad/s.
        """
        x, vx, y, vy = ball.T
        zero, radius = np.zeros(len(ball)), self._radius[rigs]
        self._qpos[rigs, self._at.ball_pose] = np.stack((x, y, self._height[rigs]), axis=-1)
        turn = (-vy / radius, vx / radius, zero + spin)
        self._qvel[rigs, self._at.ball_rate] = np.stack((vx, vy, zero, *turn), axis=-1)

    def tilted(self, ball: Array) -> None:
        """Let the balls roll at (x, x', y, y') on plates as they are now, shape (N, 4)."""
        angles, rates = self._qpos.T[self._at.poses[:2]], self._qvel.T[self._at.rates[:2]]
        centre, velocity, turning = rolling_ball(angles, rates, ball.T, self._height, self._radius)
        pose, rate = self._at.ball_pose.start, self._at.ball_rate.start
        self._qpos[:, pose : pose + 3] = centre
        # upright, so that its own axes are those of the rig
        self._qpos[:, pose + 3 : pose + 7] = 1.0, 0.0, 0.0, 0.0
        self._qvel[:, rate : rate + 3] = velocity
        self._qvel[:, rate + 3 : rate + 6] = turning
