"""Parameter files, as identification writes them and scenarios name them."""

from __future__ import annotations

import pytest

from twin.errors import ScenarioError
from twin.scenario import load


def test_a_parameter_file_may_stand_in_the_scenario_file(tmp_path):
    (tmp_path / "rig.toml").write_text("[plant.friction]\nrolling_mm = 0.3\n", encoding="utf-8")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(
        f'title = "mine"\nduration = 1.0\nparameters = "{tmp_path / "rig.toml"}"\n'
        '[controller]\nkind = "afl"\n[reference]\nkind = "hold"\n'
        "[plant.friction]\nrolling_mm = 0.1\nbreakaway_ratio = 1.5\n",
        encoding="utf-8",
    )
    friction = load(str(scenario)).plant.friction
    assert (friction.rolling_mm, friction.breakaway_ratio) == (0.3, 1.5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "cannot be read: No such file"),
        ("[plant", "not a TOML file"),
        ("[plant.friction]\nrollling_mm = 1\n", "did you mean 'rolling_mm'"),
    ],
)
def test_a_parameter_file_that_is_wrong_is_named_in_one_line(tmp_path, text, says):
    file = tmp_path / "rig.toml"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=says) as caught:
        load("circle", (f"parameters={file}",))
    assert "rig.toml" in str(caught.value)
    assert "\n" not in str(caught.value)
