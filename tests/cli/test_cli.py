import json
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from twin.cli import main

QUICK = ("--plant", "lagrange", "--set", "duration=0.2", "--set", "metrics.start=0")
KEYS = {
    "outcome", "outcome_time", "tracking_error_percent", "rms_error", "mean_error",
    "max_steady_error", "overshoot_percent", "settling_time", "steady_error", "phi_max_deg",
    "theta_max_deg", "u1_max", "u2_max", "real_time_factor",
}  # fmt: skip


@pytest.fixture
def ballplate(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(list(arguments))
        out, err = capsys.readouterr()
        return caught.value.code, out, err

    return call


def test_run_prints_a_table_and_writes_a_folder(ballplate, tmp_path):
    code, out, _ = ballplate("run", "circle", *QUICK)
    assert code == 0
    assert "tracking error" in out
    written = {path.name for path in (tmp_path / "runs" / "circle").iterdir()}
    assert written == {"run.parquet", "metrics.json", "picture.png"}


def test_run_json_prints_one_object_with_every_indicator_and_nothing_else(ballplate):
    code, out, _ = ballplate("run", "step", *QUICK, "--json")
    assert code == 0
    assert set(json.loads(out)) >= KEYS


def test_run_writes_where_it_is_told(ballplate, tmp_path):
    ballplate("run", "hold", *QUICK, "--out", "elsewhere/deep")
    assert (tmp_path / "elsewhere" / "deep" / "metrics.json").is_file()


def test_a_run_that_fell_exits_with_one_and_keeps_its_record(ballplate, tmp_path):
    code, out, _ = ballplate(
        "run", "hold", "--plant", "lagrange", "--set", "duration=2",
        "--set", "plant.start.x=0.3", "--set", "plant.start.x_rate=1.0", "--out", "fell",
    )  # fmt: skip
    assert code == 1
    assert "fell" in out
    assert (tmp_path / "fell" / "run.parquet").is_file()


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.skipif(sys.platform == "win32", reason="Windows kills without a signal")
def test_ctrl_c_a_kill_and_a_closed_terminal_end_a_run_in_order(tmp_path):
    def ended_by(number):
        place = tmp_path / number.name
        code = "from twin.cli import main, output; output.LINE_EVERY = 0.2; main()"
        arguments = ["run", "hold", *QUICK[:2], "--set", "duration=3600", "--out", str(place)]
        with subprocess.Popen(
            [sys.executable, "-c", code, *arguments], stderr=subprocess.PIPE, text=True
        ) as process:
            next(line for line in process.stderr if "%" in line)  # the run goes on
            process.send_signal(number)
            error = process.communicate(timeout=60)[1]
        outcome = json.loads((place / "metrics.json").read_text())
        return process.returncode, error.count("Traceback"), outcome["outcome"]

    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with ThreadPoolExecutor() as pool:
        assert list(pool.map(ended_by, signals)) == [(1, 0, "aborted")] * 3


def test_a_rig_unlike_the_clean_model_is_compared_with_it_all_the_same(ballplate, tmp_path):
    unlike = ("--set", "plant.spring.preload=60.0", "--set", "rig.cams=ratio")
    code, out, err = ballplate("run", "circle", *QUICK[2:], *unlike)
    assert code == 0, err
    assert "clean model" in out
    assert (tmp_path / "runs" / "circle" / "run.parquet").is_file()


def test_list_shows_every_scenario_with_its_title(ballplate):
    code, out, _ = ballplate("list")
    assert code == 0
    assert "circle" in out
    assert "Hold on the centre" in out


def test_compare_sets_variants_side_by_side(ballplate, tmp_path):
    code, out, _ = ballplate(
        "compare", "step", *QUICK, "--vary", "controller.rho=[100.0, 300.0]", "--json"
    )
    assert code == 0
    assert list(json.loads(out)) == ["controller.rho=100.0", "controller.rho=300.0"]
    assert (tmp_path / "runs" / "compare" / "compare.png").is_file()


def test_compare_takes_several_scenarios(ballplate):
    code, out, _ = ballplate("compare", "hold", "step", *QUICK, "--json")
    assert code == 0
    assert list(json.loads(out)) == ["hold", "step"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "cirle"), "did you mean 'circle'"),
        (("run", "circle", "--set", "durration=1"), "did you mean 'duration'"),
        (("run", "circle", "--set", "controller.gain=[1]"), "did you mean 'gains'"),
        (("run", "circle", "--set", "plant.ball.mass=-1"), "greater than 0"),
        (("run", "circle", "--set", "plant.start.y=0.3"), "0.1975"),
        (("run", "circle", "--set", "rig.period=0.0013"), "multiple of plant.step"),
        (("run", "circle", "--plant", "real"), "mujoco"),
        (("run", "circle", "--out", "/proc/nowhere"), "cannot be written"),
        (("run",), "SCENARIO"),
        (("rn",), "No such command"),
        (("run", "circle", "--frobnicate"), "--frobnicate"),
        (("compare", "hold", "--vary", "duration"), "KEY="),
        (("run", "circle", "--set", "reference.omega=1e-300"), "no finite number"),
        (("run", "circle", "--set", "reference.amplitude=0.2"), "rig.limits.area allows 0.25"),
        (("safety", "--doc", "."), "File '.' is a directory"),
        (("reproduce", "8.1", "--doc", "/proc/no/x.md"), "--doc /proc/no: cannot be written"),
    ],
)
def test_a_wrong_request_is_one_line_and_exit_code_two(ballplate, tmp_path, arguments, words):
    code, out, err = ballplate(*arguments)
    assert code == 2
    assert out == ""
    assert words in err
    assert err.startswith("ballplate: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "runs").exists() or not any((tmp_path / "runs").rglob("*.parquet"))


def test_without_arguments_it_says_how_to_begin(ballplate):
    code, out, _ = ballplate()
    assert code == 0
    assert "ballplate run circle" in out
