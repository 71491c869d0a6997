#!/usr/bin/env bash
# fmu-manipulation-toolbox 2.0 (fmucontainer), two nodes of FMI-LS-BUS with triggered clocks, connected
#   by their terminals in one container; run with FMPy 0.3.32.
# Guess: in an event each node that sends has its Tx_Data copied to the other's Rx_Data, whatever the
#   order of the FMUs in the container's description.
# Seen: the clock reaches both, the data only the node that the list "fmu" names first: the container
#   reads a clock again after the sender's fmi3UpdateDiscreteStates, where it has become inactive, and
#   skips the Rx_Data of all FMUs that come later. The bus and the nodes of its own test files do
#   not hear each other both ways either. No warning.
# Do: name the receiver first, where one direction is enough, and count the calls of fmi3SetBinary;
#   connect a bus and its nodes in an importer of your own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
command -v gcc >/dev/null || { echo "needs gcc"; exit 1; }
python3 -m venv env
env/bin/pip install --quiet fmu-manipulation-toolbox==2.0 fmpy==0.3.32
bus=extra/org.fmi-standard.fmi-ls-bus
mkdir -p fmu/binaries/x86_64-linux fmu/terminalsAndIcons "fmu/$bus"
cat >fmu/modelDescription.xml <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="node" instantiationToken="node">
  <CoSimulation modelIdentifier="node" hasEventMode="true"
    canHandleVariableCommunicationStepSize="true"/>
  <DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="clocks" valueReference="1" causality="output" variability="discrete"/>
    <Float64 name="bytes" valueReference="2" causality="output" variability="discrete"/>
    <Binary name="Rx_Data" valueReference="3" causality="input" variability="discrete" clocks="5"
      mimeType="application/org.fmi-standard.fmi-ls-bus.can; version=&quot;1.0.0&quot;">
      <Start value=""/>
    </Binary>
    <Binary name="Tx_Data" valueReference="4" causality="output" variability="discrete" clocks="6"
      mimeType="application/org.fmi-standard.fmi-ls-bus.can; version=&quot;1.0.0&quot;"/>
    <Clock name="Rx_Clock" valueReference="5" causality="input" intervalVariability="triggered"/>
    <Clock name="Tx_Clock" valueReference="6" causality="output" intervalVariability="triggered"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1"/>
    <Output valueReference="2"/>
    <Output valueReference="4"/>
    <Output valueReference="6"/>
  </ModelStructure>
</fmiModelDescription>
XML
cat >fmu/terminalsAndIcons/terminalsAndIcons.xml <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0">
  <Terminals>
    <Terminal name="can" terminalKind="org.fmi-ls-bus.network-terminal"
      matchingRule="org.fmi-ls-bus.transceiver">
      <TerminalMemberVariable variableName="Rx_Data" memberName="Rx_Data" variableKind="signal"/>
      <TerminalMemberVariable variableName="Tx_Data" memberName="Tx_Data" variableKind="signal"/>
      <TerminalMemberVariable variableName="Rx_Clock" memberName="Rx_Clock" variableKind="signal"/>
      <TerminalMemberVariable variableName="Tx_Clock" memberName="Tx_Clock" variableKind="signal"/>
    </Terminal>
  </Terminals>
</fmiTerminalsAndIcons>
XML
cat >"fmu/$bus/fmi-ls-manifest.xml" <<'XML'
<?xml version="1.0" encoding="UTF-8"?>
<fmiLayeredStandardManifest xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
  fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-bus" fmi-ls:fmi-ls-version="1.0.0"
  fmi-ls:fmi-ls-description="" isBusSimulationFMU="false"/>
XML
cat >node.c <<'C'
/* A node that sends the operation Wakeup after every step, and counts what it receives. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

enum { TIME, CLOCKS, BYTES, RX_DATA, TX_DATA, RX_CLOCK, TX_CLOCK };
typedef const char *Text;
typedef struct {
    double clocks, bytes;
    bool sends;
} Node;

static const uint8_t WAKE_UP[8] = {0x42, 0, 0, 0, 8};

Text fmi3GetVersion(void) { return "3.0"; }
void *fmi3InstantiateCoSimulation(Text name, Text token, Text path, bool visible, bool logging,
                                  bool events, bool early, const uint32_t *needed, size_t n, void *host,
                                  void *log, void *update) {
    return calloc(1, sizeof(Node));
}
void fmi3FreeInstance(void *it) { free(it); }
int fmi3SetDebugLogging(void *it, bool on, size_t n, const Text *categories) { return 0; }
int fmi3EnterInitializationMode(void *it, bool a, double b, double c, bool d, double e) { return 0; }
int fmi3ExitInitializationMode(void *it) { return 0; }
int fmi3EnterEventMode(void *it) { return 0; }
int fmi3EnterStepMode(void *it) { return 0; }
int fmi3Terminate(void *it) { return 0; }
int fmi3GetFloat64(void *it, const uint32_t *vr, size_t n, double *value, size_t m) {
    Node *node = it;
    for (size_t i = 0; i < n; i++)
        value[i] = vr[i] == CLOCKS ? node->clocks : node->bytes;
    return 0;
}
int fmi3DoStep(void *it, double time, double step, bool first, bool *event, bool *end, bool *early,
               double *last) {
    Node *node = it;
    node->sends = *event = true;
    *end = *early = false;
    *last = time + step;
    return 0;
}
int fmi3GetClock(void *it, const uint32_t *vr, size_t n, bool *value) {
    Node *node = it;
    for (size_t i = 0; i < n; i++)
        value[i] = vr[i] == TX_CLOCK && node->sends;
    return 0;
}
int fmi3SetClock(void *it, const uint32_t *vr, size_t n, const bool *value) {
    Node *node = it;
    node->clocks += value[0];
    return 0;
}
int fmi3GetBinary(void *it, const uint32_t *vr, size_t n, size_t *size, const uint8_t **value,
                  size_t m) {
    size[0] = sizeof WAKE_UP;
    value[0] = WAKE_UP;
    return 0;
}
int fmi3SetBinary(void *it, const uint32_t *vr, size_t n, const size_t *size, const uint8_t **value,
                  size_t m) {
    Node *node = it;
    node->bytes += size[0];
    return 0;
}
int fmi3UpdateDiscreteStates(void *it, bool *a, bool *b, bool *c, bool *d, bool *e, double *time) {
    Node *node = it;
    node->sends = false; /* a clock is active for one event iteration */
    *a = *b = *c = *d = *e = false;
    return 0;
}
C
header=$(env/bin/python -c "import fmpy, os; print(os.path.dirname(fmpy.__file__))")/c-code/fmi3Functions.h
for name in $(sed -n 's/^#define \(fmi3[A-Za-z0-9]*\) *fmi3FullName.*/\1/p' "$header"); do
    grep -q "$name(" node.c || echo "int $name(void) { return 3; }"
done >others.c
gcc -shared -fPIC -o fmu/binaries/x86_64-linux/node.so node.c others.c
for name in a b; do
    (cd fmu && ../env/bin/python -m zipfile -c "../$name.fmu" modelDescription.xml binaries \
        terminalsAndIcons extra)
done
for first in a b; do
    second=$([ "$first" = a ] && echo b || echo a)
    cat >"$first.json" <<JSON
{"name": "$first-first.fmu", "fmu": ["$first.fmu", "$second.fmu"],
 "link": [["a.fmu", "can", "b.fmu", "can"]],
 "output": [["a.fmu", "clocks", "a_clocks"], ["a.fmu", "bytes", "a_bytes"],
            ["b.fmu", "clocks", "b_clocks"], ["b.fmu", "bytes", "b_bytes"]],
 "step_size": 0.1}
JSON
    env/bin/fmucontainer -container "$first.json" -fmi 3 -fmu-directory . >container.txt 2>&1
done
env/bin/python - <<'PY'
import fmpy

for first, second in ("ab", "ba"):
    found = fmpy.simulate_fmu(f"{first}-first.fmu", stop_time=1.0, output_interval=0.1)[-1]
    seen = {name: (int(found[f"{name}_clocks"]), int(found[f"{name}_bytes"])) for name in "ab"}
    print(f"{first} named first, ticks of Rx_Clock and bytes of Rx_Data by node: {seen}")
    assert min(seen[first][0], seen[second][0]) >= 9
    assert seen[first][1] >= 72
    assert seen[second][1] == 0
PY
