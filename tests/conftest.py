import pytest

from twin.scenario.load import check, override

TABLES = {
    "title": "test",
    "duration": 0.4,
    "plant": {"kind": "lagrange"},
    "controller": {"kind": "lqr", "rho": 300.0, "kappa": 0.3},
    "reference": {"kind": "hold", "x": 0.05, "y": -0.03},
}


@pytest.fixture
def scenario():
    """A short scenario on the exact plant, changed by overrides."""

    def make(*overrides):
        return check(override(TABLES, overrides), "test")

    return make
