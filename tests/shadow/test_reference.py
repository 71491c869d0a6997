"""`twin.shadow.reference`: A twin from a reference log judges other logs of the rig."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

import ballplate as bp
from tests.plugins.axis_identified import axis_identification
from twin.cli import main
from twin.identify.parameters import plain_parameter
from twin.identify.verdicts import ParameterVerdict
from twin.shadow.reference import Reference, _with_shown_ball

RIG = ("plant.friction.rolling_mm=0.23", "plant.level_deg=[0.2, -0.1]", "plant.step=0.002")
"""A rig that differs from the usual one."""


def ended(line, capsys):
    with pytest.raises(SystemExit) as end:
        main(line.split())
    return end.value.code, capsys.readouterr()


@pytest.mark.long
def test_a_healthy_log_raises_no_alarm_and_a_changed_level_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    later = 'change=[{at=26, set={"plant.level_deg"=[0.5, -0.1]}}]'
    for name, more in (("first", ["seed=1"]), ("well", ["seed=2"]), ("tilted", ["seed=3", later])):
        done = bp.run("excite", [*RIG, *more], duration=45)
        done.export(f"{name}.csv")
    line = "shadow well.csv tilted.csv --reference first.csv --out out --json"
    code, told = ended(line, capsys)
    found = json.loads(told.out)
    assert code == 1
    rolling = found["reference"]["parameters"][0]
    assert rolling["low"] <= 0.23 <= rolling["high"]
    assert found["logs"]["well"]["alarms"] == []
    first = found["logs"]["tilted"]["alarms"][0]
    assert 26 < first["time"] < 40
    assert first["causes"][0]["name"] == "level"
    assert (tmp_path / "out" / "tilted" / "shadow.html").is_file()
    # without the reference, the twin is of another rig
    assert ended("shadow well.csv --out other --json", capsys)[0] == 1


@pytest.mark.long
def test_of_logs_with_columns_on_their_rig_the_healthy_one_is_healthy(
    tmp_path, monkeypatch, capsys
):
    """A tube with a solid ball, its position and angle in columns of other names."""
    monkeypatch.chdir(tmp_path)
    dusty = 'change=[{at=28, set={"plant.friction.rolling_mm"=0.02}}]'
    for name, more in (("first", ["seed=1"]), ("well", ["seed=2"]), ("dusty", ["seed=3", dusty])):
        done = bp.run("line", ["parameters=tube", *more], duration=45)
        done.to_pandas().reset_index()[["time", "measured_x", "measured_phi", "age"]].set_axis(
            ["t", "X", "tilt", "waited"], axis=1
        ).to_csv(f"{name}.csv", index=False)
    columns = "time=t,measured_x=X:m,measured_phi=tilt:rad,age=waited"
    line = f"shadow well.csv dusty.csv --reference first.csv --on tube --columns {columns} --json"
    code, told = ended(line, capsys)
    found = json.loads(told.out)["logs"]
    assert code == 1
    assert found["well"]["alarms"] == []
    first = found["dusty"]["alarms"][0]
    assert 28 < first["time"] < 40
    assert "rolling friction" in [each["name"] for each in first["causes"]]


MISTAKES = {
    "shadow a.csv b.csv": "b.csv: several logs need --reference LOG0",
    "shadow a.csv one/a.csv --reference b.csv": "one/a.csv: two logs have the same name",
    "shadow a.csv --reference b.csv --learn": "--learn: not allowed with --reference",
    "shadow a.csv --reference no.csv": "log no.csv: not found",
}


@pytest.mark.parametrize("line", MISTAKES)
def test_a_mistake_is_one_line(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one").mkdir()
    for name in ("a.csv", "b.csv", "one/a.csv"):
        (tmp_path / name).write_text("time\n")
    code, told = ended(line, capsys)
    assert code == 2
    (said,) = told.err.splitlines()
    assert said.startswith(f"ballplate: {MISTAKES[line]}")


@pytest.mark.parametrize(
    ("gain", "word", "factor"),
    [
        (6.95, "solid", 5 / 7),
        (5.9, "hollow", 3 / 5),
        (-7.2, "solid", 5 / 7),
        (6.6, "neither", 3 / 5),
        (12.0, "neither", 3 / 5),
    ],
)
def test_the_ball_of_a_reference_is_the_one_its_gain_is_nearest_to(gain, word, factor):
    about = plain_parameter("gain", "rad")
    verdict = ParameterVerdict(
        about=about, name="gain_x", value=gain, low=gain - 0.1, high=gain + 0.1, word="identified"
    )
    found = _with_shown_ball(axis_identification(verdict))
    assert found.factor == pytest.approx(factor)
    assert any(f"taken as {word}" in note for note in found.notes) == (word == "solid")
    assert any("give --ball" in note for note in found.notes) == (word == "neither")
    ball, push = found.ball, 9.81 * factor
    inertia = float(found.settings({"identified"})["plant.ball.inertia"].split("#")[0])
    assert 1 / (1 + inertia / (ball.mass * ball.radius**2)) == pytest.approx(factor, rel=1e-4)
    error = found.settings({"identified"}).get("rig.cam_error_percent", "")
    if 0 < gain < 10:  # tilt per command times the ball's share stays what the log shows
        first = float(error.strip("[").split(",")[0])
        assert push * (1 + first / 100) == pytest.approx(gain, rel=1e-3)
        assert "-0]" not in error.replace("-0.", "")


@pytest.mark.parametrize(
    ("file", "on", "overrides"),
    [
        (Path("p.toml"), "hobby", ("parameters=p.toml",)),
        (None, "hobby", ("parameters=hobby",)),
        (None, "", ()),
    ],
)
def test_what_is_not_identified_is_that_of_the_named_rig(file, on, overrides):
    found = SimpleNamespace(verdicts=(), notes=(), source="log")
    reference = Reference(found, file, on)
    assert reference.overrides == overrides
    assert "identified: nothing" in reference.describe()
