"""What every test may use."""

import gc

import one_thread  # noqa: F401  before numpy
import pytest
from hypothesis import HealthCheck, settings

from controllers.catalog import forget
from twin.scenario.load import check, put, setting

TABLES = {
    "title": "test",
    "duration": 0.4,
    "plant": {"kind": "lagrange"},
    "controller": {"kind": "lqr", "rho": 300.0, "kappa": 0.3},
    "reference": {"kind": "hold", "x": 0.05, "y": -0.03},
}

pytest_plugins = ["pytester", "real_time_session", "verified_long"]

# Report descriptors as two Lumio panels and a mouse give them to Linux.
FINGER = (
    "a1 02 05 0d 09 42 15 00 25 01 75 01 95 01 81 02 95 03 81 03 09 32 09 47 95 02 81 02 95 02"
    " 81 03 09 51 75 08 95 01 81 02 05 01 26 ff 7f 65 11 55 0e 46 b0 0e 75 10 95 01 09 30 81 02"
    " 09 31 46 c2 0b 81 02 c0 "
)
PANEL_0006 = (
    "05 0d 09 04 a1 01 09 22 "
    + FINGER.replace("05 0d 09 42", "09 42")
    + 3 * FINGER
    + "05 0d 09 54 75 08 95 01 15 00 25 08 81 02 09 55 b1 02 c0"
)
PANEL_0007 = (
    "05 0d 09 04 a1 01 09 22 a1 00 09 42 15 00 25 01 75 01 95 01 81 02 95 03 81 03 09 32 09 47"
    " 95 02 81 02 95 0a 81 03 05 01 26 ff 7f 65 11 55 0e 46 ba 0e 75 10 95 01 09 30 81 02 09 31"
    " 46 ea 0b 81 02 05 0d 09 51 75 10 95 01 81 02 09 55 15 00 25 08 75 08 95 01 b1 02 c0 c0"
)
MOUSE = (
    "05 01 09 02 a1 01 09 01 a1 00 05 09 19 01 29 03 15 00 25 01 95 03 75 01 81 02 95 01 75 05"
    " 81 03 05 01 09 30 09 31 15 81 25 7f 75 08 95 02 81 06 c0 c0"
)


# How fast a busy machine answers is no property of the code.
settings.register_profile("twin", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("twin")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Nothing is thrown away while tests are collected: there is nothing to look for."""
    gc.disable()
    found = yield
    gc.enable()
    return found


@pytest.fixture(autouse=True, scope="module")
def long_lived():
    """What has been imported stays, and the garbage collector need not look at it again.

    Once for each file: code that runs in real time ends with ``gc.unfreeze``.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def descriptors():
    """Report descriptors by what they are of."""
    texts = {"hid-0006": PANEL_0006, "hid-0007": PANEL_0007, "mouse": MOUSE}
    return {name: bytes.fromhex(text) for name, text in texts.items()}


@pytest.fixture(scope="module")
def quick_pictures():
    """Arranging the panels is most of a picture's time."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)
        yield


@pytest.fixture
def take_in(monkeypatch):
    """Takes a law, observer or reference into the catalog."""

    def take(cls):
        monkeypatch.setattr(f"controllers.linear.{cls.__name__}", cls, raising=False)
        forget()

    yield take
    forget()


@pytest.fixture
def scenario():
    """A short scenario on the exact plant, changed by overrides."""

    def make(*overrides):
        return check(put(TABLES, map(setting, overrides)), "test")

    return make
