"""The rig and its controllers as systems of python-control, for all that it can do with systems.

Plants: ``linear``, ``sampled`` and ``mechanism`` are linear, ``equations`` and ``exact`` are not.
Controllers: ``law`` with the state, ``controller`` with the measurement. All are made of a scenario
and what is changed of it, as runs are, by the same code that runs use.

Signals have the names of a record's columns, so that ``control.interconnect`` joins them; ``UNITS``
has their units. A controller feeds back with its own sign: the loop gain that margins are asked of
is ``-law * plant``. The ``dt`` of a sampled system is the control period in s.

Examples:
    >>> import control
    >>> import ballplate as bp
    >>> plant = bp.systems.linear()  # x' = A x + B u about the level plate
    >>> law = bp.systems.law("circle", controller="lqr")  # u of state and desired position
    >>> desired = ["reference_x", "reference_y"]
    >>> loop = control.interconnect([plant, law], inputs=desired, outputs=["x", "y"])
    >>> print(f"slowest pole {loop.poles().real.max():.2f} 1/s")
    slowest pole -1.79 1/s
    >>> step = control.step_info(loop["x", "reference_x"])
    >>> print(f"settling time {step['SettlingTime']:.1f} s")
    settling time 2.6 s
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from ballplate.changes import Changes, Settings, changes_of, model, scenario_of
from ballplate.rigs import EXACT_PLANT
from controllers.analysis import (
    MEASUREMENT_NAMES,
    System,
    linear_controller,
    measured_late,
    tracking_law,
    whole_periods,
)
from controllers.arrays import Array
from controllers.ballplate import MEASURED_STATES, STATE_NAMES
from controllers.design import sample
from controllers.observers.thesis import Ideal
from twin.base.errors import ScenarioError

if TYPE_CHECKING:
    import control

    from twin.scenario.schema import Scenario
    from twin.sim.plant.interface import BallSpin


__all__ = ["UNITS", "controller", "equations", "exact", "law", "linear", "mechanism", "sampled"]


INPUT_NAMES = ("phi_acc", "theta_acc")
"""Plate accelerations u of (5.8)."""
REFERENCE_NAMES = ("reference_x", "reference_y")
"""Desired position of the ball, in plate axes."""
CONTACT_AGE_NAME = "contact_age"
SPIN_NAME = "spin"
"""Further states: age of the contact, and spin of the ball about the plate's normal."""

UNITS = {
    **dict(zip(STATE_NAMES, 2 * ("m", "m/s", "rad", "rad/s"), strict=True)),
    **dict.fromkeys(INPUT_NAMES, "rad/s^2"),
    **dict.fromkeys(REFERENCE_NAMES, "m"),
    CONTACT_AGE_NAME: "1",
    SPIN_NAME: "rad/s",
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


PLATE_RATE_INDICES = [3, 7]
"""Where the plate's rates stand in the state."""
LEAST_SHARE = 1e-6
"""Share of a period below which a dead time is a whole number of periods."""


def linear(
    scenario: str | Path | None = None, settings: Settings = (), **changes: Unpack[Changes]
) -> control.StateSpace:
    """Ball and plate about the level plate with the ball on the centre, (5.35), continuous.

    Inputs ``phi_acc``, ``theta_acc`` in rad/s^2; outputs are the eight states ``x``, ``x_rate``,
    ``phi``, ``phi_rate``, ``y``, ... in SI units.

    In: the ball's mass, radius and inertia. Out: everything else of a scenario.

    Args:
        scenario: Scenario with the ball; the nominal one by default.
        settings: Changes of that scenario, by dotted keys or as texts ``KEY=VALUE``.
        changes: What is changed of that scenario, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown or out of range.
    """
    A, B, _ = model(scenario, settings, **changes).linear()
    system = System(A, B, np.eye(8), np.zeros((8, 2)))
    return state_space(system, INPUT_NAMES, STATE_NAMES, "linear", STATE_NAMES)


def sampled(
    scenario: str | Path, settings: Settings = (), **changes: Unpack[Changes]
) -> control.StateSpace:
    """The linear plant as a controller meets it: inputs held for a control period, ball seen late.

    Inputs ``phi_acc``, ``theta_acc``; outputs what is measured, ``x``, ``phi``, ``y``, ``theta``.
    The dead time of screen or camera is delay states, ``x`` and ``y`` of one period ago, two, and
    so on (``x_1``, ``y_1``, ``x_2``, ...); a fraction of a period is interpolated between the last
    two. ``dt`` is ``rig.period``.

    In: the ball, ``rig.period``, ``sensors.touch.dead_time``. Out: everything else of the scenario.

    Args and errors are those of ``linear``, but a scenario must be named.
    """
    chosen = scenario_of(scenario, changes_of(settings, changes))
    A, B, C = model(scenario, settings, **changes).linear()
    period = chosen.rig.period
    step = System(*sample(A, B, period), C, np.zeros((4, 2)), period)
    return _delay_measurement(step, STATE_NAMES, chosen, "sampled")


def mechanism(
    scenario: str | Path, settings: Settings = (), **changes: Unpack[Changes]
) -> control.StateSpace:
    """The mechanism about the level plate, from the engine's finite differences: it vibrates.

    Inputs, outputs and delay states are those of ``sampled``, so that one can take the place of the
    other. A period of plate acceleration changes the commanded plate rate (states
    ``commanded_phi_rate``, ``commanded_theta_rate``); through the cams' ratio at level that is the
    motor rate, which servos, cams, wheels and plate follow with their own states:
    ``motor_phi``, ``motor_phi_rate``, ``motor_theta``, ``motor_theta_rate``, the servos' set points
    ``servo_phi``, ``servo_theta`` in rad, and the ball's own turning ``ball_turn_x``,
    ``ball_turn_y`` in rad/s.

    In: ``plant``'s ball, wheels, spring or linkage, servos' limits and plate;
    ``plant.step``, ``rig.period``, ``sensors.touch.dead_time``. Out: friction of ball and joints,
    surface and camber, a tilted base, what drives and sensors do besides, limits, and that the rig
    compares its plate angle with the encoders every 20 ms.

    Args and errors are those of ``linear``, but a scenario must be named, and a ball that is oval
    or out of balance is refused: its attitude would have to be states, too.
    """
    from twin.run.plants import parts_of
    from twin.sim.calibration import MECHANISM_STATES as MOVING
    from twin.sim.calibration import linear_mechanism

    chosen = scenario_of(scenario, changes_of(settings, changes))
    parts, period = parts_of(chosen), chosen.rig.period
    A, B, step, ratio = linear_mechanism(parts, chosen.plant.step)
    A, B = _over(round(period / step), A, ratio * B)
    n = len(A)
    # the rate that is commanded in a period is the one before and a period of acceleration
    A = np.block([[A, B], [np.zeros((2, n)), np.eye(2)]])
    B = period * np.concatenate((B, np.eye(2)))
    C = np.eye(n + 2)[list(MEASURED_STATES)]
    states = (*MOVING, "commanded_phi_rate", "commanded_theta_rate")
    system = System(A, B, C, np.zeros((4, 2)), period)
    return _delay_measurement(system, states, chosen, "mechanism")


def equations(
    scenario: str | Path | None = None,
    settings: Settings = (),
    *,
    spin: bool = False,
    **changes: Unpack[Changes],
) -> control.NonlinearIOSystem:
    """The exact equations of the rolling ball in continuous time, x' = f(x) + g(x) u.

    Inputs ``phi_acc``, ``theta_acc`` in rad/s^2; states and outputs ``x``, ``x_rate``, ``phi``,
    ``phi_rate``, ``y``, ... in SI units. The ball's spin about the plate's normal is locked to the
    plate, or with ``spin`` free and a ninth state, ``spin`` in rad/s, seen from the base. With
    ``plant.ball_spin = "thesis"`` the equations are (5.9).

    In: the ball's mass, radius and inertia, the plate's height, and ``plant.ball_spin``. Out:
    everything else of a scenario. Friction is left out because at rest it is no differential
    equation: the force of friction there depends on the other forces, and a solver with variable
    steps gets stuck at that point. ``exact`` has it.

    At rest the solver of ``control.input_output_response`` takes steps of seconds and jumps over a
    shorter input: pass it ``solve_ivp_kwargs={"max_step": 0.002}``, the sampling time of the input.

    Args and errors as in ``linear``; ``spin`` needs a scenario with a freely spinning ball.
    """
    import control

    from twin.sim.plant.exact import RollingModel, rolling

    ball = model(scenario, settings, **changes)
    chosen: BallSpin = "free"
    if scenario is not None:
        chosen = scenario_of(scenario, changes_of(settings, changes)).plant.ball_spin
    about = RollingModel.of(ball, without_state(chosen, spin=spin))
    gravity, states = (0.0, 0.0, -ball.gravity), (*STATE_NAMES, *([SPIN_NAME] if spin else []))
    scale = about.share * ball.radius

    def update(t: float, x: Array, u: Array, params: Any) -> Array:
        angles = x[2:8:4]
        at = rolling(about, np.sin(angles), np.cos(angles), x[3:8:4], u, gravity)
        ax, ay = at.free(x[0], x[1], x[4], x[5], scale * x[8] if spin else 0.0)
        rates = [x[1], ax, x[3], u[0], x[5], ay, x[7], u[1]]
        return np.array(rates + ([-(at.hx * x[1] + at.hy * x[5]) / scale] if spin else []))

    return control.nlsys(
        update, None, inputs=list(INPUT_NAMES), outputs=list(states), states=list(states),
        name="equations",
    )  # fmt: skip


def without_state(ball_spin: BallSpin, *, spin: bool) -> BallSpin:
    """Terms of the spin in equations in which it is a state or not.

    Args:
        ball_spin: As in a scenario.
        spin: Whether it is to be a state.

    Raises:
        ScenarioError: If it is to be a state and is not free.
    """
    if spin and ball_spin != "free":
        raise ScenarioError(f"spin: needs plant.ball_spin 'free', got {ball_spin!r}")
    return "locked" if ball_spin == "free" and not spin else ball_spin


def exact(
    scenario: str | Path, settings: Settings = (), **changes: Unpack[Changes]
) -> control.NonlinearIOSystem:
    """The plant ``lagrange`` of runs, from one control period to the next.

    Inputs ``phi_acc``, ``theta_acc`` in rad/s^2, held for a period; states and outputs ``x``,
    ``x_rate``, ``phi``, ``phi_rate``, ``y``, ... in SI units, at its beginning. ``dt`` is
    ``rig.period``; within, the plant goes by its own physics steps. Where friction builds up at
    rest (``plant.friction.dwell_time``), its age is a ninth state, ``contact_age``: 1 of a ball
    that has rested long. Where the ball spins freely (``plant.ball_spin``), the last state is its
    ``spin`` about the plate's normal, rad/s, seen from the base.

    In: the ball and its spin, all of ``plant.friction``, the surface, a tilted base, ``plant.step``
    and ``rig.period``. Out: linkage, drives, limits, sensors, where the ball starts, and the edge
    of the screen.

    Args and errors are those of ``linear``, but a scenario must be named.
    """
    import control

    from twin.run.plants import build_plant
    from twin.sim.plant.exact import ExactPlant

    chosen = scenario_of(scenario, [*changes_of(settings, changes), *changes_of(EXACT_PLANT, {})])
    plant, _ = build_plant([chosen])
    assert isinstance(plant, ExactPlant)
    plant.linkage = None
    period, steps = chosen.rig.period, round(chosen.rig.period / plant.step)
    ageing, spinning = plant.age is not None, plant.ball_spin == "free"
    states = (
        *STATE_NAMES,
        *([CONTACT_AGE_NAME] if ageing else []),
        *([SPIN_NAME] if spinning else []),
    )

    def update(t: float, x: Array, u: Array, params: Any) -> Array:
        plant.resume(x[np.newaxis, :8], x[8:9] if ageing else None, x[-1:] if spinning else None)
        plant.advance(x[np.newaxis, PLATE_RATE_INDICES] + period * u, steps)
        age = plant.age if ageing else None
        further = [each for each in (age, plant.spin if spinning else None) if each is not None]
        return np.concatenate((plant.state[0], *further))

    inputs, outputs = list(INPUT_NAMES), list(states)
    return control.nlsys(
        update, None, inputs=inputs, outputs=outputs, states=outputs, dt=period, name="exact"
    )


def _over(steps: int, A: Array, B: Array) -> tuple[Array, Array]:
    """A system over a number of its steps, its input held."""
    n, m = B.shape
    one = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
    whole = np.linalg.matrix_power(one, steps)
    return whole[:n, :n], whole[:n, n:]


def _delay_measurement(
    plant: System, states: tuple[str, ...], scenario: Scenario, name: str
) -> control.StateSpace:
    """A sampled plant with a ball that is measured a scenario's dead time late."""
    dead_time = float(np.max(scenario.sensors.touch.dead_time))
    late = measured_late(plant, dead_time)
    _, share = whole_periods(dead_time, scenario.rig.period)
    if share < LEAST_SHARE:
        # nothing looks at the register's last place
        late = System(late.A[:-2, :-2], late.B[:-2], late.C[:, :-2], late.D, late.period)
    kept = (len(late.A) - len(plant.A)) // 2
    delays = [f"{axis}_{back + 1}" for back in range(kept) for axis in ("x", "y")]
    return state_space(late, INPUT_NAMES, MEASUREMENT_NAMES, name, (*states, *delays))


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
    from twin.run.controller_building import build_law

    chosen = build_law(scenario_of(scenario, changes_of(settings, changes)))
    try:
        system = tracking_law(chosen)
    except ValueError as error:
        raise ScenarioError(f"controller: {error}") from error
    return state_space(system, (*STATE_NAMES, *REFERENCE_NAMES), INPUT_NAMES, "law")


def controller(
    scenario: str | Path, settings: Settings = (), **changes: Unpack[Changes]
) -> control.StateSpace:
    """Law, observer and predictor of a scenario as they run, once a control period.

    Inputs are what is measured, ``x``, ``phi``, ``y``, ``theta`` in m and rad; outputs ``phi_acc``,
    ``theta_acc`` in rad/s^2. The reference is rest on the centre. ``dt`` is ``rig.period``. An
    observer with a varying gain has its initial gain.

    Args and errors are those of ``law``; an observer that cannot be linearised or is given the true
    state is refused as well.
    """
    from twin.run.controller_building import build_controller

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
    return state_space(system, MEASUREMENT_NAMES, INPUT_NAMES, "controller")
