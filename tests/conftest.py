"""What every test may use, and who may run beside whom."""

import fcntl
from contextlib import contextmanager

import pytest
from hypothesis import HealthCheck, settings

from twin.scenario.load import check, override

TABLES = {
    "title": "test",
    "duration": 0.4,
    "plant": {"kind": "lagrange"},
    "controller": {"kind": "lqr", "rho": 300.0, "kappa": 0.3},
    "reference": {"kind": "hold", "x": 0.05, "y": -0.03},
}

# How fast a busy machine answers is no property of the code.
settings.register_profile("twin", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("twin")


@pytest.fixture
def scenario():
    """A short scenario on the exact plant, changed by overrides."""

    def make(*overrides):
        return check(override(TABLES, overrides), "test")

    return make


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """A test with deadlines by the clock runs while the other processes' tests wait."""
    alone = item.get_closest_marker("real_time") is not None
    with turn(item.config.cache.mkdir("turns"), alone):
        return (yield)


@contextmanager
def turn(locks, alone):
    """Alone or beside others; who waits to be alone is next."""
    with (locks / "gate").open("w") as gate, (locks / "turn").open("w") as place:
        fcntl.flock(gate, fcntl.LOCK_EX)
        fcntl.flock(place, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(gate, fcntl.LOCK_UN)
        yield
        fcntl.flock(place, fcntl.LOCK_UN)  # at once, whatever the test has forked
