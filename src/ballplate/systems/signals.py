"""What the systems call their signals, and how they become systems of python-control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import control

    from controllers.analysis import System

INPUTS = ("phi_acc", "theta_acc")
"""Plate accelerations u of (5.8)."""
DESIRED = ("reference_x", "reference_y")
"""Where the ball shall be, in plate axes."""
AGE = "contact_age"

UNITS = {
    "x": "m",
    "x_rate": "m/s",
    "phi": "rad",
    "phi_rate": "rad/s",
    "y": "m",
    "y_rate": "m/s",
    "theta": "rad",
    "theta_rate": "rad/s",
    "phi_acc": "rad/s^2",
    "theta_acc": "rad/s^2",
    "reference_x": "m",
    "reference_y": "m",
    AGE: "1",
}
"""Unit of each input and output, and of the states of ball and plate."""


def state_space(
    system: System,
    inputs: Sequence[str],
    outputs: Sequence[str],
    name: str,
    states: Sequence[str] | None = None,
) -> control.StateSpace:
    """A linear system with named signals; ``states`` are numbered where they have no names."""
    import control

    A, B, C, D, period = system
    named = {} if states is None else {"states": list(states)}
    # a gain alone goes with systems of any period
    time = {} if len(A) == 0 else {"dt": period}
    return control.ss(
        A, B, C, D, inputs=list(inputs), outputs=list(outputs), name=name, **time, **named
    )
