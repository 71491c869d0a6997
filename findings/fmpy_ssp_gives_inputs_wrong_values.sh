#!/usr/bin/env bash
# FMPy 0.3.32, fmpy.ssp.simulation.simulate_ssp of two connected FMUs of FMI 2.0.
# Guess: as in other masters, a connected input has in the first step the value that the output has
#   after initialization, and an input without a connection keeps its start value.
# Seen: in the first step every input is 0. From the second on, an input without a connection gets the
#   values of the connection of the input that is listed before it. No warning. So a controller takes 0
#   for its first measurement, and an observer begins at the wrong place.
# Do: couple the FMUs by FMPy's functions: read the outputs after initialization, set the inputs, step.
#   In an SSP list a connector only for what is connected.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
command -v gcc >/dev/null || { echo "needs gcc"; exit 1; }
python3 -m venv env
env/bin/pip install --quiet fmpy==0.3.32
header=$(env/bin/python -c "import fmpy, os; print(os.path.dirname(fmpy.__file__))")/c-code/fmi2Functions.h
cat >plain.c <<'C'
/* Value references: 0 output, 1 connected input, 2 input without a connection, 3 and 4 what they were
   in the newest step. */
#include <stddef.h>
#include <stdlib.h>

const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
void *fmi2Instantiate(void) {
    double *v = calloc(5, sizeof *v);
    v[0] = 5;
    v[1] = v[2] = 7;
    return v;
}
void fmi2FreeInstance(void *it) { free(it); }
int fmi2SetReal(void *it, const unsigned *vr, size_t n, const double *value) {
    for (size_t i = 0; i < n; i++)
        ((double *)it)[vr[i]] = value[i];
    return 0;
}
int fmi2GetReal(void *it, const unsigned *vr, size_t n, double *value) {
    for (size_t i = 0; i < n; i++)
        value[i] = ((double *)it)[vr[i]];
    return 0;
}
int fmi2DoStep(void *it, double time, double step, int forward) {
    double *v = it;
    v[3] = v[1];
    v[4] = v[2];
    return 0;
}
C
for name in $(sed -n 's/^#define \(fmi2[A-Za-z0-9]*\) *fmi2FullName.*/\1/p' "$header"); do
    grep -q "$name(" plain.c || echo "int $name(void) { return 0; }"
done >others.c
mkdir -p fmu/binaries/linux64 ssp/resources
gcc -shared -fPIC -o fmu/binaries/linux64/plain.so plain.c others.c
cat >fmu/modelDescription.xml <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="plain" guid="plain">
  <CoSimulation modelIdentifier="plain" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="y" valueReference="0" causality="output" initial="exact"><Real start="5"/></ScalarVariable>
    <ScalarVariable name="u" valueReference="1" causality="input"><Real start="7"/></ScalarVariable>
    <ScalarVariable name="open" valueReference="2" causality="input"><Real start="7"/></ScalarVariable>
    <ScalarVariable name="seen_u" valueReference="3" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="seen_open" valueReference="4" causality="output"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="1"/><Unknown index="4"/><Unknown index="5"/></Outputs>
    <InitialUnknowns><Unknown index="4"/><Unknown index="5"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
XML
(cd fmu && ../env/bin/python -m zipfile -c ../ssp/resources/plain.fmu modelDescription.xml binaries)
cat >ssp/SystemStructure.ssd <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<SystemStructureDescription xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" name="pair" version="1.0">
  <System name="pair">
    <Elements>
      <Component name="a" type="application/x-fmu-sharedlibrary" source="resources/plain.fmu">
        <Connectors><Connector name="y" kind="output"><ssc:Real/></Connector></Connectors>
      </Component>
      <Component name="b" type="application/x-fmu-sharedlibrary" source="resources/plain.fmu">
        <Connectors>
          <Connector name="u" kind="input"><ssc:Real/></Connector>
          <Connector name="open" kind="input"><ssc:Real/></Connector>
          <Connector name="seen_u" kind="output"><ssc:Real/></Connector>
          <Connector name="seen_open" kind="output"><ssc:Real/></Connector>
        </Connectors>
      </Component>
    </Elements>
    <Connections>
      <Connection startElement="a" startConnector="y" endElement="b" endConnector="u"/>
    </Connections>
  </System>
</SystemStructureDescription>
XML
(cd ssp && ../env/bin/python -m zipfile -c ../pair.ssp SystemStructure.ssd resources)
env/bin/python - <<'PY'
import fmpy
from fmpy.ssp.simulation import simulate_ssp
from fmpy.validation import validate_fmu

print("FMPy", fmpy.__version__, "says of the FMU:", validate_fmu("ssp/resources/plain.fmu"))
found = simulate_ssp("pair.ssp", stop_time=0.3, step_size=0.1)
for name in ("b.seen_u", "b.seen_open"):
    print(f"{name} in the first steps: {found[name][:3]}")
assert list(found["b.seen_u"][:3]) == [0, 5, 5]
assert list(found["b.seen_open"][:3]) == [0, 5, 5]
PY
