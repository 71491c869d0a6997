"""Every module is compiled once, not by each process that tests are in or start.

Images of containers set ``PYTHONDONTWRITEBYTECODE``; with it, compiling is most of what a process
of tests does until its first test. Must be imported before other processes begin.
"""

import os
import sys

if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    sys.dont_write_bytecode = False
