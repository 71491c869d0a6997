"""Linear algebra on one thread: others only wait, which is what keeps both cores busy with tests.

Matrices here are small; must be imported before numpy is.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
