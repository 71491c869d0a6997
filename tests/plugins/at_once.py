"""Whether a refusal comes at once, on a machine of any speed and load."""

import time


def _processor_seconds(work):
    begin = time.process_time()
    work()
    return time.process_time() - begin


def is_at_once(work, ordinary):
    """Whether a call takes less than 30 times the processor time of an ordinary one.

    Both are measured in one run, up to three times, so that neither the machine's speed nor what
    else it does decides. What grows with the square of an input ten times as long takes 100 times.
    """
    return any(_processor_seconds(work) < 30 * _processor_seconds(ordinary) for _ in range(3))
