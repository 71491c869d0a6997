"""What printed numbers say of the rig's instruments: its plate encoders, and Table B.1."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from controllers.arrays import Array
from controllers.observers.kalman import NOISE
from controllers.observers.luenberger import Luenberger
from controllers.state_feedback import LQR
from twin.thesis.experiments.tables import chosen
from twin.thesis.reproduce.cases import DISTURBANCE

PERIOD = 0.002
"""Control period of the thesis, s."""


def angles() -> Array:
    """The plate angles printed in Tables 9.2 to 9.9, deg, shape (48,)."""
    circles = [each.cells for each in chosen() if each.omega is not None]
    return np.array([cells[name] for cells in circles for name in ("phi_max", "theta_max")])


def off_counts(counts: int) -> float:
    """How far the printed angles are from whole counts of an encoder, root mean square, counts.

    Angles that know nothing of the encoder are 0.289 off; printed to 0.0001 deg, whole counts of
    245760 a turn are 0.020 off.
    """
    found = angles() * counts / 360
    return float(np.sqrt(np.mean((found - np.rint(found)) ** 2)))


def printed_ratio() -> tuple[float, float]:
    """Table B.1: deviation of 'disturbance' over that of the touch screen, x and y, 1/s^2 m."""
    return (
        math.sqrt(DISTURBANCE[0] / NOISE[0]),
        math.sqrt(DISTURBANCE[1] / NOISE[2]),
    )


def own_ratio(law: LQR | None = None) -> tuple[float, float]:
    """The same of the control efforts with which a loop at rest answers the screen's white noise.

    Args:
        law: The law, LQR (100, 0.1) by default, behind observer (8.1) at 2 ms.
    """
    gain = (law or LQR(rho=100.0, kappa=0.1)).K
    observer = Luenberger(period=PERIOD)
    a, b, corrects = observer.A, observer.B, observer.L
    c = np.eye(8)[0::2]
    # plant x, prediction xbar; xhat = xbar + L (C x + n - C xbar), u = -K xhat
    seen, kept = corrects @ c, np.eye(8) - corrects @ c
    closed = a - b @ gain
    loop = np.block([[a - b @ gain @ seen, -b @ gain @ kept], [closed @ seen, closed @ kept]])
    enters = np.vstack((-b @ gain @ corrects, closed @ corrects))
    noise = np.diag(NOISE)
    spread = solve_discrete_lyapunov(loop, enters @ noise @ enters.T)
    out, direct = -gain @ np.hstack((seen, kept)), -gain @ corrects
    deviation = np.sqrt(np.diag(out @ spread @ out.T + direct @ noise @ direct.T))
    return float(deviation[0] / math.sqrt(NOISE[0])), float(deviation[1] / math.sqrt(NOISE[2]))


def turned(seconds: float) -> tuple[float, float]:
    """Deviation in deg of a plate's angles after a time from rest, were it a disturbance.

    White plate accelerations, each held for a period, on drives that follow rates.
    """
    steps = np.arange(round(seconds / PERIOD)) + 0.5
    reach = PERIOD**2 * math.sqrt(float((steps**2).sum()))
    phi, theta = (math.degrees(math.sqrt(variance) * reach) for variance in DISTURBANCE)
    return phi, theta
