"""Paths of the ball with four exact derivatives: at rest, swinging, circling, through points."""

from controllers.references.harmonic import Sine
from controllers.references.path import Path, Transition
from controllers.references.point import Hold, Step
from controllers.references.setpoints import Setpoints
from controllers.references.soft import Circle, Lissajous

__all__ = ["Circle", "Hold", "Lissajous", "Path", "Setpoints", "Sine", "Step", "Transition"]
