"""A digital twin of a cam-driven ball-and-plate rig."""

from twin import installation as installation
from twin.base import parts as parts
