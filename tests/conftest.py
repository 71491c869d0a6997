"""What every test may use."""

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

pytest_plugins = ["pytester", "real_time_session", "verified_long"]

# How fast a busy machine answers is no property of the code.
settings.register_profile("twin", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("twin")


@pytest.fixture
def scenario():
    """A short scenario on the exact plant, changed by overrides."""

    def make(*overrides):
        return check(override(TABLES, overrides), "test")

    return make
