"""What every test may use."""

import gc
import os
from functools import cache

import bytecode  # noqa: F401  before all that is compiled
import one_thread  # noqa: F401  before numpy
import pytest
from hypothesis import HealthCheck, settings
from markupsafe import Markup

from controllers import catalog
from controllers.catalog import forget
from twin.base.data_file import read_packaged
from twin.devices import kinds
from twin.scenario.load import check
from twin.scenario.merging import put, setting

TABLES = {
    "title": "test",
    "duration": 0.4,
    "plant": {"kind": "lagrange"},
    "controller": {"kind": "lqr", "rho": 300.0, "kappa": 0.3},
    "reference": {"kind": "hold", "x": 0.05, "y": -0.03},
}

pytest_plugins = ["pytester", "real_time_session", "long_tests"]

# The report descriptor that a mouse gives Linux.
MOUSE = (
    "05 01 09 02 a1 01 09 01 a1 00 05 09 19 01 29 03 15 00 25 01 95 03 75 01 81 02 95 01 75 05"
    " 81 03 05 01 09 30 09 31 15 81 25 7f 75 08 95 02 81 06 c0 c0"
)


def pytest_configure(config):
    """Short tests try a property with fewer examples than the long ones try the same."""
    # how fast a busy machine answers is no property of the code
    patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
    short = settings(patient, max_examples=25)
    settings.register_profile("twin", patient if config.option.markexpr == "long" else short)
    settings.load_profile("twin")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Nothing is thrown away while tests are collected: there is nothing to look for.

    Nor often afterwards: a test leaves little behind, and looking for it took a twentieth of all.
    """
    gc.disable()
    found = yield
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)
    gc.enable()
    return found


@pytest.fixture(autouse=True, scope="session")
def own_state(tmp_path_factory):
    """What commands remember is not kept among the files of whoever tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(autouse=True, scope="module")
def long_lived():
    """What has been imported stays, and the garbage collector need not look at it again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def kept_frozen():
    """Code that runs in real time ends with ``gc.unfreeze`` and begins with a whole collection.

    In its own process that is quick; here it would look through what all tests have imported.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gc, "unfreeze", lambda: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def installed_once():
    """What is installed stays so; to look for it is most of what the catalog takes to be made."""
    with pytest.MonkeyPatch.context() as patch:
        found = cache(catalog.entry_points)
        for each in (catalog, kinds):
            patch.setattr(each, "entry_points", found)
        yield


@pytest.fixture(autouse=True)
def no_law_stays():
    """A law's file that a test takes in does not stay in the environment of the next test."""
    before = os.environ.get(catalog.ADDED_FILES_VARIABLE)
    yield
    if os.environ.get(catalog.ADDED_FILES_VARIABLE) != before:
        os.environ.pop(catalog.ADDED_FILES_VARIABLE, None)
        if before is not None:
            os.environ[catalog.ADDED_FILES_VARIABLE] = before
        forget()


@pytest.fixture(scope="session")
def descriptors():
    """Report descriptors by what they are of."""
    panels = read_packaged("twin.devices.lumio", "panels.toml")["descriptors"]
    texts = {**panels, "mouse": MOUSE}
    return {name: bytes.fromhex(text) for name, text in texts.items()}


@pytest.fixture(scope="module")
def quick_pictures():
    """Arranging the panels is most of a picture's time."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ConstrainedLayoutEngine, "execute", lambda *_: None)
        yield


@pytest.fixture(scope="module")
def no_pictures():
    """Nobody looks at the pictures kept with a run or in a page: they take longer than the run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.run.picture.png", lambda *_: b"\x89PNG")
        patch.setattr("twin.base.page.inline", lambda _: Markup("<svg></svg>"))
        yield


@pytest.fixture(scope="module")
def no_footprint():
    """The memory that a controller in C needs is one more compilation, of which a page tells."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.board.source.measure_footprint", lambda *_: None)
        yield


@pytest.fixture
def unlocked(monkeypatch):
    """Real time that neither locks nor looks through the memory of all tests: gigabytes."""
    monkeypatch.setattr("twin.devices.realtime._lock", lambda _: False)
    for name in ("collect", "unfreeze"):
        monkeypatch.setattr(gc, name, lambda: None)


@pytest.fixture
def take_in(monkeypatch):
    """Takes a law, observer or reference into the catalog."""

    def take(cls):
        monkeypatch.setattr(f"controllers.classical.{cls.__name__}", cls, raising=False)
        forget()

    yield take
    forget()


@pytest.fixture(scope="session")
def tables():
    """The tables of a short scenario on the exact plant."""
    return TABLES


@pytest.fixture
def scenario():
    """A short scenario on the exact plant, changed by overrides."""

    def make(*overrides):
        return check(put(TABLES, map(setting, overrides)), "test")

    return make
