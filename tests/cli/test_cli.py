import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import sleep

import pytest

from twin import jobs
from twin.cli import main, output
from twin.run import overview_plot
from twin.run.execute import run as run_scenario
from twin.run.overview_plot import picture
from twin.scenario.title import titled

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
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name == "circle-duration=0.2-metrics.start=0-plant=lagrange"
    written = {path.name for path in folder.iterdir()}
    assert written == {"run.parquet", "metrics.json", "picture.png"}


@pytest.mark.long
def test_run_shows_another_scenario_beside(ballplate):
    code, out, _ = ballplate("run", "circle", *QUICK, "--beside", "cure")
    assert code == 0
    assert re.search(r"exact equations\s*┃\s*cure\s*┃", out)
    code, _, err = ballplate("run", "circle", *QUICK, "--beside", "crue")
    assert code == 2
    assert "did you mean 'cure'" in err


def test_run_json_prints_one_object_with_every_indicator_and_nothing_else(ballplate):
    code, out, _ = ballplate("run", "step", *QUICK, "--json")
    assert code == 0
    assert set(json.loads(out)) >= KEYS


NO_UNIT = {"scenario", "outcome", "reason", "units"}


def test_run_json_has_the_unit_of_every_number_a_verdict_and_the_baseline(ballplate):
    short = ("--set", "duration=0.2", "--set", "metrics.start=0")
    code, out, _ = ballplate("run", "circle", *short, "--json")
    assert code == 0
    found = json.loads(out)
    verdict, model = found.pop("verdict"), found.pop("baseline")
    assert found.keys() - NO_UNIT == found["units"].keys()
    assert found["units"]["rms_distance"] == "m"
    assert model.keys() == found.keys()
    assert model["outcome"] == "finished"
    assert model["u_rms"] != found["u_rms"]
    own, clean = (each["tracking_error_percent"] for each in (found, model))
    assert f"e_tt {own:.3g} % ({clean:.3g} % on the clean model)" in verdict
    (folder,) = Path("runs").iterdir()
    assert json.loads((folder / "metrics.json").read_text()) == found
    code, out, _ = ballplate("run", "circle", *QUICK, "--json")
    assert json.loads(out)["baseline"] is None
    code, out, _ = ballplate("compare", str(folder), "--json")
    (opened,) = json.loads(out).values()
    kept = ("judged_from", "real_time_factor")  # of a run just made
    assert opened == {key: value for key, value in found.items() if key not in kept}


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
    code, out, err = ballplate("run", "circle", *QUICK[2:], *unlike, "--out", "unlike")
    assert code == 0, err
    assert "clean model" in out
    assert (tmp_path / "unlike" / "run.parquet").is_file()


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
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.startswith("compare-step-controller.rho=100.0,300.0-duration=0.2")
    assert (folder / "compare.png").is_file()


@pytest.mark.long
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
        (("run", "circle", "--set", "amplitude=0.1"), "did you mean 'reference.amplitude'"),
        (("run", "circle", "--set", "rolling_mm=0"), "did you mean 'plant.friction.rolling_mm'"),
        (("run", "circle", "--set", "friction=0"), "did you mean 'plant.friction.rolling_mm' or"),
        (("compare", "no.csv", "circle"), "no.csv: cannot be read: No such file or directory"),
        (
            ("run", "foo"),
            "known: circle, cure, cure_afl, cure_backstepping, excite, hold, sine, step; `",
        ),
        (("report", "circle"), "is a scenario, not a run; first: ballplate run circle"),
        (("report",), "no run in runs/ yet"),
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
    assert not (tmp_path / "runs").exists()


def test_without_arguments_it_says_how_to_begin(ballplate):
    code, out, _ = ballplate()
    assert code == 0
    assert "ballplate run circle" in out


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "more"),
    [
        ((), ""),
        (("controller.rho=90.0", "reference.x=0.1"), ", controller.rho=90.0, reference.x=0.1"),
    ],
)
def test_what_was_changed_is_in_the_title_of_everything_a_run_leaves(
    ballplate, tmp_path, monkeypatch, changes, more
):
    drawn = []
    monkeypatch.setattr(overview_plot.Figure, "suptitle", lambda _, text, **__: drawn.append(text))
    title = f"Step to (150, 150) mm (duration=0.2, metrics.start=0{more}, plant.kind=lagrange)"
    asked = [word for change in changes for word in ("--set", change)]
    _, out, _ = ballplate("run", "step", *QUICK, *asked, "--out", "made")
    assert out.splitlines()[0] == title
    folder = tmp_path / "made"
    assert json.loads((folder / "metrics.json").read_text())["scenario"] == title
    assert [" ".join(text.split()) for text in drawn] == [title]
    ballplate("report", str(folder))
    assert f"<h1>{title}</h1>" in (folder / "report.html").read_text()


def test_a_run_as_it_is_shipped_keeps_its_title(ballplate, tmp_path, scenario):
    chosen = scenario("duration=0.2")
    assert titled(chosen, ()).title == chosen.title
    assert titled(chosen, ("title=mine", "duration=0.2")).title == f"{chosen.title} (duration=0.2)"
    assert titled(chosen, ("duration=0.2",)).model_copy(update={"title": chosen.title}) == chosen


def test_a_long_title_is_broken_and_cut_to_fit_the_picture(scenario):
    motion = run_scenario(scenario()).motion
    drawn = picture({"one": motion}, "word " * 200, (0.25, 0.15))
    lines = drawn.get_suptitle().splitlines()
    assert len(lines) == 3
    assert lines[-1].endswith(" ...")
    box = drawn._suptitle.get_window_extent()
    assert 0 < box.x0 < box.x1 < drawn.bbox.x1


@pytest.mark.long
def test_columns_of_variants_are_told_apart_by_value(ballplate, monkeypatch, tmp_path):
    monkeypatch.setattr(output.console, "width", 80)
    code, out, _ = ballplate(
        *("compare", "step", *QUICK, "--out", "made"),
        *("--vary", "plant.friction.rolling_mm=[0, 0.1, 0.18, 0.3]"),
    )
    assert code == 0
    title = " ".join(out.split())  # broken to fit
    assert title.startswith(
        "Step to (150, 150) mm over plant.friction.rolling_mm (duration=0.2, metrics.start=0"
    )
    heading = next(line for line in out.splitlines() if line.startswith("┃"))
    assert heading.replace("┃", " ").split() == ["0", "0.1", "0.18", "0.3", "unit"]
    assert "…" not in out
    kept = {path.name for path in (tmp_path / "made").iterdir() if path.is_dir()}
    assert kept == {f"rolling_mm={value}" for value in ("0", "0.1", "0.18", "0.3")}


@pytest.mark.long
def test_runs_that_do_not_fit_as_columns_have_a_line_each(ballplate, monkeypatch):
    monkeypatch.setattr(output.console, "width", 80)
    command = ("compare", "step", *QUICK, "--vary", f"seed={[*range(100_000, 100_008)]}")
    _, out, _ = ballplate(*command)
    lines = [line for line in out.splitlines() if line.startswith("│ 1000")]
    assert [line.split("│")[1].strip() for line in lines] == [f"10000{i}" for i in range(8)]
    assert "[mm]" in out
    _, out, _ = ballplate(*command, "--all")
    assert max(map(len, out.splitlines()[2:-2])) <= 80
    assert all(f"10000{i} " in out for i in range(8))
    assert out.count("largest |phi|") > 1


@pytest.mark.long
def test_finished_runs_comparisons_and_patterns_are_compared_and_reported(ballplate, tmp_path):
    ballplate("run", "step", *QUICK, "--out", "runs/one")
    ballplate("compare", "step", *QUICK, "--vary", "seed=[1,2]", "--out", "runs/both")
    code, out, _ = ballplate("compare", "runs/one", "runs/both", "hold", *QUICK, "--json")
    assert code == 0
    assert list(json.loads(out)) == ["one", "seed=1", "seed=2", "hold"]
    (made,) = (tmp_path / "runs").glob("compare-*")
    ballplate("compare", *map(str, (tmp_path / "runs").glob("*")), "--json", "--out", "all")
    assert {path.name for path in Path("all").iterdir()} == {"compare.png", "compare.json"}
    code, out, err = ballplate("compare", "last", "runs/one")
    assert code == 0, err
    assert "hold, one" in out  # the newest has one run
    assert ballplate("report", "--format", "csv")[0] == 0
    assert (made / "hold" / "report.csv").is_file()


@pytest.mark.long
def test_a_comparison_leaves_no_run_of_the_one_before_and_nothing_of_others(ballplate):
    place = Path("made")
    ballplate("compare", "step", *QUICK, "--vary", "seed=[1,2,3]", "--out", "made")
    (place / "seed=2" / "notes.txt").touch()
    _, out, _ = ballplate("compare", "step", *QUICK, "--vary", "seed=[3,4]", "--out", "made")
    assert "(replaced a comparison of 3 runs)" in out
    assert sorted(path.parent.name for path in place.rglob("run.parquet")) == ["seed=3", "seed=4"]
    assert not (place / "seed=1").exists()
    assert (place / "seed=2" / "notes.txt").exists()


@pytest.mark.long
def test_a_log_lies_over_its_prediction_in_compare_and_report(ballplate, tmp_path):
    ballplate("run", "circle", *QUICK, "--out", "made")
    ballplate("export", "made", "log.csv")
    code, out, _ = ballplate("compare", "log.csv", "circle", *QUICK[:2])
    assert code == 0
    assert "log and circle are 0 mm (RMS) apart over x and y." in out
    code, out, err = ballplate(
        "report", "log.csv", "--against", "circle", "--set", "plant.kind=lagrange"
    )
    assert code == 0, err
    page = (tmp_path / "runs" / "log-against-circle-plant=lagrange" / "report.html").read_text()
    assert "<h3>log</h3>" in page
    assert "<h3>circle predicted</h3>" in page
    for command in (("report", "log.csv"), ("compare", "log.csv")):
        code, _, err = ballplate(*command)
        assert code == 2
        assert "a log has no reference; name the scenario" in err


@pytest.mark.long
def test_columns_of_several_scenarios_and_variants_name_both(ballplate):
    _, out, _ = ballplate(
        *("compare", "hold", "step", *QUICK),
        *("--vary", "controller.rho=[100.0]", "--vary", "reference.x=[0.0, 0.1]"),
    )
    assert out.startswith("hold, step over controller.rho, reference.x (")
    heading = next(line for line in out.splitlines() if line.startswith("┃"))
    assert [each.strip() for each in heading.split("┃")[2:-2]] == [
        "hold 100.0, 0.0",
        "hold 100.0, 0.1",
        "step 100.0, 0.0",
        "step 100.0, 0.1",
    ]


@pytest.mark.long
def test_the_tracking_error_comes_first_in_a_table(ballplate):
    def rows(*more):
        _, out, _ = ballplate("run", "circle", *QUICK, *more)
        return [line.split("│")[1].strip() for line in out.splitlines() if line.startswith("│")]

    first = ["tracking error e_tt", "RMS error, x"]
    assert rows() == first
    every = rows("--all")
    assert every[:3] == [*first, "outcome"]
    assert len(every) > 10
    assert len(set(every)) == len(every)


def test_the_two_runs_of_a_scenario_are_told_apart_while_they_go_on(ballplate):
    _, _, err = ballplate("run", "circle", *QUICK[2:])
    assert [line for line in err.splitlines() if line.endswith("...")] == [
        "honest twin ...",
        "clean model ...",
    ]


def test_progress_says_share_rate_and_time_left(monkeypatch):
    now = iter((100.0, 102.0, 104.0))
    monkeypatch.setattr(output, "monotonic", lambda: next(now))
    counted = output.Meter(120, "runs")
    assert counted.text(20, "0 failed") == "20 of 120 runs, 0 failed"  # done before
    assert counted.text(30, "1 failed") == (
        "30 of 120 runs, 5 per second, about 18 s left, 1 failed"
    )
    assert counted.text(120) == "120 of 120 runs, 25 per second"
    now = iter((0.0, 3.0))
    share = output.Meter(2.0)
    assert [share.text(0.0), share.text(0.5)] == ["0%", "25%, about 9 s left"]


LONG = ("--set", "duration=6", "--set", "metrics.start=2")


def written(ballplate, monkeypatch, processors, out, *arguments):
    """What a command with so many processors writes, but for the speed; and what it says."""
    monkeypatch.setattr(jobs, "cores", lambda: processors)
    code, _, err = ballplate(*arguments, "--out", out)
    assert code == 0
    files = {file.relative_to(out): file.read_bytes() for file in Path(out).rglob("*.p*")}
    for file in Path(out).rglob("metrics.json"):
        content = json.loads(file.read_text())
        del content["real_time_factor"]
        files[file.relative_to(out)] = content
    return files, [line for line in err.splitlines() if line.endswith("...")]


@pytest.mark.long
def test_a_run_writes_the_same_bytes_on_one_processor_and_on_two(ballplate, monkeypatch):
    begun = []
    begin = jobs.SecondProcess.begin

    def noted(self, *job):
        begun.append(self.there)
        return begin(self, *job)

    monkeypatch.setattr(jobs.SecondProcess, "begin", noted)
    command = ("run", "circle", *LONG)
    one = written(ballplate, monkeypatch, 1, "one", *command)
    assert not any(begun)
    two = written(ballplate, monkeypatch, 2, "two", *command)
    assert begun[-1]
    assert one == two
    assert {str(path) for path in one[0]} == {"run.parquet", "picture.png", "metrics.json"}
    assert one[1] == ["honest twin ...", "clean model ..."]


@pytest.mark.long
def test_a_comparison_writes_the_same_bytes_on_one_process_and_on_two(ballplate, monkeypatch):
    command = ("compare", "circle", "--vary", "seed=[1,2]", "--vary")
    command += ("plant.friction.rolling_mm=[0,0.2]", "--set", "duration=0.5")
    command += ("--set", "metrics.start=0")
    one = written(ballplate, monkeypatch, 1, "one", *command, "-j", "1")[0]
    two = written(ballplate, monkeypatch, 1, "two", *command, "-j", "2")[0]
    assert one == two
    assert len(one) == 4 * 3 + 1


@pytest.mark.long
@pytest.mark.real_time
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no process groups")
def test_ctrl_c_ends_a_comparison_on_two_processes_and_keeps_what_is_done(tmp_path):
    code = "from twin.cli import main, output; output.LINE_EVERY = 0.0\n"
    code += "if __name__ == '__main__': main()"
    arguments = ["compare", "hold", *QUICK[:2], "--vary", "duration=[1,3600]", "-j", "2"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments, "--out", str(tmp_path)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        kept = tmp_path / "duration=1" / "picture.png"
        while not kept.exists():
            assert process.poll() is None
            sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        error = process.communicate(timeout=60)[1]
    assert process.returncode == 1
    assert "Traceback" not in error
    assert (tmp_path / "compare.png").is_file()
    assert not (tmp_path / "duration=3600").exists()
    assert not list(tmp_path.rglob(".*"))
