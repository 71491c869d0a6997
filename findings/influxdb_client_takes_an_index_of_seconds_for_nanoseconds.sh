#!/usr/bin/env bash
# influxdb-client 1.50.0, rows of a DataFrame whose index is the time in seconds, as a log has it.
# Guess: seconds since 1970, or a refusal of an index that is no time stamp, as Point.time refuses a float.
# Seen: the numbers are cut to whole nanoseconds, whatever they are: 0.00, 0.02, 0.04 s become the one stamp 0. InfluxDB
#   keeps one value for each series and stamp, so 10 s of a log at 50 Hz become 10 points, and a whole log since the start
#   of a run one second after the other. write_precision "s" keeps whole seconds. A float to Point.time raises. No warning.
#   Another way to lose time: Point.time cuts nanoseconds of stamps to microseconds, a DataFrame keeps them.
# Do: df.index = pandas.to_datetime(df.index, unit="s"); nanoseconds as an int to Point.time.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet influxdb-client==1.50.0 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import pandas as pd
from influxdb_client import Point, WritePrecision
from influxdb_client.client.write.dataframe_serializer import DataframeSerializer
from influxdb_client.client.write_api import PointSettings

STAMP = 1796032800123456789  # ns


def stamps(index, precision=WritePrecision.NS):
    """The times of the rows of line protocol that a write sends."""
    log = pd.DataFrame({"x": np.arange(float(len(index)))}, index=index)
    how = PointSettings(), precision
    rows = DataframeSerializer(log, *how, data_frame_measurement_name="rig").serialize()
    return [int(row.rpartition(" ")[2]) for row in rows]


print("influxdb-client", version("influxdb-client"), " pandas", version("pandas"))
seconds = np.arange(500) / 50
sent = stamps(seconds)
print(f"{len(seconds)} rows from 0 to {seconds[-1]} s: {len(set(sent))} stamps, {min(sent)} to {max(sent)} ns")
assert sent == [int(each) for each in seconds] and len(set(sent)) == 10
assert len(set(stamps(seconds, WritePrecision.S))) == 10
assert stamps(pd.to_datetime(seconds, unit="s").as_unit("ns")) == [20_000_000 * k for k in range(500)]
try:
    Point("rig").field("x", 1.0).time(0.02).to_line_protocol()
    refused = False
except ValueError:
    refused = True
print("Point.time(0.02):", "refused" if refused else "taken")
assert refused
stamp = pd.Timestamp(STAMP, tz="UTC")
of_point = Point("rig").field("x", 1.0).time(stamp).to_line_protocol().rpartition(" ")[2]
print(f"stamp {STAMP}: Point {of_point}, DataFrame {stamps([stamp])[0]}")
assert int(of_point) == STAMP // 1000 * 1000
assert stamps(pd.DatetimeIndex([stamp])) == [STAMP]
PY
