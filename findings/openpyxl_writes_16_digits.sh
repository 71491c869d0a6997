#!/usr/bin/env bash
# openpyxl 3.1.5, Workbook.save.
# Guess: a float that is written into a workbook is read back as the same float.
# Seen: numbers are written with 16 digits where a double needs up to 17: about a tenth of the times
#   of a clock of 20 ms come back changed in the last bit.
# Do: compare with a tolerance of 1e-15, or keep logs as CSV, Parquet or MAT.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet openpyxl==3.1.5
env/bin/python - <<'PY'
import openpyxl

times = [k * 0.02 for k in range(200)]
book = openpyxl.Workbook()
for time in times:
    book.active.append([time])
book.save("log.xlsx")
found = [cell for (cell,) in openpyxl.load_workbook("log.xlsx").active.iter_rows(values_only=True)]
changed = [(a, b) for a, b in zip(times, found) if a != b]
print("openpyxl", openpyxl.__version__)
print(f"{len(changed)} of {len(times)} numbers changed, as {changed[0][0]!r} to {changed[0][1]!r}")
assert 10 < len(changed) < 50
assert all(abs(a - b) <= 2.3e-16 * max(a, 1) * 2 for a, b in changed)
PY
