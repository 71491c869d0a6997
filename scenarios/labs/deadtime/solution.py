"""Lab `deadtime`: dead time from the log, and an observer slow enough to live with it."""

from pathlib import Path

import numpy as np
import pandas as pd

GRID = np.arange(0.03, 0.15, 0.001)
"""Dead times tried, s."""
K1, C2 = 5.886, 0.0932
"""Ball's acceleration for a unit sine of the slope, m/s^2; lever of the plate's acceleration, m."""


def answer(rig: dict[str, float], folder: Path) -> dict[str, object]:
    """Predictor and observer of the rig that the log in the folder was recorded on."""
    log = pd.read_csv(folder / "log.csv")
    columns = {name.split(" ")[0]: name for name in log.columns}
    time, x, phi = (
        log[columns[each]].to_numpy() for each in ("time", "measured_x", "measured_phi")
    )
    step = time[1] - time[0]
    # x'' = k1 sin(phi) - c2 phi'', integrated twice, with any start and speed
    moved = np.cumsum(np.cumsum(K1 * np.sin(phi))) * step**2 - C2 * phi
    left = []
    for late in GRID:
        shifted = np.interp(time - late, time, moved)
        seen = time > GRID[-1]
        columns_ = np.stack([np.ones_like(time), time, time**2, shifted], axis=1)[seen]
        left.append(np.linalg.lstsq(columns_, x[seen], rcond=None)[1][0])
    best = float(GRID[int(np.argmin(left))])
    return {
        "predictor": {"delay": round(best, 3)},
        "observer": {"poles": [-2.8, -3.5, -4.9, -5.6]},
    }
