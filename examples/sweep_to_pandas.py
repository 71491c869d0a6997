# %% [markdown]
# # A sweep as a pandas table
# Every combination of values is a run; only its indicators are kept. All processors are used.

# %%
import numpy as np

import ballplate as bp

friction = np.linspace(0, 0.4, 5)
laws = ["backstepping", "afl"]
found = bp.sweep(
    "circle", {"plant.friction.rolling_mm": friction, "controller.kind": laws}, duration=15
)
found

# %% Long to wide: a row per friction, a column per law
frame = found.to_pandas()
table = frame.pivot_table(
    index="plant.friction.rolling_mm", columns="controller.kind", values="tracking_error_percent"
)
print(table.round(1))
found.plot("max_steady_error").savefig("sweep.png")
