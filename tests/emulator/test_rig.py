"""`twin.emulator.serve`: Whole runs over the wire: real ports, real bytes, real processes.

The host's watches are relaxed here, as host and rig share a busy machine: how soon the host detects
a fault with its own thresholds is judged in virtual time by tests/safety. What the drives do by
themselves is judged here in bus time, whatever the machine does meanwhile.
"""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path

import pytest
from click.testing import CliRunner
from serving import serving

from twin.base.jobs import wait_until
from twin.cli.see import export, report
from twin.devices.akd.traces import read_trace
from twin.emulator.power_stage import MASTER_SILENT
from twin.emulator.screen import Protocol
from twin.emulator.serve import MAX_PLANT_STEP_S, VirtualRig, serve_rig
from twin.run.opened import open_run
from twin.run.record import read_run
from twin.run.tables import flat
from twin.scenario.rig import check_rig, read_rig
from twin.tune.report import toml

pytestmark = [pytest.mark.long, pytest.mark.real_time]

WATCH = {"stale": 200, "unsteady": 51, "lag_time": 1.0, "frozen": 5.0, "answer": 5.0}
DRIVES = {"silence": 0.5, "answer": 5.0, "watch": WATCH}
GATE = {"stale": 1.0, "lost": 1.0, "rest": 10.0}
"""A busy machine must not end these runs: the virtual rig shares the process of the tests."""
HEARTBEAT = 0x77F
TICKS = 2 * MAX_PLANT_STEP_S


def patient(tables):
    touch = {**tables["touch"], "gate": GATE}
    return {**tables, "late_periods": 10_000, "drives": DRIVES, "touch": touch}


@pytest.fixture
def virtual(scenario, tmp_path):
    # the mechanism: what the host knows of its rig are real cams
    with VirtualRig(scenario("plant.kind=mujoco")) as rig, serving(rig.server):
        (tmp_path / "rig.toml").write_text(toml(flat(patient(rig.tables())), []))
        yield rig


class BusTimes:
    """When something happened on a virtual rig, in s of bus time."""

    def __init__(self, rig):
        self.heartbeat = None
        """The host's last heartbeat."""
        self.fault = {}
        """Each drive's first fault, by node."""
        self.rest = {}
        """Each drive's first standstill after it, by node."""
        bus, from_host, moved = rig.bus, rig.bus.from_host, rig.bus.moved

        def receive(frame):
            if frame.cob_id == HEARTBEAT:
                self.heartbeat = bus.time
            return from_host(frame)

        def move(dt):
            moved(dt)
            for drive in bus.drives:
                node = drive.node
                if drive.power.faults:
                    self.fault.setdefault(node, bus.time)
                if node in self.fault and drive.rate == 0:
                    self.rest.setdefault(node, bus.time)

        bus.from_host, bus.moved = receive, move


@contextmanager
def host(folder, *more):
    """The command line running on the virtual rig, in a separate process."""
    # below a shell that ignores Ctrl-C in the background this process would, too
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{heed}; from twin.cli import main; raise SystemExit(main())"
    arguments = ["run", "hold", "--rig", str(folder / "rig.toml"), "--set", "duration=60"]
    arguments += ["--out", str(folder / "out"), *more]
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def running(virtual):
    """Wait until the host moves the plate."""
    assert wait_until(lambda: any(abs(drive.rate) > 1e-3 for drive in virtual.drives), 60)
    time.sleep(1.0)


def test_a_virtual_rig_finds_its_way_through_its_rig_file(virtual, tmp_path):
    found = read_rig(tmp_path / "rig.toml")
    assert found == check_rig(patient(virtual.tables()), "tables")


def test_a_killed_host_leaves_drives_that_stop_by_themselves_in_the_time_they_were_set(
    virtual, tmp_path
):
    times = BusTimes(virtual)
    with host(tmp_path) as process:
        running(virtual)
        process.kill()
        process.wait()
    assert wait_until(lambda: len(times.rest) == 2, 30)
    assert [drive.power.faults for drive in virtual.drives] == [[MASTER_SILENT]] * 2
    assert not any(drive.enabled for drive in virtual.drives)
    for node in (1, 2):
        assert times.fault[node] - times.heartbeat == pytest.approx(DRIVES["silence"], abs=TICKS)
        assert times.rest[node] - times.fault[node] <= 8.0 / 1000 + TICKS  # fastest, at stop_ramp


def killed(virtual, folder, moment):
    """How long a run was recorded before it was killed, s; None if it had ended by itself."""
    file = folder / "out" / "run.arrows"
    with host(folder, "--reset") as process:
        assert wait_until(lambda: file.exists() or process.poll() is not None, 90)
        begun = virtual.bus.time
        time.sleep(0.3 + 0.3 * moment)
        lasted = virtual.bus.time - begun
        if moment % 2:  # with all its processes, as a computer that is switched off
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
        process.wait()
    return lasted if file.exists() else None


@pytest.mark.parametrize("moment", range(10))
def test_a_run_killed_at_any_moment_leaves_what_was_recorded_until_then(virtual, tmp_path, moment):
    tries = (killed(virtual, tmp_path, moment) for _ in range(8))  # a busy machine ends some
    lasted = next(each for each in tries if each is not None)
    file, size = tmp_path / "out" / "run.arrows", -1
    while size != (size := file.stat().st_size):
        time.sleep(1.0)
    (found,) = open_run(tmp_path / "out")
    assert found.metrics["outcome"] == "aborted"
    assert len(found.rows["lateness"]) > 10
    assert moment % 2 or found.rows["time"][-1] > lasted
    trace = read_trace(tmp_path / "out" / "trace.log").frames
    assert moment % 2 or trace[-1].timestamp - trace[0].timestamp > found.rows["time"][-1]
    for command, more in ((report, ()), (export, (str(tmp_path / "out.csv"),))):
        shown = CliRunner().invoke(command, [str(tmp_path / "out"), *more])
        assert shown.exit_code == 0, shown.output


def test_ctrl_c_levels_the_plate_and_keeps_the_record(virtual, tmp_path):
    with host(tmp_path, "--json") as process:
        running(virtual)
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=300)
    assert process.returncode == 1, error
    assert json.loads(out or "{}").get("outcome") == "aborted", error
    assert not any(drive.enabled for drive in virtual.drives)
    rows, _, metadata = read_run(tmp_path / "out" / "run.parquet")
    assert len(rows["lateness"]) > 10
    # the period in which Ctrl-C came is in the record, but never ended
    assert metadata["ledger"]["ticks"] >= len(rows["time"]) - 1
    assert "true_x" not in rows
    assert not (tmp_path / "out" / "run.arrows").exists()


def test_the_sto_button_ends_a_run_as_a_fault_with_one_line(virtual, tmp_path):
    with host(tmp_path, "--json") as process:
        running(virtual)
        assert "STO open" in virtual.obey("sto")
        out, error = process.communicate(timeout=300)
    assert process.returncode == 1, error
    summary = json.loads(out)
    assert summary["outcome"] == "fault"
    assert "drive" in summary["reason"]
    assert not any(drive.enabled for drive in virtual.drives)
    assert wait_until(lambda: all(abs(drive.rate) < 0.01 for drive in virtual.drives), 60)


def test_the_process_of_an_emulated_rig_obeys_and_ends(scenario):
    before = set(active_children())
    with serve_rig(scenario("plant.kind=lagrange")) as rig:
        assert rig.tell("lift") == "ball lifted"
        assert rig.tell("dance").startswith("known: sto")
        (process,) = set(active_children()) - before
        pid = process.pid
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(
    ("protocol", "transport"), [(Protocol.ELO, "serial"), (Protocol.HID_0006, "hidraw")]
)
def test_the_rig_file_of_a_virtual_rig_names_its_ports_and_what_they_speak(
    scenario, protocol, transport
):
    with VirtualRig(scenario("plant.kind=lagrange"), protocol) as rig:
        found = check_rig(rig.tables(), "virtual")
        assert Path(found.touch.port).is_char_device()
        assert Path(found.bus.channel).is_char_device()
    assert (found.touch.transport, found.touch.protocol) == (transport, str(protocol))
    assert found.bus.interface == "slcan"
