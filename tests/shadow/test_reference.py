"""`twin.shadow.reference`: A twin from a reference log judges other logs of the rig."""

import json
import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import ballplate as bp
from controllers.ballplate import BallPlate
from docs.identify_errors import STEP_S, Rig, simulate_log
from tests.plugins.axis_identified import axis_identification
from twin.cli import main
from twin.identify.any_logs import read_any
from twin.identify.logs import read
from twin.identify.parameters import plain_parameter
from twin.identify.report import parameters
from twin.identify.verdicts import ParameterVerdict
from twin.scenario.load import load
from twin.shadow.evidence import gaps
from twin.shadow.follow import median_score
from twin.shadow.learning import MAX_REFERENCE_SCORE, prepare_for
from twin.shadow.reference import (
    Reference,
    _with_doubted_ball,
    _with_shown_ball,
    _with_shown_lever,
    examine_by_reference,
)
from twin.shadow.report import watched_twin

RIG = ("plant.friction.rolling_mm=0.23", "plant.level_deg=[0.2, -0.1]", "plant.step=0.002")
"""A rig that differs from the usual one."""


def differing(found):
    """The parameters by which a log differs from the reference since its first row."""
    return [each for each in found["differences"] if each["significant"]]


def ended(line, capsys):
    with pytest.raises(SystemExit) as end:
        main(line.split())
    return end.value.code, capsys.readouterr()


def alarmed(line, capsys):
    """What a watch that ends with an alarm prints as JSON."""
    code, told = ended(line, capsys)
    assert code == 1
    return json.loads(told.out)


@pytest.mark.long
def test_a_healthy_log_raises_no_alarm_and_a_changed_level_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    later = 'change=[{at=26, set={"plant.level_deg"=[0.5, -0.1]}}]'
    rough = "plant.friction.rolling_mm=0.46"
    logs = {"first": ["seed=1"], "well": ["seed=2"], "tilted": ["seed=3", later], "rough": [rough]}
    for name, more in logs.items():
        done = bp.run("excite", [*RIG, *more], duration=45)
        done.export(f"{name}.csv")
    line = "shadow well.csv tilted.csv rough.csv --reference first.csv --out out --json"
    found = alarmed(line, capsys)
    rolling = found["reference"]["parameters"][0]
    assert rolling["low"] <= 0.23 <= rolling["high"]
    assert found["logs"]["well"]["verdict"] == "healthy"
    assert [differing(found["logs"][name]) for name in ("well", "tilted")] == [[], []]
    (most, *_) = differing(found["logs"]["rough"])
    assert most["name"] == "rolling"
    assert most["reference"] == pytest.approx(0.23e-3, rel=0.05)
    assert most["log"] == pytest.approx(0.46e-3, rel=0.1)
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
    found = alarmed(line, capsys)["logs"]
    assert found["well"]["alarms"] == []
    first = found["dusty"]["alarms"][0]
    assert 28 < first["time"] < 40
    assert "rolling friction" in [each["name"] for each in first["causes"]]


@pytest.mark.long
def test_end_stops_that_nobody_stated_raise_no_alarm(tmp_path, monkeypatch, capsys):
    """A ball between end stops of a rig that no option names, simulated without the twin's code."""
    monkeypatch.chdir(tmp_path)
    rig = Rig(seconds=60.0, stop=0.05, lever=0.05)
    step = 0.05 * (np.arange(round(rig.seconds / STEP_S)) > 32.0 / STEP_S)
    rough = replace(rig, friction=2 * rig.friction)
    for name, seed, each, across in (
        ("first", 11, rig, None),
        ("well", 12, rig, None),
        ("tilted", 12, rig, step),
        ("rough", 13, rough, None),
    ):
        time, _, ball, _, tilt = simulate_log(seed, each, across)
        rows = np.column_stack((time, ball, tilt[np.rint(time / STEP_S).astype(int)]))
        np.savetxt(f"{name}.csv", rows, delimiter=",", header="t,X,tilt", comments="")
    columns = "time=t,measured_x=X:m,measured_phi=tilt:rad"
    line = f"shadow well.csv tilted.csv rough.csv --reference first.csv --columns {columns} --json"
    found = alarmed(line, capsys)["logs"]
    assert found["well"]["verdict"] == "healthy"
    assert [differing(found[name]) for name in ("well", "tilted")] == [[], []]
    (most, *_) = differing(found["rough"])
    assert most["name"] == "rolling"
    assert most["log"] == pytest.approx(2 * most["reference"], rel=0.2)
    assert found["well"]["told_seconds"] > 10
    assert any("ball at a wall" in note for note in found["well"]["notes"])
    first = found["tilted"]["alarms"][0]
    assert 32 < first["time"] < 45
    assert first["causes"][0]["name"] == "level"


@pytest.mark.parametrize(("level", "follows"), [("0.0", True), ("1.0", False)])
def test_a_twin_of_another_rig_does_not_follow_the_reference(level, follows, tmp_path):
    log = tmp_path / "log.csv"
    bp.run("excite", ["seed=4"], duration=12).to_pandas().reset_index().to_csv(log, index=False)
    recorded, belief = watched_twin(read(log), (f"plant.level_deg=[{level}, 0.0]",))
    usable = prepare_for(recorded, belief)
    score = median_score(usable, belief, gaps(recorded, usable.period))
    assert (score < MAX_REFERENCE_SCORE) == follows


ALONE = 0.02 * 5 / 3
"""Lever in m of the thesis's ball at the axis: radius + J / (m r) of a hollow one."""


def with_levers(*intervals):
    """What is made of intervals of the levers along x and y."""
    about = plain_parameter("lever", "rad")
    levers = [
        ParameterVerdict(
            about=about, name=f"lever_{axis}", low=low, high=high, word="not identifiable"
        )
        for axis, (low, high) in zip("xy", intervals, strict=False)
    ]
    return _with_shown_lever(axis_identification(*levers))


@pytest.mark.parametrize(
    ("intervals", "height", "said"),
    [
        ([(0.1, 0.2)], None, ""),  # that of the thesis's rig is among these
        ([(None, None)], None, ""),
        ([(0.05, 0.07)], 0.06 - ALONE, "from the lever of 0.06 m"),
        ([(0.02, 0.03)], 0.0, "the nearest"),
        ([(-0.01, 0.01)], 0.0, "the nearest"),
        ([(0.7, 0.9)], 0.5, "the nearest"),
        ([(0.05, 0.06), (-0.3, 0.9)], 0.055 - ALONE, "from the lever of 0.055 m"),
        ([(-0.3, 0.9), (0.05, 0.06)], 0.055 - ALONE, "from the lever of 0.055 m"),
        ([(0.05, 0.08), (0.07, 0.1)], 0.075 - ALONE, "from the lever of 0.075 m"),
        # 0.055 +- 0.005 and 0.25 +- 0.05 m contradict each other: (100 * 0.055 + 0.25) / 101
        ([(0.05, 0.06), (0.2, 0.3)], 5.75 / 101 - ALONE, "the levers of the axes differ"),
    ],
)
def test_a_reference_shows_how_high_the_ball_is(intervals, height, said):
    """The lever of a ball that rolls: height + radius + J / (m r), here height + 5/3 radius."""
    found = with_levers(*intervals)
    assert found.ball == BallPlate()
    assert found.height == (None if height is None else pytest.approx(height, abs=1e-9))
    assert said in " ".join(found.notes)
    assert len(found.notes) == (height is not None)


def test_the_height_is_written_with_the_other_parameters(tmp_path):
    """So that a file that is named later gives the same twin."""
    file = tmp_path / "parameters.toml"
    found = with_levers((0.05, 0.06))
    file.write_text(parameters(found))
    reference = Reference(found, file, assumed=found.notes)
    assert reference.overrides == (f"parameters={file}",)
    assert "plant.plate.height is taken as 0.0217 m" in reference.describe()
    plant = load("hold", reference.overrides).plant
    assert plant.plate.height == pytest.approx(0.055 - ALONE, abs=1e-6)
    assert plant.ball.radius == 0.02


def test_walls_of_a_reference_are_told():
    found = SimpleNamespace(verdicts=(), notes=(), source="log")
    said = Reference(found, None, ends=((-0.04, math.inf), (-math.inf, math.inf))).describe()
    assert "walls at -40.0 mm along x" in said
    assert "along y" not in said


MISTAKES = {
    "shadow a.csv b.csv": "b.csv: several logs need --reference LOG0",
    "shadow a.csv one/a.csv --reference b.csv": "one/a.csv: two logs have the same name",
    "shadow a.csv --reference b.csv --learn": "--learn: not allowed with --reference",
    "shadow a.csv --reference no.csv": "--reference: log no.csv: not found",
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


COLUMNS = "--columns time=t,measured_x=X,measured_phi=p"


def write_logs(folder):
    """Logs first.csv and well.csv with a ball that a plate moves."""
    time = np.arange(0.0, 12.0, 0.02)
    rows = np.column_stack((time, 0.03 * np.sin(2 * time), -0.02 * np.sin(2 * time)))
    for name in ("first", "well"):
        np.savetxt(folder / f"{name}.csv", rows, delimiter=",", header="t,X,p", comments="")
    return rows


def test_every_log_is_read_once(tmp_path, monkeypatch):
    write_logs(tmp_path)
    files, done = [], []
    for module in ("reference", "report"):
        monkeypatch.setattr(
            f"twin.shadow.{module}.read_any",
            lambda file, *more: files.append(file.name) or read_any(file, *more),
        )
    monkeypatch.setattr("twin.shadow.reference.learn_reference", lambda log, *_, **__: (
        done.append(log.source) or Reference(None, Path("p.toml"))
    ))  # fmt: skip
    monkeypatch.setattr("twin.shadow.reference.learn_twin", lambda *_, **__: None)
    monkeypatch.setattr("twin.shadow.reference.examine_log", lambda log, folder, how, **_: (
        done.append(log.source) or (folder, how)
    ))  # fmt: skip
    _, found = examine_by_reference(
        tmp_path / "first.csv",
        tmp_path,
        {tmp_path / "well.csv": tmp_path / "well"},
        ("parameters=tube", "plant.camber=[0.0, 0.0]"),
        columns=COLUMNS.split()[1],
        stage=lambda _: nullcontext(print),
    )
    assert files == ["first.csv", "well.csv"]
    assert [name.removesuffix(".csv") for name in done] == ["first", "well"]
    overrides = ("parameters=p.toml", "plant.camber=[0.0, 0.0]")
    assert found == {"well": (tmp_path / "well", overrides)}


EARLY_MISTAKES = {
    f"{COLUMNS} --ball rubber": "--ball rubber: give hollow (3/5), solid",
    f"{COLUMNS}:furlong": "--columns: measured_phi: unit 'furlong'; known",
    "--columns time=t,measured_x=X,measured_phi=q": "first.csv: measured_phi: no column q",
    f"broken.csv {COLUMNS}": "broken.csv: measured_x: no column X",
    f"{COLUMNS} --on nowhere": "--on: rig 'nowhere': not found",
    f"{COLUMNS} --set plant.nonsense=1": "the twin: plant.nonsense: unknown key",
}


@pytest.mark.parametrize("more", EARLY_MISTAKES)
def test_a_mistake_is_told_before_anything_is_identified(more, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("twin.shadow.reference.identify_axes", None)
    rows = write_logs(tmp_path)
    np.savetxt("broken.csv", rows[:, ::2], delimiter=",", header="t,p", comments="")
    code, told = ended(f"shadow well.csv --reference first.csv {more}", capsys)
    assert code == 2
    assert told.err.splitlines()[-1].startswith(f"ballplate: {EARLY_MISTAKES[more]}")


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
    ("gains", "factor", "shown"),
    [
        (
            (7.0, 6.95),
            3 / 5,
            "of a solid ball, 0.71 of gravity, not of the stated 0.6: --ball",
        ),
        (
            (5.9,),
            5 / 7,
            "of a hollow ball, 0.6 of gravity, not of the stated 0.71: --ball",
        ),
        ((5.9,), 3 / 5, ""),
        ((6.5,), 3 / 5, ""),  # of neither
        ((7.0, 5.9), 3 / 5, ""),  # of one axis each
        ((), 3 / 5, ""),
    ],
)
def test_a_stated_ball_is_doubted_where_the_gain_is_that_of_another(gains, factor, shown):
    about = plain_parameter("gain", "rad")
    verdicts = [
        ParameterVerdict(
            about=about, name=f"gain_{axis}", value=v, low=v - 0.1, high=v + 0.1, word="identified"
        )
        for axis, v in zip("xy", gains, strict=False)
    ]
    found = _with_doubted_ball(replace(axis_identification(*verdicts), factor=factor))
    assert found.factor == factor
    assert len(found.notes) == bool(shown)
    assert all(shown in note for note in found.notes)


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
