"""First module of a process of ``twin.base.jobs``, run by its path to use this installation."""

import sys
from pathlib import Path

# a name would be looked for in the current folder first
sys.path.insert(0, str(Path(__file__).parents[2]))

from twin.base.jobs import settle

del sys.path[0]
settle()
sys.stdout = sys.stderr  # what laws print is no part of a command's result
