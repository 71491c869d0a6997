# %% [markdown]
# # A control law of one's own
# A frozen dataclass whose fields are its settings, written here and run at once. Kept in
# `laws/friction_cascade.py` it is found by its name, on the command line too.

# %%
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

import ballplate as bp
from ballplate.laws import Array, Law, Reference


@dataclass(frozen=True, kw_only=True)
class FrictionCascade(Law):
    """Inner loop on the plate, outer loop on the ball; tilts against rolling friction ahead."""

    name: ClassVar[str] = "friction_cascade"

    arm_mm: float = 0.0
    """Rolling friction it reckons with, as its arm in mm."""

    def control(self, t: float, x: Array, reference: Reference, q: Array) -> Array:
        """Plate accelerations (phi'', theta'') in rad/s^2, shape (..., 2)."""
        position, velocity, angle, rate = (x[..., i::4] for i in range(4))
        r = reference(t)
        wanted = r[2] + 2.0 * (r[0] - position) + 2.4 * (r[1] - velocity)
        slope = 1e-3 * self.arm_mm / 0.02 * np.tanh(r[1] / 0.02)  # against the desired motion
        goal = np.clip(np.array([1.0, -1.0]) * (wanted / self.model.k1 + slope), -0.17, 0.17)
        return 60 * (goal - angle) - 14 * rate


# %% Without and with the friction reckoned with, beside the thesis's law
laws = [FrictionCascade(), FrictionCascade(arm_mm=0.18), "afl"]
compared = bp.compare("circle", vary={"controller": laws}, duration=15)
for label, run in compared.items():
    print(f"{run.metrics['tracking_error_percent']:5.1f} %  {label}")
compared
