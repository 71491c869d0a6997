import pytest


@pytest.fixture
def quick(tmp_path):
    """Arguments of ``run`` for a short run that is written to ``tmp_path / "out"``."""
    toml = tmp_path / "quick.toml"
    toml.write_text(
        'title = "quick"\nduration = 0.4\n[plant]\nkind = "lagrange"\n'
        '[controller]\nkind = "lqr"\nrho = 300.0\nkappa = 0.3\n[reference]\nkind = "hold"\n'
    )
    return [str(toml), "--out", str(tmp_path / "out")]
