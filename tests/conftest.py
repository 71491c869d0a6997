"""What every test may use, and which may not run beside others."""

import subprocess
import sys

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

NONE = pytest.ExitCode.NO_TESTS_COLLECTED

# How fast a busy machine answers is no property of the code.
settings.register_profile("twin", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("twin")


@pytest.fixture
def scenario():
    """A short scenario on the exact plant, changed by overrides."""

    def make(*overrides):
        return check(override(TABLES, overrides), "test")

    return make


def pytest_collection_modifyitems(config, items):
    """Tests with deadlines by the clock are not for processes that others run beside."""
    if hasattr(config, "workerinput"):
        alone = [item for item in items if item.get_closest_marker("real_time")]
        config.hook.pytest_deselected(items=alone)
        items[:] = [item for item in items if item not in alone]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session, exitstatus):
    """When all other tests are over and their processes gone, they run one by one."""
    yield
    config = session.config
    if config.pluginmanager.hasplugin("dsession") and exitstatus in {0, 1, NONE}:
        marks = f"({config.option.markexpr or 'real_time'}) and real_time"
        again = (*config.invocation_params.args, "-n", "0", "-m", marks)
        command = (sys.executable, "-m", "pytest", *again)
        code = subprocess.call(command, cwd=config.invocation_params.dir)
        session.exitstatus = max({exitstatus, code} - {NONE}, default=NONE)
