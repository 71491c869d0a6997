from functools import partial

import pytest
from command_line import called

from controllers import catalog
from controllers.catalog import ADDED, forget


@pytest.fixture
def ballplate(capsys, tmp_path, monkeypatch):
    """Calls the command line in an empty folder; its code, output and errors."""
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


@pytest.fixture
def own_laws(monkeypatch):
    """What is taken in of one's own laws is forgotten afterwards."""
    monkeypatch.setenv(ADDED, "")
    monkeypatch.setattr(catalog, "_registered", {})
    forget()
    yield
    forget()
