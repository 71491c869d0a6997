"""The command line as a whole: how it begins, what it refuses, what it says meanwhile."""

import pytest

from twin.cli import output


def test_list_shows_every_scenario_with_its_title(ballplate):
    code, out, _ = ballplate("list")
    assert code == 0
    assert "circle" in out
    assert "Hold on the centre" in out


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
