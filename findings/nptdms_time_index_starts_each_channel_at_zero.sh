#!/usr/bin/env bash
# npTDMS 1.13.0, TdmsFile.as_dataframe(time_index=True) of waveforms that begin at different times.
# Guess: one index of seconds since the start of the file, so that what was measured at once stands in one row.
# Seen: each channel counts from its own start (wf_start_time): a camera that begins 2.3 s after the servo has its first
#   image in the row of the servo's first command. An identification from these rows finds a dead time that is 2.3 s
#   short. absolute_time=True has the right rows. No warning.
# Do: log = file.as_dataframe(time_index=True, absolute_time=True); log.index -= log.index[0].
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet npTDMS==1.13.0 pandas==3.1.1 numpy==2.4.6
env/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

START, LATER_MS, STEP, COUNT = np.datetime64("2026-11-30T10:00:00"), 2300, 0.02, 400  # STEP in s


def waveform(name, since_ms):
    """A channel whose numbers are the seconds since START at which they are sampled."""
    times = 1e-3 * since_ms + STEP * np.arange(COUNT)
    begin = START + np.timedelta64(since_ms, "ms")
    how = {"wf_start_time": begin, "wf_start_offset": 0.0, "wf_increment": STEP, "wf_samples": COUNT}
    return ChannelObject("rig", name, times, how)


with TdmsWriter("log.tdms") as writer:
    writer.write_segment([waveform("servo", 0), waveform("ball", LATER_MS)])
with TdmsFile.open("log.tdms") as file:
    relative = file.as_dataframe(time_index=True)
    absolute = file.as_dataframe(time_index=True, absolute_time=True)
print("npTDMS", version("npTDMS"))
for kind, log in (("relative", relative), ("absolute", absolute)):
    apart = (log["/'rig'/'ball'"] - log["/'rig'/'servo'"]).dropna()
    print(f"{kind}: {len(log)} rows; in one row the ball is sampled {apart.mean():.2f} s after the servo")
    assert np.allclose(apart, 1e-3 * LATER_MS if kind == "relative" else 0.0, atol=1e-6)
assert len(relative) == COUNT and len(absolute) >= COUNT + round(1e-3 * LATER_MS / STEP)
PY
