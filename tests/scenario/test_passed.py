"""`twin.scenario.passed`: a configuration that the doctor has passed, and no other."""

import json

import pytest

from twin.base.errors import ScenarioError
from twin.devices.akd.config import NOMINAL_PERIOD, AkdConfig
from twin.run.connect import UNPASSED_REASON, connect
from twin.scenario import load
from twin.scenario.passed import MOST_KEPT, has_passed, note_result, passed_file
from twin.scenario.rig import check_rig, read_rig

TOUCH = {"touch": {"port": "/dev/null"}}


@pytest.fixture(autouse=True)
def fresh(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def rig(**tables):
    return check_rig({**TOUCH, **tables}, "rig.toml")


def test_a_rig_counts_as_checked_only_after_the_doctor_has_passed():
    assert not has_passed(rig())
    note_result(rig(), passed=True)
    assert has_passed(rig())
    note_result(rig(), passed=False)
    assert not has_passed(rig())


@pytest.mark.parametrize(
    "changed",
    [
        {"phi": {"plate_sign": -1}},
        {"theta": {"motor_sign": -1}},
        {"phi": {"plate_counts": 491520}},
        {"phi": {"node": 3}},
        {"home_deg": [0.0, 1.0]},
        {"bus": {"channel": "can1"}},
    ],
    ids=str,
)
def test_what_is_changed_in_a_rig_file_must_pass_again(changed):
    note_result(rig(), passed=True)
    assert not has_passed(rig(**changed))


def test_what_a_rig_is_called_and_how_long_it_waits_need_not():
    note_result(rig(), passed=True)
    assert has_passed(rig(title="another name", patience=5.0))


def test_another_cam_table_or_backend_must_pass_again(tmp_path):
    file = tmp_path / "rig.toml"
    (tmp_path / "own.py").write_text("class Own: pass\n")
    file.write_text('backend = "own.py:Own"\n')
    note_result(read_rig(file), passed=True)
    assert has_passed(read_rig(file))
    (tmp_path / "own.py").write_text("class Own: sign = -1\n")
    assert not has_passed(read_rig(file))


@pytest.mark.parametrize("content", ["", "{", "[1, null]", '{"a": 1}', "\0"])
def test_a_damaged_file_of_passed_rigs_is_none(content):
    note_result(rig(), passed=True)
    passed_file().write_text(content)
    assert not has_passed(rig())
    note_result(rig(), passed=True)
    assert has_passed(rig())


def test_the_newest_are_kept():
    passed_file().parent.mkdir(parents=True)
    passed_file().write_text(json.dumps([str(each) for each in range(2 * MOST_KEPT)]))
    note_result(rig(), passed=True)
    kept = json.loads(passed_file().read_text())
    assert len(kept) == MOST_KEPT
    assert has_passed(rig())


def test_a_rig_that_nobody_has_checked_is_connected_so_that_it_begins_slowly():
    assert connect(load("circle"), rig()).unchecked == UNPASSED_REASON
    note_result(rig(), passed=True)
    assert connect(load("circle"), rig()).unchecked == ""
    virtual = connect(
        load("circle"), rig(), transmission=connect(load("circle"), rig())._transmission
    )
    assert virtual.unchecked == ""


def test_a_slow_bus_is_refused_for_the_period_that_runs_and_not_for_another():
    slow = rig(bus={"bitrate": 250_000})
    assert slow.servos(0.004).bus_load < 1
    with pytest.raises(ScenarioError, match="161 % of its 2 ms"):
        slow.servos(NOMINAL_PERIOD)
    assert connect(load("circle", ["rig.period=0.004"]), slow).period == 0.004
    with pytest.raises(ScenarioError, match="frames of a period"):
        connect(load("circle"), slow)
    assert AkdConfig().period == NOMINAL_PERIOD == load("circle").rig.period
