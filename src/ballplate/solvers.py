"""Ball and plate as CasADi symbols, with the names and units of a record's columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, Unpack

import numpy as np

from ballplate.changes import Changes, Settings, changes_of, scenario_of
from ballplate.systems import INPUT_NAMES, SPIN_NAME, UNITS, without_state
from controllers.arrays import Array
from controllers.ballplate import MEASURED_STATES, STATE_NAMES, constants
from twin.base.errors import ModelError, ScenarioError
from twin.base.parts import extra
from twin.fmu.export import parameters
from twin.run.controller_building import build_limits
from twin.sim.plant.exact import RollingModel, rolling
from twin.sim.plant.interface import BallSpin, gravity_in_rig

FRICTION_SYMBOLS = "rolling", "breakaway_ratio", "stribeck_speed", "viscous"
SMOOTHING_SPEED_M_S = 0.002
"""Speed in m/s over which friction is smoothed by default."""


class Delayed(NamedTuple):
    """A rig with a ball that is seen n control periods late, and the inputs since then as states.

    Attributes:
        periods: n, dead time in whole control periods, to the nearest.
        names: Of z: the state n periods ago, ``phi_acc_n``, ``theta_acc_n`` of then, and so on.
        F: z after a period, of (z, u, p).
        now: The state now, of (z, p).
        y: What is measured now, of (z, p): the ball of then, the plate of now.
    """

    periods: int
    names: tuple[str, ...]
    F: Any
    now: Any
    y: Any


@dataclass(frozen=True)
class Symbolic:
    """The exact equations of the rolling ball with friction, on a base that may be tilted.

    They are (R5) of ``twin.sim.plant.exact``. The ball's spin about the plate's normal is locked to
    the plate: no screen sees the spin, and on a level plate no input moves it. With
    ``symbolic(..., spin=True)`` it is free, as in runs, and a ninth state; with
    ``plant.ball_spin = "thesis"`` the equations are (5.9).

    Friction is as in runs with one change. There a resting ball starts only when pushed hard
    enough, which is no differential equation; here rolling resistance takes the share
    v / sqrt(v^2 + w^2) of itself at the speed v, w being ``width``: 71 % at w, 98 % at 5 w. So a
    ball never rests on a slope: where the twin's stays, this one creeps, at s w / sqrt(1 - s^2)
    where the slope pushes with the share s of what friction holds. The contact has the settled age
    of its speed: ``dwell_time`` and ``presliding`` are left out, as are drives and mechanism.

    Attributes:
        x: State of ``names["x"]``, (8, 1): x, x_rate, phi, phi_rate, y, y_rate, theta, theta_rate;
            (9, 1) with ``spin``, rad/s, seen from the base.
        u: Plate accelerations phi_acc, theta_acc, held for a period, (2, 1).
        p: Parameters of ``names["p"]`` in SI units, (9, 1): settings that the register of followers
            has as symbols, under keys of ``describe`` without the suffix of their unit.
        xdot: Rate of x, of its shape.
        y: What is measured, x, phi, y, theta, (4, 1), without dead time.
        f: xdot of (x, u, p).
        F: x after a control period of (x, u, p), by RK4.
        names: Of the entries of x, u, p and y.
        units: SI unit by name.
        bounds: Least and largest by name, of what the rig's limits bound.
        nominal: p as a designer of the scenario knows it, shape (9,).
        dead_time: Of the ball's position, as a controller of the scenario assumes it, s.
        period: Control period in s.
        width: Over which friction is smoothed, m/s.

    Examples:
        >>> import ballplate as bp
        >>> model = bp.symbolic("circle")
        >>> model.names["u"], model.units["phi_acc"]
        (('phi_acc', 'theta_acc'), 'rad/s^2')
        >>> model.bounds["x"]
        (-0.25, 0.25)
        >>> model.delayed().periods  # the dead time of the screen, in control periods
        21
    """

    x: Any
    u: Any
    p: Any
    xdot: Any
    y: Any
    f: Any
    F: Any
    names: Mapping[str, tuple[str, ...]]
    units: Mapping[str, str]
    bounds: Mapping[str, tuple[float, float]]
    nominal: Array
    dead_time: float
    period: float
    width: float

    def delayed(self) -> Delayed:
        """The same with the inputs of the dead time as further states."""
        import casadi as ca

        n, m = round(self.dead_time / self.period), len(self.names["x"])
        z = ca.SX.sym("z", m + 2 * n)
        each = [z[m + 2 * i : m + 2 + 2 * i] for i in range(n)] + [self.u]
        then, state = z[:m], z[:m]
        for u in each[:n]:
            state = self.F(state, u, self.p)
        after = ca.vertcat(self.F(then, each[0], self.p), *each[1:])
        seen = ca.vertcat(then[0], state[2], then[4], state[6])
        names = tuple(f"{name}_{i}" for i in range(n, 0, -1) for name in self.names["u"])
        return Delayed(
            n,
            (*self.names["x"], *names),
            ca.Function("F", [z, self.u, self.p], [after], ["z", "u", "p"], ["z_after"]),
            ca.Function("now", [z, self.p], [state], ["z", "p"], ["x"]),
            ca.Function("y", [z, self.p], [seen], ["z", "p"], ["y"]),
        )

    def do_mpc(self, path: Sequence[str] = ()) -> Any:
        """The continuous model of do-mpc, set up; names of p with ``_`` for dots and brackets.

        Args:
            path: Names of the values given anew for every step, as where the ball is to be.
        """
        import casadi as ca
        from do_mpc.model import Model

        model = Model("continuous", "SX")
        each = [
            [model.set_variable(f"_{kind}", re.sub(r"\W+", "_", name)) for name in self.names[kind]]
            for kind in ("x", "u", "p")
        ]
        for name in path:
            model.set_variable("_tvp", name)
        rates = ca.vertsplit(self.f(*(ca.vertcat(*group) for group in each)))
        for name, rate in zip(self.names["x"], rates, strict=True):
            model.set_rhs(name, rate)
        model.setup()
        return model

    def acados(self, name: str = "ballplate") -> Any:
        """The model of acados, explicit and implicit, its parameters those of ``p``."""
        import casadi as ca
        from acados_template import AcadosModel

        model = AcadosModel()
        model.name, model.x, model.u, model.p = name, self.x, self.u, self.p
        model.xdot = ca.SX.sym("xdot", len(self.names["x"]))
        model.f_expl_expr, model.f_impl_expr = self.xdot, model.xdot - self.xdot
        return model


def symbolic(
    scenario: str | Path,
    settings: Settings = (),
    *,
    period: float | None = None,
    width: float = SMOOTHING_SPEED_M_S,
    spin: bool = False,
    **changes: Unpack[Changes],
) -> Symbolic:
    """Ball and plate of a scenario as CasADi symbols (SX), for optimisers; needs ``casadi``.

    Args:
        scenario: A shipped scenario or a TOML file.
        settings: What is changed of it, by dotted keys or as texts ``KEY=VALUE``.
        period: Control period in s; the scenario's law's by default.
        width: Speed in m/s over which friction is smoothed, see ``Symbolic``.
        spin: Whether the ball's spin about the plate's normal is a ninth state.
        changes: What is changed of it, by tables.

    Raises:
        TwinError: If there is no such scenario, a number is out of range, CasADi is lacking, or the
            ball of the scenario has no free spin to be a state.

    Examples:
        >>> import ballplate as bp
        >>> model = bp.symbolic("circle", ["plant.friction.rolling_mm=0"])
        >>> at_rest = [0, 0, 0.01, 0, 0, 0, 0, 0]  # the plate is tilted by phi = 0.01 rad
        >>> rate = model.f(at_rest, [0, 0], model.nominal)
        >>> round(float(rate[1]), 4)  # m/s^2 of the ball along x
        0.0589
    """
    with extra("casadi", "symbolic"):
        import casadi as ca
    chosen = scenario_of(scenario, changes_of(settings, changes))
    period = chosen.law_ticks * chosen.rig.period if period is None else period
    for name, value in (("period", period), ("width", width)):
        if not 0 < value < np.inf:
            raise ScenarioError(f"{name}: must be more than 0, got {value!r}")
    known = {each.name: each for each in parameters(chosen, "symbols")}
    symbols = tuple(known)
    ball, predictor = chosen.designed_on, chosen.predictor
    nominal = {name: each.start for name, each in known.items()}
    nominal |= {f"plant.ball.{name}": getattr(ball, name) for name in ("mass", "radius", "inertia")}
    names = (*STATE_NAMES, SPIN_NAME) if spin else STATE_NAMES
    about = without_state(chosen.plant.ball_spin, spin=spin)
    x, u, p = ca.SX.sym("x", len(names)), ca.SX.sym("u", 2), ca.SX.sym("p", len(symbols))
    symbol_of = dict(zip(symbols, ca.vertsplit(p), strict=True))
    parts = ca.vertsplit(x), ca.vertsplit(u), symbol_of
    xdot = ca.vertcat(*_rates(ca, *parts, ball, width, about))
    for name, symbol in symbol_of.items():
        if not ca.depends_on(xdot, symbol):
            raise ModelError(f"{name}: no equation contains it, so it cannot be a symbol")
    f = ca.Function("f", [x, u, p], [xdot], ["x", "u", "p"], ["xdot"])
    held = ca.vertcat(u, p)
    after = ca.simpleRK(ca.Function("rate", [x, held], [xdot]), 1, 4)(x, held, period)
    limits = build_limits(chosen)
    most = dict(zip(("x", "y"), limits.area, strict=True))
    for axis in ("phi", "theta"):
        most |= {
            axis: limits.angle,
            f"{axis}_rate": limits.rate,
            f"{axis}_acc": limits.acceleration,
        }
    measured = tuple(STATE_NAMES[i] for i in MEASURED_STATES)
    return Symbolic(
        x, u, p, xdot, x[list(MEASURED_STATES)], f,
        ca.Function("F", [x, u, p], [after], ["x", "u", "p"], ["x_after"]),
        {"x": names, "u": INPUT_NAMES, "p": symbols, "y": measured},
        {name: UNITS[name] for name in (*names, *INPUT_NAMES)}
        | {name: each.unit or "1" for name, each in known.items()},
        {name: (-value, value) for name, value in most.items()},
        np.array(list(nominal.values()), float),
        chosen.sensors.touch.dead_time if predictor is None else predictor.delay,
        period, width,
    )  # fmt: skip


def _rates(
    ca: Any,
    x: list[Any],
    u: list[Any],
    p: Mapping[str, Any],
    ball: Any,
    width: float,
    ball_spin: BallSpin,
) -> tuple[Any, ...]:
    """The rate of the state by the equations of ``ExactPlant``, friction smoothed."""
    x1, x2, x3, x4, x5, x6, x7, x8, *spin = x
    mass, radius, inertia = (p[f"plant.ball.{name}"] for name in ("mass", "radius", "inertia"))
    arm, ratio, stribeck, viscous = (p[f"plant.friction.{name}"] for name in FRICTION_SYMBOLS)
    phi, theta = p["plant.level[1]"], p["plant.level[2]"]
    known = SimpleNamespace(**constants(mass, radius, inertia, ball.height))
    model = RollingModel.of(known, ball_spin)
    tilts = (ca.sin(phi), ca.sin(theta)), (ca.cos(phi), ca.cos(theta))
    sines, cosines = (ca.sin(x3), ca.sin(x7)), (ca.cos(x3), ca.cos(x7))
    gravity = gravity_in_rig(*tilts, ball.gravity)
    at = rolling(model, sines, cosines, (x4, x8), u, gravity)
    speed = ca.sqrt(x2 * x2 + x6 * x6 + width * width)
    surplus = 1 / (1 + (x2 * x2 + x6 * x6) / stribeck**2)
    drag = model.c1 / radius * at.normal * (arm * (1 + (ratio - 1) * surplus) / speed + viscous)
    scale = model.share * radius
    x_acc, y_acc = at.free(x1, x2, x5, x6, scale * spin[0] if spin else 0.0)
    spinning = [-(at.hx * x2 + at.hy * x6) / scale] if spin else []
    return x2, x_acc - drag * x2, x4, u[0], x6, y_acc - drag * x6, x8, u[1], *spinning
