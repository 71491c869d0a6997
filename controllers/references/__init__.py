"""Paths of the ball with four exact derivatives: at rest, swinging, circling, through points."""

from controllers.references.figures import Circle, Hold, Lissajous, Sine, Step
from controllers.references.paths import Path, Transition
from controllers.references.setpoints import Setpoints

__all__ = ["Circle", "Hold", "Lissajous", "Path", "Setpoints", "Sine", "Step", "Transition"]
