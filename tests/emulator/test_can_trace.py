"""`twin.emulator.lockstep`.

The trace of an emulated rig gives again what its run recorded, in words and as a log."""

import json
import re
import shutil
from functools import partial
from pathlib import Path

import can
import numpy as np
import pytest
from command_line import called

from twin.devices.akd.recording import TraceWriter
from twin.devices.akd.traces import read_trace
from twin.emulator.lockstep import LockstepRig
from twin.identify.logs import read
from twin.run.finished import run, save
from twin.run.logs import read_log
from twin.scenario.load import check
from twin.scenario.merging import put, setting

pytestmark = pytest.mark.usefixtures("no_pictures")

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
    save(done, folder / "run", {"circle": done.motion})
    for name in ("trace.log", "trace.blf", "run/trace.log"):
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
    monkeypatch.chdir(wired[0])
    return partial(called, capsys, "trace")


@pytest.mark.long
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
    spaced = np.diff(log["time"][k:][: len(times)])
    np.testing.assert_allclose(spaced, np.diff(rows["time"]), atol=1e-6)
    # a count of the motor's rate, at a cam ratio above 4, from one period to the next
    atol = 0.001 * RPM / 4 / 0.002
    for axis in ("phi", "theta"):
        found = log[f"measured_{axis}"][k:][: len(times)]
        np.testing.assert_allclose(found, rows[f"measured_{axis}"], atol=TURN / 245760)
        found = log[f"applied_{axis}_acc"][k:][: len(times)]
        np.testing.assert_allclose(found[1:], rows[f"applied_{axis}_acc"][1:], atol=atol)
    seen = np.isfinite(rows["measured_x"])
    np.testing.assert_allclose(
        log["measured_x"][k:][: len(times)][seen], rows["measured_x"][seen], atol=1e-12
    )


@pytest.mark.parametrize(
    ("name", "rows", "words"),
    [
        ("none.csv", None, "--touch none.csv: cannot be read: No such file"),
        ("back.csv", "2,1,1\n1,1,1\n", "back.csv: time must increase"),
        ("nan.csv", "nan,1,1\ninf,1,1\n", "nan.csv: has no row while the drives"),
    ],
)
def test_a_touch_file_at_fault_is_one_line_and_leaves_no_log(wired, said, name, rows, words):
    folder, _, _ = wired
    if rows is not None:
        (folder / name).write_text(f"time [s],measured_x [mm],measured_y [mm]\n{rows}")
    code, _, err = said(
        "trace.log", "--rig", "rig.toml", "--touch", name, "--log", f"log-of-{name}"
    )
    assert code == 2
    assert words in " ".join(err.split())
    assert not (folder / f"log-of-{name}").exists()


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
    assert "written to events.csv" in out
    assert any(line.endswith("host,NMT,start: node 1") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("none.log",), "none.log: no such trace"),
        (("rig.toml",), "no frame can be read"),
        (("trace.log", "--log", "a.csv"), "--log: needs --rig (scales)"),
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


def test_a_fault_of_an_emulated_drive_is_found_with_what_the_plate_did(tmp_path, tables, capsys):
    chosen = check(put(tables, map(setting, ("plant.kind=lagrange", "duration=0.4"))), "test")
    rig = LockstepRig(chosen)
    heard, done = [], []
    rig.lockstep.heard = heard.append

    def fail(time, _):
        if time > 0.2 and not done:
            done.append(time)
            rig.lockstep.drives[1].fail(235)

    run(chosen, watch=lambda record: record.observers.append(fail), rig=rig)
    writer = TraceWriter(tmp_path / "trace.log", "can0")
    writer.write(heard)
    writer.close()
    (tmp_path / "rig.toml").write_text('[touch]\nport = "none"\n')
    code, out, _ = called(
        capsys, "trace", tmp_path / "trace.log", "--rig", tmp_path / "rig.toml", "--check"
    )
    assert code == 1
    first = out.splitlines()[0]
    assert first.startswith("unresolved: node 2 (theta) at 0.")
    assert "in fault to the end of the trace" in first
    assert "4310h heat sink hot F235; the plate" in first


PAGE = Path(__file__).parents[2] / "docs" / "can-trace.md"
SHOWN = re.findall(
    r"^uv run ballplate (trace trace\.log.*?)(?:\s+#.*)?$", PAGE.read_text(), re.MULTILINE
)


@pytest.mark.parametrize("command", sorted(set(SHOWN)))
def test_every_command_of_the_page_works(said, command):
    code, out, _ = said(*command.split()[1:])
    assert code == 0
    assert ("answer the same" if "--replay" in command else "nothing wrong") in out


def test_the_page_shows_what_a_trace_of_the_rig_says(said):
    rows = re.findall(r"^\| 0\.\d+ \| (\S+(?: \d)?) \| (.*?) \|$", PAGE.read_text(), re.MULTILINE)
    _, out, _ = said("trace.log", "--json")
    events = [(each["who"], each["text"]) for each in json.loads(out)["events"]]
    assert len(rows) == 6
    own = [each for each in events if each in rows]
    assert own == rows


def change_of(cob_id, at, data, *, times=1):
    """The frames with those of an identifier, from the one of that number on, said otherwise."""

    def changed(frames):
        own = [each for each in frames if each.arbitration_id == cob_id][at:][:times]
        for each in own:
            each.data = data(bytearray(each.data))
        return frames

    return changed


def lost(cob_id, at, count):
    def without(frames):
        gone = [id(each) for each in frames if each.arbitration_id == cob_id][at:][:count]
        return [each for each in frames if id(each) not in gone]

    return without


def added(identifier, data):
    def more(frames):
        frames.insert(2000, can.Message(
            timestamp=frames[2000].timestamp, arbitration_id=identifier, is_extended_id=False,
            data=data,
        ))  # fmt: skip
        return frames

    return more


def status(data):
    data[0] = 0x18  # fault
    return data


def faster(data):
    rate = int.from_bytes(data[:4], "little", signed=True) + 3000  # 0.31 rad/s
    data[:4] = rate.to_bytes(4, "little", signed=True)
    return data


def moved(data):
    place = int.from_bytes(data[3:7], "little", signed=True) + 20000  # 0.12 rad
    data[3:7] = place.to_bytes(4, "little", signed=True)
    return data


def refused(data):
    return bytearray((0x80, *data[1:4], 0x22, 0, 0, 8))


def again(folder, said, changed, *more):
    frames = changed(read_trace(folder / "trace.blf").frames)
    writer = TraceWriter(folder / "changed.blf", "can0")
    writer.write(frames)
    writer.close()
    code, out, err = said("changed.blf", "--replay", "--json", *more)
    return code, json.loads(out) if out else err, frames


def test_emulated_drives_answer_a_trace_of_their_own_the_same(wired, said):
    code, out, _ = said("trace.log", "--replay", "--rig", "rig.toml")
    assert code == 0
    assert "the emulated drives answer the same" in out
    frames = read_trace(wired[0] / "trace.log").frames
    own = [each for each in frames if not each.is_rx]
    assert f"{len(own)} frames of the host sent" in out
    assert f"{len(frames) - len(own)} frames of drives compared" in " ".join(out.split())


@pytest.mark.short("changed-1537-40-*", "without-641-150-*")
@pytest.mark.parametrize(
    ("changed", "cob_id", "at", "words"),
    [
        (change_of(0x181, 150, status, times=99), 0x181, 150, "6041h Status word: fault"),
        (change_of(0x282, 150, faster, times=12), 0x282, 150, "282h TPDO2: 606Ch Velocity actual"),
        (change_of(0x181, 150, moved, times=99), 0x181, 150, "181h TPDO1: 6064h Position actual"),
        (change_of(0x581, 40, refused), 0x601, 40, "refused, code 08000022h"),
        (lost(0x281, 150, 7), 0x281, 150, "281h TPDO2: "),
        (lost(0x582, 40, 1), 0x602, 40, "no answer; emulated: "),
        (change_of(0x702, 3, lambda _: b"\x04", times=9), 0x702, 3, "702h: stopped; emulated: "),
        (
            added(0x081, b"\x30\x81\1" + bytes(5)), 0x081, 0,
            "081h: 8130h heartbeat or life guard; emulated: nothing",
        ),
    ],
)  # fmt: skip
def test_the_first_difference_is_told_where_it_is(wired, said, changed, cob_id, at, words):
    code, found, frames = again(wired[0], said, changed)
    assert code == 1
    its = [each for each in frames if each.arbitration_id == cob_id][at]
    told = found["difference"]
    assert words in told["text"]
    assert told["who"].startswith(f"node {cob_id & 0xF}")
    assert told["time"] == pytest.approx(its.timestamp - frames[0].timestamp, abs=0.04)


def test_what_a_drive_had_before_the_trace_is_no_difference(wired, said):
    def current(frames):  # of its motor, which is read once
        (its,) = (
            each
            for each in frames
            if each.arbitration_id == 0x581 and each.data[1:4] == b"\x8e\x35\x00"
        )
        its.data = its.data[:4] + bytes([its.data[4] ^ 1]) + its.data[5:]
        return frames

    code, found, _ = again(wired[0], said, current)
    assert code == 0
    assert found["difference"] is None


@pytest.mark.long
def test_drives_of_others_are_not_replayed_and_named(wired, said):
    def vendor(node):
        def changed(frames):
            for each in frames:
                if each.arbitration_id == 0x580 + node and each.data[1:4] == b"\x18\x10\x01":
                    each.data = each.data[:4] + b"\x1a" + each.data[5:]
            return frames

        return changed

    code, found, _ = again(wired[0], said, vendor(2))
    assert code == 0
    assert found["remarks"] == ["node 2: no AKD, its vendor is 1Ah: not replayed"]
    code, line, _ = again(wired[0], said, lambda frames: vendor(1)(vendor(2)(frames)))
    assert code == 2
    assert "node 1: no AKD" in line
    assert line.count("\n") == 1
