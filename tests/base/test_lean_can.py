"""`twin.base.lean_can`."""

import subprocess
import sys

import pytest

TRIAL = """
import builtins, importlib, sys
from pathlib import Path

import twin.devices.akd.bringup
import twin.emulator.serve
print("asammdf" in sys.modules)

import can
from twin.base.lean_can import load_measurement_files
load_measurement_files()
sent = can.Message(timestamp=1.5, arbitration_id=5, is_extended_id=False, data=b"12345678")
with can.Logger("a.mf4") as writer:
    writer(sent)
with can.LogReader("a.mf4") as reader:
    print([(each.arbitration_id, bytes(each.data)) for each in reader])

for name in [each for each in sys.modules if each.partition(".")[0] in {"asammdf", "can"}]:
    del sys.modules[name]
# one that is quicker to import than to be found
Path("asammdf.py").write_text("import builtins; builtins.asked = True; raise ImportError")
importlib.invalidate_caches()
import can
print(getattr(builtins, "asked", False))
"""


def test_a_process_of_ours_is_without_asammdf_until_a_file_needs_it_and_others_are_not(tmp_path):
    pytest.importorskip("asammdf")
    command = [sys.executable, "-c", TRIAL]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr
    ours, read, anothers = done.stdout.splitlines()
    assert ours == "False"
    assert read == "[(5, b'12345678')]"
    assert anothers == "True"
