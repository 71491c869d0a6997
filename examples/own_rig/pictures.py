"""Pictures of a ball on a plate for `opencv_camera.py`, made by a pinhole camera.

It follows the ray of every pixel to the plate or to the ball, so it shares no formula with the
class that looks for the ball. In place of `cv2.VideoCapture`: `read` waits for the next picture.
"""

import math
import time

import numpy as np

SIZE_PX, FOCAL_PX = (640, 480), 700.0
EYE_M = np.array([0.06, -0.05, 0.55])  # where the camera is, above the plate
PLATE_M, BALL_RADIUS_M, FRAME_S, NOISE = np.array([0.3, 0.3]), 0.02, 1 / 60, 4.0
GROUND, PLATE, BALL = (40.0, 45.0, 40.0), (225.0, 225.0, 220.0), np.array([20.0, 120.0, 240.0])


def axes() -> np.ndarray:
    """Unit vectors right, down and forward of a camera that looks at the middle, shape (3, 3)."""
    forward = -EYE_M / np.linalg.norm(EYE_M)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(forward, right), forward])


def pixels(points: np.ndarray) -> np.ndarray:
    """Where points in m, shape (..., 3), are in the picture, px."""
    right, down, forward = np.moveaxis((points - EYE_M) @ axes().T, -1, 0)
    return np.stack((right, down), -1) / forward[..., None] * FOCAL_PX + np.array(SIZE_PX) / 2


def corners() -> list[list[float]]:
    """The plate's corners in px: left front, right front, right back, left back."""
    x, y = PLATE_M / 2
    return pixels(np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])).round(2).tolist()


class Pictures:
    """A camera of 60 pictures/s above a ball that rests at (x, y) m, or is nowhere."""

    def __init__(self, ball: tuple[float, float] = (0.03, -0.02), *, paced: bool = True) -> None:
        self.ball, self.paced = ball, paced
        self.chance = np.random.default_rng(1)
        self.due = time.monotonic()
        u, v = np.meshgrid(*(np.arange(each) - each / 2 for each in SIZE_PX))
        rays = np.stack((u, v, np.full_like(u, FOCAL_PX)), -1) @ axes()
        self.rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        at = EYE_M[:2] - EYE_M[2] * self.rays[..., :2] / self.rays[..., 2:]
        on = (np.abs(at) < PLATE_M / 2).all(-1)
        self.empty = np.where(on[..., None], PLATE, GROUND)

    def picture(self) -> np.ndarray:
        """Blue, green and red of each pixel, shape (480, 640, 3)."""
        made = self.empty.copy()
        if math.isfinite(self.ball[0]):
            to_ball = np.array([*self.ball, BALL_RADIUS_M]) - EYE_M
            along = self.rays @ to_ball
            inside = BALL_RADIUS_M**2 - (to_ball @ to_ball - along**2)
            seen = inside > 0
            hit = self.rays[seen] * (along[seen] - np.sqrt(inside[seen]))[:, None]
            up = (hit - to_ball)[:, 2:] / BALL_RADIUS_M  # lit from above
            made[seen] = BALL * (0.5 + 0.5 * np.clip(up, 0, 1))
        made += self.chance.normal(0, NOISE, made.shape)
        return np.clip(made, 0, 255).astype(np.uint8)

    def read(self) -> tuple[bool, np.ndarray]:
        """Whether there is a picture, and the next one."""
        if self.paced:
            self.due = max(self.due + FRAME_S, time.monotonic())
            time.sleep(max(0.0, self.due - time.monotonic()))
        return True, self.picture()

    def release(self) -> None:
        """Nothing to let go."""
