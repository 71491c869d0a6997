#!/usr/bin/env bash
# FMI Library as in libcosimpy 0.0.6 (libcosim), the description of an FMU of FMI 2.0.
# Guess: a description that FMPy 0.3.32 validates is read without an error line. FMI 2.0 allows no start
#   value for the variable with causality="independent", which is time.
# Seen: "[error] Start attribute is required for this causality, variability and initial combination",
#   twice, for every FMU that lists time without a start. The FMU is loaded and runs all the same. With
#   a start the line does not come, and FMPy calls the description wrong: none pleases both.
# Do: leave the start out, as the standard has it, and take this line for no fault of the FMU; the log
#   level of libcosim hides it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
command -v gcc >/dev/null || { echo "needs gcc"; exit 1; }
python3 -m venv env
env/bin/pip install --quiet libcosimpy==0.0.6 fmpy==0.3.32
header=$(env/bin/python -c "import fmpy, os; print(os.path.dirname(fmpy.__file__))")/c-code/fmi2Functions.h
{
    echo 'const char *fmi2GetVersion(void) { return "2.0"; }'
    echo 'const char *fmi2GetTypesPlatform(void) { return "default"; }'
    for name in $(sed -n 's/^#define \(fmi2[A-Za-z0-9]*\) *fmi2FullName.*/\1/p' "$header"); do
        case $name in
        fmi2GetVersion | fmi2GetTypesPlatform) ;;
        fmi2Instantiate) echo "void *$name(void) { static int it; return &it; }" ;;
        *) echo "int $name(void) { return 0; }" ;;
        esac
    done
} >plain.c
for start in without with; do
    mkdir -p "$start/binaries/linux64"
    gcc -shared -fPIC -o "$start/binaries/linux64/plain.so" plain.c
    value=$([ "$start" = with ] && echo ' start="0"' || true)
    cat >"$start/modelDescription.xml" <<XML
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="plain" guid="plain">
  <CoSimulation modelIdentifier="plain" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="time" valueReference="0" causality="independent" variability="continuous">
      <Real$value/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>
XML
    (cd "$start" && ../env/bin/python -m zipfile -c "../$start.fmu" modelDescription.xml binaries)
done
cat >load.py <<'PY'
import sys

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimSlave import CosimLocalSlave

log_output_level(CosimLogLevel.WARNING)
execution = CosimExecution.from_step_size(1_000_000)
execution.add_local_slave(CosimLocalSlave(sys.argv[1], "plain"))
assert execution.step()
PY
cat >check.py <<'PY'
import subprocess
import sys

from fmpy.validation import validate_fmu

seen = {}
for start in ("without", "with"):
    done = subprocess.run(
        [sys.executable, "load.py", f"{start}.fmu"], capture_output=True, text=True, check=True
    )
    lines = (done.stdout + done.stderr).splitlines()
    errors = sum("Start attribute is required" in line for line in lines)
    seen[start] = errors, validate_fmu(f"{start}.fmu")
    print(f"{start} start: {errors} error lines of FMI Library, FMPy: {seen[start][1]}")
assert seen["without"] == (2, [])
assert seen["with"][0] == 0
assert "provides a start value" in seen["with"][1][0]
PY
env/bin/python check.py
