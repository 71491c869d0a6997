"""`twin.board.controller`: a program in the loop, in the place of the controller in Python."""

import shutil

import numpy as np
import pytest
from board_program import program
from click.testing import CliRunner

import ballplate as bp
from twin.base.errors import LawError
from twin.cli.runs import compare as compare_command
from twin.cli.runs import run as run_command
from twin.devices.akd.decoding import Conversation
from twin.devices.akd.traces import read_trace
from twin.run.assemble import assemble
from twin.run.finished import record_run
from twin.run.loop import alike, simulate
from twin.run.opened import open_run
from twin.run.state import Snapshot, SnapshotError, restore
from twin.scenario import load
from twin.scenario.derived import clean

KEYS = {"plant.kind": "lagrange", "plant.start.x": 0.05, "plant.start.y": 0.02}
COMPILED = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


def run(file, **settings):
    keys = {key.replace("__", "."): value for key, value in settings.items()}
    return bp.run("hold", KEYS | {"duration": 0.1, "board.program": str(file)} | keys)


def columns(done, *names):
    return np.stack([done[name] for name in names], axis=1)


def applied_rates(done):
    return np.cumsum(columns(done, "applied_phi_acc", "applied_theta_acc"), axis=0) * 0.002


@COMPILED
def test_the_c_code_in_the_loop_runs_as_python_does():
    settings = {"controller__kind": "afl", "observer__kind": "kalman", "duration": 0.4}
    one = bp.run("hold", KEYS | {"controller.kind": "afl", "observer.kind": "kalman"}, duration=0.4)
    other = run("host", **settings, board__real="double")
    for name in one:
        np.testing.assert_allclose(other[name], one[name], rtol=0, atol=1e-9, err_msg=name)
    assert np.abs(one["applied_phi_acc"]).max() > 0.1
    assert other.metrics["command_difference"] < 1e-12
    assert np.isnan(other["instructions"]).all()
    assert "instructions_max" not in other.metrics
    single = run("host", **settings)
    assert 1e-11 < single.metrics["command_difference"] < 1e-7


def test_python_gets_the_same_measurements_and_rates_and_is_shown_next_to_it(tmp_path):
    rates = "(0.004 * min(count, 5), 0.0)"
    done = run(program(tmp_path, rate=rates), duration=0.04)
    expected = np.minimum(np.arange(1, 21), 5) * 0.004
    np.testing.assert_allclose(applied_rates(done)[:, 0], expected, atol=1e-12)
    assert (done["estimated_theta_rate"] == 0.5).all()
    assert (columns(done, "requested_phi_acc", "requested_theta_acc") == (0.25, -0.25)).all()
    # Python's accelerations, from a run of its own in which the same rates were applied
    with bp.rig("hold", KEYS | {"duration": 0.04}) as rig:
        wanted = []
        for rate in expected:
            wanted.append(rig.controller.command(rig.measurement).acceleration[0])
            rig.step((rate, 0.0))
            rig.controller.applied(rig.applied)
    np.testing.assert_array_equal(columns(done, "python_phi_acc", "python_theta_acc"), wanted)
    difference = 0.002 * np.abs(np.array(wanted) - (0.25, -0.25)).max()
    assert done.metrics["command_difference"] == pytest.approx(difference, rel=1e-12)
    assert (done.beside["Python"]["true_x"] != done["true_x"]).any()
    assert "command_difference" not in done.beside["Python"].metrics


def test_a_command_is_applied_when_its_computing_time_is_over_and_none_is_begun_before(tmp_path):
    # 1000 instructions of at most 5 cycles at 1 MHz are 5 ms: three periods of 2 ms
    file = program(tmp_path, rate="(0.004 * count, 0.0)", instructions="1000.0 + count")
    clock = {"board__clock_hz": 1e6, "board__cycles_per_instruction": (1, 5)}
    done = run(file, duration=0.024, **clock)
    nan = np.nan
    begun = [0, nan, nan, 1, nan, nan, 2, nan, nan, 3, nan, nan]
    count = np.array(begun) + 1
    np.testing.assert_array_equal(done["instructions"], 1000 + count)
    np.testing.assert_allclose(done["computing_time"], 5e-6 * (1000 + count))
    rates = [0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4]
    np.testing.assert_allclose(applied_rates(done)[:, 0], np.array(rates) * 0.004, atol=1e-12)
    lateness = [1, 2, 2, 3, 4, 2, 3, 4, 2, 3, 4, 2]
    np.testing.assert_allclose(done["command_lateness"], np.array(lateness) * 0.002)
    np.testing.assert_allclose(done["requested_phi_acc"], done["applied_phi_acc"], atol=1e-9)
    assert done.metrics["late_percent"] == 100
    assert (done.metrics["instructions_median"], done.metrics["instructions_max"]) == (1002, 1004)
    in_time = run(file, duration=0.024, **clock | {"board__clock_hz": 1e8})
    assert in_time.metrics["late_percent"] == 0
    np.testing.assert_allclose(applied_rates(in_time)[:, 0], np.arange(1, 13) * 0.004, atol=1e-12)


def test_a_law_in_python_and_a_board_of_the_same_time_are_late_alike(tmp_path):
    law = {"controller.computing_time": 0.005, "duration": 0.05}
    python = bp.run("hold", KEYS | law)
    clock = {"board__clock_hz": 1e6, "board__cycles_per_instruction": (1, 5)}
    board = run(program(tmp_path), duration=0.05, **clock)
    for name in ("computing_time", "command_lateness"):
        np.testing.assert_allclose(board[name], python[name], rtol=1e-12)


@pytest.mark.long
def test_rigs_side_by_side_have_a_program_each(tmp_path):
    # by the desired x
    tilting = {"name": "tilting", "rate": "(0.5 * measured[7] if count < 20 else 0.0, 0.0)"}
    keys = [f"{key}={value}" for key, value in KEYS.items()] + ["duration=0.3"]
    each = [
        load("hold", [*keys, f"board.program='{program(tmp_path, **one)}'", f"reference.x={x}"])
        for one, x in (({"name": "still"}, 0.1), (tilting, 0.1), (tilting, 0.05))
    ]
    found = simulate(each)
    assert [simulate([one])[0] for one in each] == found
    angles = [one["phi_max_deg"] for one in found]
    tilted = np.degrees(0.5 * 0.1 * 0.002 * 19)
    assert angles == pytest.approx([0, tilted, tilted / 2], rel=1e-6, abs=1e-12)
    assert [one["instructions_max"] for one in found] == [1000] * 3
    mixed = [each[0], each[0].model_copy(update={"board": None})]
    assert alike(mixed[0]) != alike(mixed[1])
    with pytest.raises(bp.TwinError, match="board: either all rigs of a batch"):
        simulate(mixed)


@pytest.mark.long
@COMPILED
def test_a_difference_is_stated_up_to_where_the_supervisor_levels_the_plate():
    rolling = {"plant__start__x": 0.15, "plant__start__x_rate": 1.0, "board__real": "double"}
    done = run("host", **rolling, duration=0.3)
    assert done.metrics["outcome"] != "finished"
    levelled = done["supervisor"] != 3
    assert 0 < levelled.sum() < len(levelled)
    apart = done["requested_phi_acc"] - done["python_phi_acc"]
    assert np.abs(apart[levelled]).max() > 0.1
    assert np.abs(apart[~levelled]).max() < 1e-9
    assert done.metrics["command_difference"] < 1e-12


@pytest.mark.parametrize(
    ("act", "words"),
    [
        ("rest()", "gave no answer within 0.3 s"),
        ("say(b'ready')", "sent 'ready', but a frame begins"),
        ("sys.exit(3)", "its process ended, exit status 3"),
    ],
)
def test_a_program_that_fails_ends_a_simulated_run_with_one_line_and_no_file(act, words, tmp_path):
    file = program(tmp_path, act=act, at=20)
    with pytest.raises(LawError, match=words) as error:
        bp.run(
            "hold",
            KEYS | {"board.program": str(file), "board.time_limit": 0.3},
            duration=0.1,
            out=tmp_path / "run",
        )
    assert str(error.value).startswith(f"board.program {file}: ")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()


def test_the_record_of_a_board_is_opened_as_it_was(tmp_path):
    file = program(tmp_path, rate="(0.001 * count, 0.0)")
    done = run(file, board__clock_hz=1e6)
    record_run(done, tmp_path / "run")
    (again,) = open_run(tmp_path / "run")
    assert again.metrics == done.metrics
    np.testing.assert_array_equal(again.motion.board, done.motion.board)
    assert again.scenario.board == done.scenario.board
    assert again.units["python_phi_acc"] == "rad/s^2"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"board.program": "none.elf"}, "board.program: must be cortex-m4, host or the file of a"),
        ({"board.program": "host", "controller.kind": "mpc"}, "'mpc' has no form in C"),
        ({"board.real": "half"}, "board.real: must be 'float' or 'double'"),
        ({"board.clock_hz": 0}, "board.clock_hz: must be greater than 0"),
        ({"board.cycles_per_instruction": [2, 1]}, "the least is 2, the most 1"),
        ({"board.clock": 1e6}, "board.clock: unknown key; did you mean 'clock_hz'"),
    ],
)
def test_settings_that_cannot_be_are_one_line(settings, words):
    with pytest.raises(bp.TwinError, match=words) as error:
        bp.run("hold", KEYS | settings, duration=0.1)
    assert "\n" not in str(error.value)


def test_the_clean_model_has_python_s_controller():
    assert clean(load("circle", ["board.program=host"])).board is None


@pytest.mark.parametrize(
    ("target", "missing", "words"),
    [
        ("host", "gcc", r"needs gcc, which is not installed \(packages of Debian: gcc\)"),
        ("cortex-m4", "arm-none-eabi-gcc", "gcc-arm-none-eabi libnewlib-arm-none-eabi"),
    ],
)
def test_a_compiler_that_is_not_there_is_named_with_its_packages(
    target, missing, words, monkeypatch
):
    found = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name: None if name == missing else found(name))
    with pytest.raises(bp.TwinError, match=words) as error:
        run(target)
    assert str(error.value).startswith(f"board.program: needs {missing}")


def test_an_emulator_that_is_not_there_is_named_with_its_package(tmp_path, monkeypatch):
    elf = tmp_path / "mine.elf"
    elf.write_bytes(b"\x7fELF".ljust(18, b"\0") + b"\x28\0")
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.raises(bp.TwinError, match="needs qemu-system-arm, which is not installed"):
        run(elf)


def test_a_clock_needs_a_program_that_counts(tmp_path):
    with pytest.raises(bp.TwinError, match=r"board.clock_hz: .* counts no instructions; remove"):
        run(program(tmp_path, instructions="0.0"), board__clock_hz=1e6)


def test_a_program_cannot_be_put_back_into_a_state(tmp_path):
    rig, controller = assemble(load("hold", [f"board.program='{program(tmp_path)}'"]))
    with rig:
        measurement = rig.read()
        controller.start(measurement)
        kept = Snapshot.take(rig, controller, measurement)
        with pytest.raises(SnapshotError, match="cannot be put back into") as error:
            restore(controller, kept.controller)
    assert str(error.value).count("the snapshot belongs to another kind of rig") == 1


@pytest.mark.long
def test_the_commands_show_python_next_to_the_board(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file, short = program(tmp_path), ["--plant", "lagrange", "--set", "duration=0.1"]
    done = CliRunner().invoke(run_command, ["hold", "--board", str(file), *short])
    assert done.exit_code == 0, done.output
    assert "Python" in done.output
    for words in ("largest difference of commands", "instructions a period, largest"):
        assert words in done.output
    variants = ["--with", f"board=board.program={file}", "--with", "Python="]
    done = CliRunner().invoke(compare_command, ["hold", *variants, *short])
    assert done.exit_code == 0, done.output
    (line,) = (each for each in done.output.splitlines() if "difference of commands" in each)
    assert line.split("│")[3].strip() == "-"  # Python's own


WIRE = {"plant.kind": "mujoco", "baseline": False}


@COMPILED
@pytest.mark.long
@pytest.mark.real_time
def test_it_drives_the_emulated_wire_as_the_simulated_rig():
    done = bp.run("circle", WIRE | {"board.program": "host"}, duration=4.0, on="emulated")
    assert done.metrics["outcome"] == "finished"
    seen, simulated = (
        each.metrics["tracking_error_percent"] for each in (done, done.beside["Python"])
    )
    assert seen == pytest.approx(simulated, abs=3.0)


@pytest.mark.long
@pytest.mark.real_time
def test_where_it_fails_on_the_wire_the_plate_is_levelled_and_the_record_whole(tmp_path):
    rate = "2 * (0.1 * math.cos(12 * measured[0]),)"  # half a degree either way
    file = program(tmp_path, rate=rate, act="rest()", at=1250)
    keys = WIRE | {"board.program": str(file), "plant.friction.rolling_mm": 0.5}
    done = bp.run("hold", keys, duration=4.0, on="emulated", out=tmp_path / "run")
    assert done.metrics["outcome"] == "aborted"
    assert "gave no answer within 0.04 s" in done.metrics["reason"]
    assert len(done["time"]) == 1249  # whenever these periods were: the next has no answer
    assert done["time"][-1] > 2.4
    heard = Conversation(read_trace(tmp_path / "run" / "trace.log").frames)
    for node in (1, 2):
        assert heard.nodes[node].drive[-2:] == ["operation enabled", "switch on disabled"]
        plate = np.array(heard.series[node, (0x2050, 0)].counts) * 360 / 245760
        assert np.abs(plate - plate[0]).max() > 0.2
        assert abs(plate[-1] - plate[0]) < 0.1  # degrees
    (again,) = open_run(tmp_path / "run")
    assert len(again.time) == len(done["time"])
    assert np.isfinite(again["python_phi_acc"]).all()
