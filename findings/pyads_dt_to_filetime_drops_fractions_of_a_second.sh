#!/usr/bin/env bash
# pyads 3.6.0, filetimes.dt_to_filetime: a datetime as TwinCAT's count of 100 ns since 1601.
# Guess: the inverse of filetime_to_dt to the microsecond, so that stamps of a log keep their order.
# Seen: whole seconds only. 10:00:00.980 becomes 10:00:00: 50 stamps at 50 Hz become one, and a time that is compared with
#   one of the PLC is up to 1 s early. filetime_to_dt has the microseconds. No warning.
# Do: pyads.filetimes.EPOCH_AS_FILETIME + 10 * ((dt - epoch) // timedelta(microseconds=1)), epoch 1970 in UTC.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet pyads==3.6.0
env/bin/python - <<'PY'
from datetime import UTC, datetime, timedelta
from importlib.metadata import version

from pyads.filetimes import EPOCH_AS_FILETIME, dt_to_filetime, filetime_to_dt

MICROSECOND = timedelta(microseconds=1)
begin = datetime(2026, 11, 30, 10, tzinfo=UTC)
stamps = [begin + timedelta(milliseconds=20 * k) for k in range(50)]
counts = [dt_to_filetime(stamp) for stamp in stamps]
back = [filetime_to_dt(count) for count in counts]
print("pyads", version("pyads"))
print(f"{stamps[-1].time()} becomes {back[-1].time()}; {len(stamps)} stamps become {len(set(counts))}")
assert len(set(counts)) == 1
assert back == [begin] * 50
right = [EPOCH_AS_FILETIME + 10 * ((stamp - datetime(1970, 1, 1, tzinfo=UTC)) // MICROSECOND) for stamp in stamps]
assert counts[0] == right[0] and right[-1] - counts[-1] == 9_800_000
assert all(abs(filetime_to_dt(count) - stamp) <= MICROSECOND for count, stamp in zip(right, stamps, strict=True))
PY
