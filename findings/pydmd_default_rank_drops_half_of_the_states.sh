#!/usr/bin/env bash
# PyDMD 2025.8.1, DMD and DMDc with the default svd_rank=0.
# Guess: 0 stands for the optimal rank, as its page says: without noise that is the number of states, so that DMD of a
#   linear system gives its eigenvalues, and DMDc its input matrix, to the last digits, as with svd_rank=-1.
# Seen: singular values below 1.43 times their median, or more, are dropped, and so at least half of all, always: it is
#   a rule for many states with noise. Of two undamped oscillations of amplitudes 1 and 0.2 that four states measure
#   without noise the second is lost; of a position and a velocity with an input one state is kept. A warning comes only
#   where all would be dropped.
# Do: svd_rank=-1, or the number of states.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pydmd==2025.8.1 numpy==2.3.5 scipy==1.17.1
env/bin/python - <<'PY'
import warnings
from importlib.metadata import version

import numpy as np

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of imports alone
    from pydmd import DMD, DMDc

AMPLITUDES, FREQUENCIES, SAMPLES = (1.0, 0.2), (0.3, 0.7), 200  # 1, rad per sample
angles = np.outer(FREQUENCIES, np.arange(SAMPLES))
states = np.vstack([amplitude * np.array([np.cos(a), np.sin(a)]) for amplitude, a in zip(AMPLITUDES, angles)])
mixing, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))
measured = mixing @ states


def oscillations(rank):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = DMD(svd_rank=rank).fit(measured)
        error = np.linalg.norm(model.reconstructed_data - measured) / np.linalg.norm(measured)
    return np.sort(np.angle(model.eigs)), float(error)


print("PyDMD", version("pydmd"))
for rank in (0, -1):
    found, error = oscillations(rank)
    print(f"svd_rank={rank}: {found.round(4)} rad per sample, error of the signals {error:.2g}")
(default, default_error), (full, full_error) = oscillations(0), oscillations(-1)
assert len(default) == 2 and abs(default[1] - 0.3) < 0.01 and default_error > 0.19
assert np.allclose(full, [-0.7, -0.3, 0.3, 0.7]) and full_error < 1e-9

A, B = np.array([[1, 0.02], [-0.2, 0.98]]), np.array([[0.0002], [0.02]])  # a position and a velocity at 50 Hz
force = np.random.default_rng(0).standard_normal((1, SAMPLES - 1))
motion = np.zeros((2, SAMPLES))
for n in range(SAMPLES - 1):
    motion[:, n + 1] = A @ motion[:, n] + B @ force[:, n]
models, errors = {}, {}
for rank in (0, -1):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        models[rank] = DMDc(svd_rank=rank).fit(motion, force)
        wrong = models[rank].reconstructed_data() - motion
    errors[rank] = np.linalg.norm(wrong, axis=1) / np.linalg.norm(motion, axis=1)
    print(f"DMDc, svd_rank={rank}: {len(models[rank].eigs)} states, errors of both {errors[rank].round(2)}")
    assert not said
assert len(models[0].eigs) == 1 and errors[0].max() > 0.3
assert len(models[-1].eigs) == 2 and np.allclose(models[-1].B, B) and errors[-1].max() < 1e-9
PY
