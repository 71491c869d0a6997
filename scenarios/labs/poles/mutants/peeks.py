"""A cheat: runs the rig beforehand to try out weights; the simulator is not there.

# fails: the clean model stays on the plate
"""

from dataclasses import dataclass
from typing import ClassVar

from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class Poles(Law):
    """Simulates, if it may."""

    name: ClassVar[str] = "poles"

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        import ballplate as bp  # noqa: PLC0415

        return x[..., 2::4] * float(bp.run("hold").metrics["steady_error"])
