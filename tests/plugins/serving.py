"""An emulated bus served in a thread, as the emulator's own process does it, and its host."""

from contextlib import contextmanager
from threading import Thread

from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.akd.servos import AkdServos


@contextmanager
def serving(server):
    thread = Thread(target=server.run, name="emulated CAN", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()


@contextmanager
def servos_on(bus):
    """Servos on a bus that are patient, because the machine that runs the tests may be busy."""
    watch = MonitorConfig(stale=50, unsteady=51)
    servos = AkdServos(AkdConfig(bus=bus, silence=0.5, answer=5.0, watch=watch))
    try:
        yield servos
    finally:
        servos.stop()
