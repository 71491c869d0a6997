#!/usr/bin/env bash
# do-mpc 5.1.2, MPC.scaling of an input together with set_rterm.
# Guess: as the documentation of scaling says, the objective function takes the unscaled variables: scaling
#   helps the solver and leaves the optimum as it is.
# Seen: a penalty of one's own compares the unscaled input with the scaled previous one, u - u_prev / scaling,
#   and so pulls a steady input to 0: with a scaling of 100 the state comes to rest far from its setpoint. The
#   penalty by a factor, set_rterm(u=1), acts on scaled inputs: 10,000 times weaker. No warning.
# Do: leave the scaling of inputs at 1 with a penalty of one's own; multiply a factor by scaling ** 2.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet do-mpc==5.1.2 casadi==3.8.2 numpy==2.3.5
env/bin/python -W ignore - <<'PY'  # without the warnings of parts that are not installed
import do_mpc
import numpy as np

SETPOINT, STEPS = 50.0, 20


def controlled(scaling, own, factor=1.0):
    """The first command and the last state of x[k+1] = 0.9 x[k] + 0.1 u[k] under MPC."""
    model = do_mpc.model.Model("discrete")
    x, u = (model.set_variable(kind, name) for kind, name in (("_x", "x"), ("_u", "u")))
    model.set_rhs("x", 0.9 * x + 0.1 * u)
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0}
    mpc.set_param(n_horizon=10, t_step=0.1, store_full_solution=False, nlpsol_opts=quiet)
    mpc.set_objective(mterm=(x - SETPOINT) ** 2, lterm=(x - SETPOINT) ** 2)
    if own:
        mpc.set_rterm((model.u["u"] - mpc.u_prev["u"]) ** 2)
    else:
        mpc.set_rterm(u=factor)
    mpc.scaling["_u", "u"] = scaling
    mpc.setup()
    mpc.x0 = state = np.zeros((1, 1))
    mpc.set_initial_guess()
    commands = []
    for _ in range(STEPS):
        commands.append(mpc.make_step(state).item())
        state = 0.9 * state + 0.1 * commands[-1]
    return commands[0], state.item()


print("do-mpc", do_mpc.__version__)
cases = {
    "a penalty of one's own, scaling 1": controlled(1, own=True),
    "a penalty of one's own, scaling 100": controlled(100, own=True),
    "a factor of 1, scaling 1": controlled(1, own=False),
    "a factor of 1, scaling 100": controlled(100, own=False),
    "a factor of 10,000, scaling 100": controlled(100, own=False, factor=1e4),
}
for name, (first, last) in cases.items():
    print(f"{name}: first command {first:.1f}, state after 20 steps {last:.1f} (setpoint {SETPOINT})")
(own, own_scaled, one, one_scaled, corrected) = cases.values()
assert np.allclose(own, one, rtol=1e-3) and np.allclose(corrected, one, rtol=1e-3)
assert abs(own[1] - SETPOINT) < 1 and own_scaled[1] < 25
assert one_scaled[0] > 10 * one[0]
PY
