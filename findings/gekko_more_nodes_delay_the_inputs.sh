#!/usr/bin/env bash
# GEKKO 1.3.3, IMODE 4 to 7 on this computer (remote=False): simulation, estimation and control of a model in time.
# Guess: with m.options.NODES, the number of collocation points in each step, only the accuracy changes. By its page it
#   is 3 by default, and an input is held (MV_TYPE 0); so the input at a time acts from there to the next.
# Seen: NODES is 2, which is Euler's backward rule: exp(-5 t) over 1 s in 10 steps ends at 0.0173 in place of 0.0067.
#   With 2 nodes an input acts in the step that ends at its time, with 3 and 5 in the step that begins there, with 4
#   and 6 partly in both. So more nodes delay every command by a step: an integrator with a pulse at 1 s is
#   1 at 1 s with 2 nodes and 0 with 3. No warning.
# Do: set NODES yourself, 3 for a held input; give the inputs of 2 nodes one place later.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet gekko==1.3.3 numpy==2.4.6
env/bin/python - <<'PY'
import gekko
import numpy as np

PULSE = [0, 1, 0, 0]


def simulated(times, start, slope, mode, nodes=None):
    """The state at the times, of dx/dt = slope(model, x), and the number of nodes after the solution."""
    model = gekko.GEKKO(remote=False)
    model.time = times
    x = model.Var(start)
    model.Equation(x.dt() == slope(model, x))
    model.options.IMODE = mode
    if nodes:
        model.options.NODES = nodes
    model.solve(disp=False)
    return list(x.value), model.options.NODES


decay, nodes = simulated(np.linspace(0, 1, 11), 1, lambda model, x: -5 * x, 4)
print("GEKKO", gekko.__version__)
print(f"default: {nodes} nodes, exp(-5) by 10 steps is {decay[-1]:.4f}, exactly {np.exp(-5):.4f}")
assert nodes == 2 and np.isclose(decay[-1], (1 + 0.5) ** -10, rtol=1e-4)
for mode in (4, 5, 6, 7):
    at_1 = {
        count: float(simulated(np.arange(4.0), 0, lambda model, x: model.Param(PULSE), mode, count)[0][1])
        for count in range(2, 7)
    }
    print(f"IMODE {mode}: 1 s after the start, by nodes:", {n: round(x, 4) for n, x in at_1.items()})
    assert np.allclose(list(at_1.values()), [1, 0, 1 / 6, 0, 1 / 15], atol=1e-4)
PY
