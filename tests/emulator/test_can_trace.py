"""The trace of an emulated rig gives again what its run recorded, in words and as a log."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from twin.cli import main
from twin.devices.akd.traces import TraceWriter
from twin.emulator.lockstep import LockstepRig
from twin.identify.logs import read
from twin.run.finished import run
from twin.run.logs import read_log
from twin.scenario.load import check, put, setting

TURN = 2 * np.pi
RPM = TURN / 60
CHANGES = ("plant.kind=mujoco", "duration=0.4", "sensors.touch.frame_rate=57.6")


@pytest.fixture(scope="module")
def wired(tmp_path_factory, tables):
    """A run on the emulated wire, in bus time: its trace, its record, and when the run began."""
    folder = tmp_path_factory.mktemp("wired")
    chosen = check(put(tables, map(setting, CHANGES)), "test")
    rig = LockstepRig(chosen)
    heard, begun = [], []
    rig.lockstep.heard = heard.append

    def watch(record):
        record.observers.append(lambda *_: begun.append(rig.now()))

    done = run(chosen, watch=watch, rig=rig)
    for name in ("trace.log", "trace.blf"):
        writer = TraceWriter(folder / name, "can0")
        writer.write(heard)
        writer.close()
    rows = {name: np.asarray(values) for name, values in done.rows.items()}
    shutil.copy(Path(__file__).parents[1] / "devices" / "akd" / "servo.eds", folder)
    (folder / "rig.toml").write_text('[touch]\nport = "none"\n')
    times = np.array(begun)
    # a trace has microseconds: what comes with the tick is put before it
    seen = np.column_stack([times - rows["age"] - 1e-5, rows["measured_x"], rows["measured_y"]])
    text = "\n".join(",".join(map(repr, map(float, row))) for row in seen)
    (folder / "touch.csv").write_text(f"time [s],measured_x [m],measured_y [m]\n{text}\n")
    return folder, rows, times


@pytest.fixture
def said(wired, capsys, monkeypatch):
    folder, _, _ = wired
    monkeypatch.chdir(folder)

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(["trace", *arguments])
        out, err = capsys.readouterr()
        return caught.value.code, out, err

    return call


def test_of_a_run_folder_its_trace_is_told(said):
    (_, of_folder, _), (_, of_file, _) = said(".", "--json"), said("trace.log", "--json")
    assert {**json.loads(of_folder), "trace": ""} == {**json.loads(of_file), "trace": ""}


def test_the_power_stages_go_through_their_states(said):
    code, out, _ = said("trace.blf", "--rig", "rig.toml", "--json")
    told = json.loads(out)
    assert code == 0
    assert not told["remarks"]
    for node, name in (("1", "node 1 (phi)"), ("2", "node 2 (theta)")):
        its = told["nodes"][node]
        assert its["name"] == name
        assert its["drive"] == [
            "switch on disabled",
            "ready to switch on",
            "switched on",
            "operation enabled",
            "switch on disabled",
        ]
        assert its["states"][-1] == "operational"
        assert not its["faults"]
    assert told["pdos"]["281h"] == {
        "node": 1,
        "name": "TPDO2",
        "entries": ["606Ch Velocity actual", "2050h Secondary feedback position"],
    }
    texts = [each["text"] for each in told["events"]]
    assert "start: node 1 (phi)" in texts
    assert "writes 6060h Mode of operation to node 2 (theta): profile velocity; read back" in texts
    assert told["regular"]["SYNC"]["usual"] == pytest.approx(0.002)


def test_angles_and_rates_of_the_record_come_back_within_a_count(wired, said):
    folder, rows, times = wired
    code, _, _ = said("trace.log", "--rig", "rig.toml", "--touch", "touch.csv", "--log", "log.csv")
    assert code == 0
    log = read_log(folder / "log.csv")
    begin = len(log["time"]) - len(rows["time"])
    starts = [
        k
        for k in range(begin + 1)
        if np.abs(log["measured_phi"][k:][: len(times)] - rows["measured_phi"]).max() < 1e-12
    ]
    assert len(starts) == 1
    k = starts[0]
    for axis in ("phi", "theta"):
        found = log[f"measured_{axis}"][k:][: len(times)]
        np.testing.assert_allclose(found, rows[f"measured_{axis}"], atol=TURN / 245760)
    spaced = np.diff(log["time"][k:][: len(times)])
    np.testing.assert_allclose(spaced, np.diff(rows["time"]), atol=1e-6)
    # a count of the motor's rate, at a cam ratio above 4, from one period to the next
    atol = 0.001 * RPM / 4 / 0.002
    for axis in ("phi", "theta"):
        found = log[f"applied_{axis}_acc"][k:][: len(times)]
        np.testing.assert_allclose(found[1:], rows[f"applied_{axis}_acc"][1:], atol=atol)
    seen = np.isfinite(rows["measured_x"])
    np.testing.assert_allclose(
        log["measured_x"][k:][: len(times)][seen], rows["measured_x"][seen], atol=1e-12
    )


def test_identify_takes_the_log(wired, said):
    folder, rows, _ = wired
    said("trace.log", "--rig", "rig.toml", "--touch", "touch.csv", "--log", "log.csv")
    log = read(folder / "log.csv")
    assert log.command is not None
    assert len(log.time) >= len(rows["time"])


def test_events_are_written_as_csv(wired, said):
    folder, _, _ = wired
    code, out, _ = said("trace.log", "--out", "events.csv")
    lines = (folder / "events.csv").read_text().splitlines()
    assert code == 0
    assert lines[0] == "time [s],who,kind,text"
    assert "written: events.csv" in out
    assert any(line.endswith("host,NMT,start: node 1") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("none.log",), "none.log: no such trace"),
        (("rig.toml",), "no frame can be read"),
        (("trace.log", "--log", "a.csv"), "--log: needs the scales of --rig"),
        (("trace.log", "--rig", "none.toml"), "--rig none.toml"),
        (("trace.log", "--channel", "can4"), "there are can0"),
    ],
)
def test_mistakes_are_one_line(said, arguments, line):
    code, out, err = said(*arguments)
    assert code == 2
    assert not out
    assert line in err
    assert err.count("\n") == 1


PAGE = Path(__file__).parents[2] / "docs" / "can-trace.md"
SHOWN = re.findall(
    r"^uv run ballplate (trace trace\.log.*?)(?:\s+#.*)?$", PAGE.read_text(), re.MULTILINE
)


@pytest.mark.parametrize("command", sorted(set(SHOWN)))
def test_every_command_of_the_page_works(said, command):
    code, out, _ = said(*command.split()[1:])
    assert code == 0
    assert "operation enabled" in out


def test_the_page_shows_what_a_trace_of_the_rig_says(said):
    rows = re.findall(r"^\| 0\.\d+ \| (\S+(?: \d)?) \| (.*?) \|$", PAGE.read_text(), re.MULTILINE)
    _, out, _ = said("trace.log", "--json")
    events = [(each["who"], each["text"]) for each in json.loads(out)["events"]]
    assert len(rows) == 6
    own = [each for each in events if each in rows]
    assert own == rows
