#!/usr/bin/env bash
# FMPy 0.3.32, simulate_fmu(..., use_event_mode=True) of an FMU of FMI 3.0 for co-simulation.
# Guess: as its documentation says, event mode is used if the FMU supports it. An FMU that declares
#   hasEventMode="false" (the default) is simulated without it.
# Seen: the FMU is instantiated with eventModeUsed = true, and after initialization
#   fmi3UpdateDiscreteStates and fmi3EnterStepMode are called, which FMI 3.0 allows only for FMUs with
#   event mode. An FMU that checks its state refuses, and the simulation ends with an exception: so do
#   containers of fmu-manipulation-toolbox 2.0, whose page on LS-BUS asks for this option.
# Do: pass use_event_mode=read_model_description(fmu).coSimulation.hasEventMode.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
command -v gcc >/dev/null || { echo "needs gcc"; exit 1; }
python3 -m venv env
env/bin/pip install --quiet fmpy==0.3.32
mkdir -p fmu/binaries/x86_64-linux
cat >fmu/modelDescription.xml <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="plain" instantiationToken="plain">
  <CoSimulation modelIdentifier="plain" hasEventMode="false"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Boolean name="asked" valueReference="1" causality="output" initial="calculated"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1"/>
    <InitialUnknown valueReference="1"/>
  </ModelStructure>
</fmiModelDescription>
XML
cat >plain.c <<'C'
/* An FMU without event mode: it refuses the functions that belong to it. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

static bool event_mode_asked;
typedef const char *Text;

Text fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(Text name, Text token, Text path, bool visible, bool logging,
                                  bool events, bool early, const uint32_t *needed, size_t n, void *host,
                                  void *log, void *update) {
    event_mode_asked = events;
    return &event_mode_asked;
}
void fmi3FreeInstance(void *it) {}
int fmi3SetDebugLogging(void *it, bool on, size_t n, const Text *categories) { return 0; }
int fmi3EnterInitializationMode(void *it, bool a, double b, double c, bool d, double e) { return 0; }
int fmi3ExitInitializationMode(void *it) { return 0; }
int fmi3Terminate(void *it) { return 0; }
int fmi3GetFloat64(void *it, const uint32_t *vr, size_t n, double *value, size_t m) { return 0; }
int fmi3GetBoolean(void *it, const uint32_t *vr, size_t n, bool *value, size_t m) {
    value[0] = event_mode_asked;
    return 0;
}
int fmi3DoStep(void *it, double time, double step, bool first, bool *event, bool *end, bool *early,
               double *last) {
    *event = *end = *early = false;
    *last = time + step;
    return 0;
}
int fmi3UpdateDiscreteStates(void *it, bool *a, bool *b, bool *c, bool *d, bool *e, double *time) {
    return 3;
}
int fmi3EnterStepMode(void *it) { return 3; }
C
header=$(env/bin/python -c "import fmpy, os; print(os.path.dirname(fmpy.__file__))")/c-code/fmi3Functions.h
for name in $(sed -n 's/^#define \(fmi3[A-Za-z0-9]*\) *fmi3FullName.*/\1/p' "$header"); do
    grep -q "$name(" plain.c || echo "int $name(void) { return 3; }"
done >others.c
gcc -shared -fPIC -o fmu/binaries/x86_64-linux/plain.so plain.c others.c
(cd fmu && ../env/bin/python -m zipfile -c ../plain.fmu modelDescription.xml binaries)
env/bin/python - <<'PY'
import fmpy

assert not fmpy.read_model_description("plain.fmu").coSimulation.hasEventMode
found = fmpy.simulate_fmu("plain.fmu", stop_time=0.1)
print("FMPy", fmpy.__version__)
print("by default, event mode asked for:", bool(found["asked"][-1]))
assert not found["asked"][-1]
try:
    fmpy.simulate_fmu("plain.fmu", stop_time=0.1, use_event_mode=True)
except fmpy.fmi1.FMICallException as error:
    print("with use_event_mode=True:", error)
    assert "fmi3UpdateDiscreteStates" in str(error)
else:
    raise SystemExit("it ran")
PY
