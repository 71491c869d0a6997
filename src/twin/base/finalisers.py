"""Finalisers of objects that a library leaves half made, which print what they miss."""

from __future__ import annotations

import gc
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from twin.base.errors import one_line


@contextmanager
def quiet_finalisers() -> Iterator[None]:
    """Keep objects that a broken file left half made from printing an error when they are deleted.

    Raises:
        ValueError: What was raised inside, without the objects that its traceback holds.
    """
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    message = ""
    try:
        yield
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001  asammdf raises whatever its parsing meets
        message = one_line(error)
        traceback.clear_frames(error.__traceback__)
    finally:
        gc.collect()
        sys.unraisablehook = hook
    if message:
        raise ValueError(message)
