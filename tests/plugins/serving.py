"""An emulated bus served in a thread, as the emulator's own process does it."""

from contextlib import contextmanager
from threading import Thread


@contextmanager
def serving(server):
    thread = Thread(target=server.run, name="emulated CAN", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
