import pytest
from c_rig import made


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    """One that any even screen's rig can be made of by its parameters."""
    return made(tmp_path_factory.mktemp("fmu"), duration=0.02)
