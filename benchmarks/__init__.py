"""Measurements of speed, see docs/performance.md; those of ``realtime`` are told in docs/wire.md.

They calculate on one thread of linear algebra, as the command line does: matrices are so small that
a second thread only waits, and what it costs in waiting is measured instead of the work.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
