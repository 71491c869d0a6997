"""What tests of the view share."""

import subprocess

import pytest
from command_line import ballplate  # noqa: F401  a fixture

from twin.view import viewer


@pytest.fixture(scope="session")
def printed():
    """Everything that is printed of a recording; options of the viewer's `rrd print`."""

    def print_recording(path, *options):
        command = [str(viewer.program()), "rrd", "print", *options, str(path)]
        done = subprocess.run(
            command, capture_output=True, text=True, check=True, env=viewer.environment()
        )
        return done.stdout

    return print_recording
