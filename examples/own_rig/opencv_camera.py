"""A camera of one's own above the plate: OpenCV finds an orange ball in its pictures.

    uv run --with opencv-python-headless ballplate doctor --rig servos_and_opencv.toml

The camera may stand aslant. The corners of the level plate in a picture say where on the plate a
pixel is; the ball's middle is above that, so the camera's place is needed, too. A tilt of the plate
moves the ball in the picture a little: at 5 deg and 0.1 m by 2 mm, which this class leaves out.
"""

import math
import threading

import cv2
import numpy as np
from pictures import Pictures  # beside this file

from ballplate.hardware import Reading, ScreenHardware


class OverheadCamera(ScreenHardware):
    """A camera by OpenCV; the servos are other devices."""

    def __init__(
        self,
        source: int | str,  # number of a camera, address of a stream, or "made": pictures.py
        corners: list[list[float]],  # px: left front, right front, right back, left back
        eye: list[float],  # where the camera is, m from the middle of the plate and above it
        plate: tuple[float, float] = (0.3, 0.3),  # m
        radius: float = 0.02,  # of the ball, m
        colour: tuple[tuple[int, ...], ...] = (
            (5, 120, 60),
            (25, 255, 255),
        ),  # hue, saturation, value
        least: float = 100.0,  # px^2 of a ball
    ) -> None:
        self.source, self.colour, self.least = source, np.array(colour), least
        self.eye, self.radius = np.array(eye[:2]), radius / eye[2]
        x, y = plate[0] / 2, plate[1] / 2
        on_plate = [[-x, -y], [x, -y], [x, y], [-x, y]]
        places = np.float32(corners), np.float32(on_plate)
        self.to_metres = cv2.getPerspectiveTransform(*places)

    def find(self, picture: np.ndarray) -> tuple[float, float]:
        """Where the ball is in m; NaN where there is none."""
        colours = cv2.cvtColor(cv2.GaussianBlur(picture, (5, 5), 0), cv2.COLOR_BGR2HSV)
        mask = cv2.inRange(colours, *self.colour)
        patches, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        patch = max(patches, key=cv2.contourArea, default=None)
        if patch is None or cv2.contourArea(patch) < self.least:
            return math.nan, math.nan
        sums = cv2.moments(patch)
        pixel = np.array([[[sums["m10"] / sums["m00"], sums["m01"] / sums["m00"]]]])
        seen = cv2.perspectiveTransform(pixel, self.to_metres)[0, 0]
        x, y = seen + self.radius * (self.eye - seen)  # from the ray's end up to the ball's middle
        return float(x), float(y)

    def start(self) -> None:
        """Open the camera, wait for a picture, and look on from another thread."""
        if self.source == "made":
            self.camera = Pictures()
        else:
            self.camera = cv2.VideoCapture(self.source)
        self.lost, self.looking = False, True
        self.reading = self.look()
        if self.lost:
            raise OSError(f"camera {self.source}: no picture; is it the right number?")
        self.thread = threading.Thread(target=self.look_on, daemon=True)
        self.thread.start()

    def look(self) -> Reading:
        """The ball in the next picture; waits for it."""
        good, picture = self.camera.read()
        at = self.time()
        if not good:
            self.lost = True
            return Reading(math.nan, math.nan, at)
        return Reading(*self.find(picture), at)

    def look_on(self) -> None:
        """Look at each picture until the end."""
        while self.looking and not self.lost:
            self.reading = self.look()

    def measure(self) -> Reading:
        """What the newest picture shows."""
        return self.reading

    def stop(self) -> None:
        """Let the camera go."""
        self.looking = False
        if hasattr(self, "thread"):
            self.thread.join(timeout=1.0)
        if hasattr(self, "camera"):
            self.camera.release()

    def faults(self) -> tuple[str, ...]:
        """A camera that gives no pictures any more."""
        return (f"camera {self.source}: no more pictures",) if self.lost else ()
