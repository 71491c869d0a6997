#!/usr/bin/env bash
# python-control 0.10.2, input_output_response of a nonlinear system in continuous time that is at rest.
# Guess: inputs are given at each time step, so a push of 20 ms, 10 steps, acts, as in forced_response. Its page
#   warns that results for discontinuous inputs can be wrong, and advises LSODA, a smaller rtol or max_step.
# Seen: the output is exactly 0, with RK45 and with LSODA, and with an rtol of 1e-9: at rest nothing changes, the
#   step of the solver grows to seconds and jumps over the push. A push in the first step is seen. No warning.
# Do: solve_ivp_kwargs={"max_step": the time step} whenever an input is shorter than the time before it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet control==0.10.2 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PY'
import control
import numpy as np

STEP, BEGIN, STEPS, FORCE = 0.002, 2000, 10, 50.0  # s, index, number, N
mass = control.ss([[0, 1], [-4, -2]], [[0], [1]], [[1, 0]], 0)  # 1 kg held by a spring and a damper
same = control.nlsys(
    lambda t, x, u, params: [x[1], -4 * x[0] - 2 * x[1] + u[0]], lambda t, x, u, params: x[0],
    states=2, inputs=1, outputs=1,
)  # fmt: skip
t = np.arange(4000) * STEP
push = np.zeros(len(t))
push[BEGIN : BEGIN + STEPS] = FORCE


def peak(u, **options):
    return float(np.abs(control.input_output_response(same, t, u, [0, 0], **options).outputs).max())


true = float(np.abs(control.forced_response(mass, t, push).outputs).max())
missed = {
    "RK45": peak(push),
    "LSODA": peak(push, solve_ivp_method="LSODA"),
    "RK45, rtol 1e-9": peak(push, solve_ivp_kwargs={"rtol": 1e-9}),
}
seen = peak(push, solve_ivp_kwargs={"max_step": STEP})
first = peak(np.roll(push, -BEGIN))
print("control", control.__version__)
print(f"forced_response: the push moves the mass by {true:.4f} m")
for name, found in missed.items():
    print(f"input_output_response, {name}: {found:.4f} m")
print(f"input_output_response, max_step: {seen:.4f} m; the same push in the first step: {first:.4f} m")
assert set(missed.values()) == {0.0}
assert true > 0.2 and abs(seen - true) < 1e-3 * true and abs(first - true) < 0.2 * true
PY
