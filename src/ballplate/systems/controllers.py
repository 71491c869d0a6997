"""The controllers of scenarios, linear about the level plate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ballplate.changes import Changes, Settings, changes_of, scenario_of
from ballplate.systems.signals import DESIRED, INPUTS, state_space
from controllers.analysis import MEASUREMENTS, linear_controller, tracking_law
from controllers.ballplate import STATES
from controllers.observers.linear import Ideal
from twin.errors import ScenarioError

if TYPE_CHECKING:
    import control


def law(
    scenario: str | Path, settings: Settings = (), **changes: Unpack[Changes]
) -> control.StateSpace:
    """The law of a scenario with the true state, continuous: what margins are designed with.

    Inputs are the eight states of ``linear`` and the desired position ``reference_x``,
    ``reference_y`` in m, of which the law believes that it stands still; outputs ``phi_acc``,
    ``theta_acc`` in rad/s^2. LQR and pole placement are u = K (x* - x) as they are, without states,
    other laws their linearisation; integrators are states.

    Args:
        scenario: A shipped scenario or a TOML file.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        changes: What is changed of it, by tables: ``controller={"kind": "lqr", "rho": 100}``.

    Raises:
        TwinError: If there is no such scenario, anything in it is unknown or out of range, or its
            law has no linearisation, as a sliding mode has none.
    """
    from twin.run.assemble import build_law

    chosen = build_law(scenario_of(scenario, changes_of(settings, changes)))
    try:
        system = tracking_law(chosen)
    except ValueError as error:
        raise ScenarioError(f"controller: {error}") from error
    return state_space(system, (*STATES, *DESIRED), INPUTS, "law")


def controller(
    scenario: str | Path, settings: Settings = (), **changes: Unpack[Changes]
) -> control.StateSpace:
    """Law, observer and predictor of a scenario as they run, once a control period.

    Inputs are what is measured, ``x``, ``phi``, ``y``, ``theta`` in m and rad; outputs ``phi_acc``,
    ``theta_acc`` in rad/s^2. The reference is rest on the centre. ``dt`` is ``rig.period``. An
    observer whose gain varies has the one it starts with.

    Args and errors are those of ``law``; an observer that cannot be linearised or is given the true
    state is refused as well.
    """
    from twin.run.assemble import build_controller

    built = build_controller(scenario_of(scenario, changes_of(settings, changes)))
    if isinstance(built.observer, Ideal):
        raise ScenarioError(
            "observer: 'ideal' is given the true state and is no system of the measurement: "
            "systems.law is the law with the true state"
        )
    try:
        system = linear_controller(built.law, built.observer)
    except ValueError as error:
        raise ScenarioError(f"controller: {error}") from error
    return state_space(system, MEASUREMENTS, INPUTS, "controller")
