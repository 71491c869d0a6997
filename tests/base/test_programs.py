"""`twin.base.programs`: where the programs lie that a process compiles."""

import subprocess
import sys
from pathlib import Path

BUILD = """
from twin.base.programs import build_folder
(build_folder() / "program").touch()
assert build_folder() == build_folder()
print(build_folder())
"""


def test_programs_of_a_process_are_deleted_at_its_end_without_a_warning():
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", BUILD], capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    assert not Path(done.stdout.strip()).exists()
