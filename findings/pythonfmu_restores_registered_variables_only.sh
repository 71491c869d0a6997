#!/usr/bin/env bash
# pythonfmu 0.7.0, an FMU of FMI 2.0 built with --handle-state; run with FMPy 0.3.32.
# Guess: fmi2GetFMUstate copies the internal state, as FMI 2.0 says and as canGetAndSetFMUstate="true" of the
#   description promises: after fmi2SetFMUstate the same steps give the same outputs.
# Seen: the values of the registered variables are kept and set, no other attribute of the object. A servo goes
#   back to its old angle with its new rate, so that a master that repeats a step gets another result. The
#   build and the run say nothing.
# Do: register all that changes, also as local variables, or write _get_fmu_state and _set_fmu_state.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pythonfmu==0.7.0 fmpy==0.3.32 numpy==2.4.6
servo() {  # a model whose rate is registered if $2 is its line
    cat >"$1.py" <<PY
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class $1(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.command = self.angle = self.rate = 0.0
        self.register_variable(Real("command", causality=Fmi2Causality.input))
        self.register_variable(Real("angle", causality=Fmi2Causality.output))
        $2

    def do_step(self, time, step):
        self.rate += step * (100 * (self.command - self.angle) - 20 * self.rate)
        self.angle += step * self.rate
        return True
PY
    env/bin/python -m pythonfmu build -f "$1.py" --handle-state
}
servo Plain ""
servo Registered 'self.register_variable(Real("rate", causality=Fmi2Causality.local))'
cat >check.py <<'PY'
from importlib.metadata import version
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

STEP = 0.01


def repeated(name):
    """The angle after 15 steps, and again after the last 5 of them are taken back and repeated."""
    description = read_model_description(f"{name}.fmu")
    assert description.coSimulation.canGetAndSetFMUstate
    place = {each.name: [each.valueReference] for each in description.modelVariables}
    unpacked = extract(f"{name}.fmu", str(Path.cwd() / name))
    identifier = description.coSimulation.modelIdentifier
    fmu = FMU2Slave(
        guid=description.guid, unzipDirectory=unpacked, modelIdentifier=identifier, instanceName=name
    )
    fmu.instantiate()
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    fmu.setReal(place["command"], [1.0])
    for k in range(10):
        fmu.doStep(k * STEP, STEP)
    state, angles = fmu.getFMUState(), []
    for _ in range(2):
        for k in range(10, 15):
            fmu.doStep(k * STEP, STEP)
        angles += fmu.getReal(place["angle"])
        fmu.setFMUState(state)
    return angles


print("pythonfmu", version("pythonfmu"))
plain, registered = repeated("Plain"), repeated("Registered")
print("angle in rad, first and repeated:", *(round(each, 6) for each in plain))
print("with the rate registered:        ", *(round(each, 6) for each in registered))
assert registered[0] == registered[1] == plain[0]
assert abs(plain[1] - plain[0]) > 0.01
PY
env/bin/python check.py
