"""How fast an observer forgets a wrong estimate: (7.2), and behind a dead time (7.19)."""

from __future__ import annotations

import copy

import numpy as np
from numpy.typing import NDArray

from controllers.interfaces import Measurement, Observer

Poles = NDArray[np.complexfloating]


def error_poles(observer: Observer, delay: float = 0.0) -> Poles:
    """Poles of an observer's error about the level plate when the ball is seen a dead time late.

    Without a dead time the poles of A (I - L C); with one, behind a Smith predictor, those of

        e[k] = (I - L_p C_p) A e[k-1] - L_b C_b e[k-n],

    n periods being the dead time, rounded, and p, b the measurements of plate and ball. A and L are
    found by giving the observer small states and measurements, so it may be any.

    Args:
        observer: Observer that corrects and predicts from measurements; it is not changed.
        delay: Dead time in s.

    Returns:
        Poles in 1/s, the slowest first, the least negative; a positive one is unstable.
    """
    probe, small, y = copy.copy(observer), 1e-6, np.zeros((8, 4))
    age, touched = np.zeros(8), np.ones(8, dtype=bool)
    probe.start(small * np.eye(8))
    probe.predict(np.zeros((8, 2)))
    A = probe.x.T / small
    probe.start(np.zeros((8, 8)))
    y[:4] = small * np.eye(4)
    L = probe.correct(Measurement(0.0, y, age, touched))[:4].T / small
    C = np.eye(8)[0::2]
    now, late = np.eye(8) - L[:, 1::2] @ C[1::2], L[:, 0::2] @ C[0::2]
    n = round(delay / observer.period)
    step = np.eye(8 * max(n, 1), k=-8)
    step[:8] = 0
    step[:8, :8] = (now if n else now - late) @ A
    if n:
        step[:8, -8:] -= late
    modes = np.linalg.eigvals(step)
    poles: Poles = np.log(modes[np.abs(modes) > 1e-12].astype(complex)) / observer.period
    slowest_first: Poles = poles[np.argsort(-poles.real)]
    return slowest_first
