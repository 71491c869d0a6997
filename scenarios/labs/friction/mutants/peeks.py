"""A cheat: looks up the friction of the rig it drives in the simulator, which is not there.

# fails: the ball stays on the plate
"""

from dataclasses import dataclass
from typing import ClassVar

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Against(Law):
    """Takes the truth, if it can be had."""

    name: ClassVar[str] = "against"

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        from twin.sim.plant.friction import Friction  # noqa: PLC0415

        return x[..., 2::4] * float(Friction().rolling_mm)
