#!/usr/bin/env bash
# fastparquet 2026.9.0 and pyarrow 26.0.1, a column of times since the start of a run (timedelta64) in a Parquet file.
# Guess: what one of the two libraries writes, the other reads as the same column.
# Seen: fastparquet writes it as Parquet's time of day: pyarrow gives datetime.time objects, which neither subtract nor
#   plot, and Timedelta only where fastparquet reads; nanoseconds are cut to microseconds. What pyarrow writes,
#   fastparquet reads as whole numbers, 20000000 for 20 ms, without their unit. No warning either way.
# Do: write seconds as numbers; or read a file with the library that wrote it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet fastparquet==2026.9.0 pyarrow==26.0.1 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PY'
import datetime
from importlib.metadata import version

import fastparquet
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

print(*(f"{name} {version(name)}" for name in ("fastparquet", "pyarrow", "pandas")))
times = pd.to_timedelta([0, 20_000_500, 40_000_000], unit="ns")
log = pd.DataFrame({"t": times, "x": [0.0, 1.0, 2.0]})
fastparquet.write("fastparquet.parquet", log)
pq.write_table(pa.Table.from_pandas(log), "pyarrow.parquet")
read = {}
for writer in ("fastparquet", "pyarrow"):
    read[writer, "fastparquet"] = fastparquet.ParquetFile(f"{writer}.parquet").to_pandas().t
    read[writer, "pyarrow"] = pq.read_table(f"{writer}.parquet").to_pandas().t
for (writer, reader), column in read.items():
    print(f"{writer} to {reader}: {column.dtype}, {column[1]!r}")
assert pq.read_schema("fastparquet.parquet").field("t").type == "time64[us]"
assert read["fastparquet", "pyarrow"].tolist() == [datetime.time(0, 0, 0, us) for us in (0, 20_000, 40_000)]
assert read["pyarrow", "fastparquet"].dtype == "int64"
assert read["pyarrow", "fastparquet"].tolist() == [0, 20_000_500, 40_000_000]
assert read["pyarrow", "pyarrow"].tolist() == list(times)
assert read["fastparquet", "fastparquet"].tolist() == [pd.Timedelta(us, "us") for us in (0, 20_000, 40_000)]
PY
