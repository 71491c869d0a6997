"""A digital twin of a cam-driven ball-and-plate rig."""

from ballplate.comparing import Comparison, compare
from ballplate.running import run

__all__ = ["Comparison", "compare", "run"]
