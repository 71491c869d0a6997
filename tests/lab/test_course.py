"""`twin.lab`: The page that leads to a course in ten steps does what it shows."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "course-in-ten-steps.md"
STEPS = re.compile(r"^```sh\n(.*?)^```\n+```text\n(.*?)^```", re.DOTALL | re.MULTILINE)
"""Commands of a step, and lines that they print."""


@pytest.mark.long
def test_the_ten_steps_print_what_they_show_in_this_order(tmp_path):
    steps = STEPS.findall(PAGE.read_text(encoding="utf-8"))
    assert len(steps) == 10
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for commands, expected in steps:
        done = subprocess.run(
            ["bash", "-c", commands],
            cwd=tmp_path,
            env={**os.environ, "PATH": programs, "COLUMNS": "200"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        printed = " ".join(done.stdout.replace("│", " ").split())
        assert expected
        for line in expected.splitlines():
            assert " ".join(line.split()) in printed, done.stdout
