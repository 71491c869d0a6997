"""`twin.identify.survey`: What a log holds, and a command line that works."""

import json
import shlex

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.understand import identify
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.identify.survey import survey

T = np.arange(0.0, 4.0, 0.02)
X = 0.05 * np.sin(1.3 * T)
U = 0.1 * np.cos(T)


def write(path, header, *columns):
    rows = zip(*columns, strict=True)
    lines = [header, *(",".join(f"{each:.9g}" for each in row) for row in rows)]
    path.write_text("\n".join(lines))
    return path


FORMS = {
    "millis,X,servo": (1e3 * T, 1e3 * X, np.degrees(U)),
    "t [s],ball_x [mm],u [rad]": (T, 1e3 * X, U),
    "time_us,px,roll": (1e6 * T, X, U),
    "t,cam_x_cm,cmd_x_deg": (T, 1e2 * X, np.degrees(U)),
}


@pytest.mark.parametrize("header", FORMS)
def test_the_guessed_columns_give_the_log_in_si_units(tmp_path, header):
    found = survey(write(tmp_path / "a.csv", header, *FORMS[header]))
    program, command, file, option, columns = shlex.split(found.command)
    assert (program, command, option) == ("ballplate", "identify", "--columns")
    axis = read_any(tmp_path / file, wanted_columns(columns)).axes["x"]
    assert axis.sampled == pytest.approx(T, abs=1e-6)
    assert axis.ball == pytest.approx(X, abs=1e-6)
    assert axis.tilt == pytest.approx(U, abs=1e-6)
    assert all(guess.why for guess in found.guesses)


def test_the_suggested_line_keeps_what_was_typed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "a.csv", "t,X,servo", T, 1e3 * X, np.degrees(U))
    typed = ["a.csv", "--on", "tube", "--ball", "solid", "--json"]
    found = json.loads(CliRunner().invoke(identify, typed, obj=None).output)
    assert shlex.split(found["command"])[1:-2] == typed[:-1]
    assert shlex.split(found["command"])[-2] == "--columns"


def test_gaps_doubled_stamps_and_steps_back_are_counted(tmp_path):
    time = T.copy()
    time[50:] += 1.5
    time[101] = time[100]
    time[150:] -= 3.0
    (line,) = survey(write(tmp_path / "a.csv", "t,x,u", time, X, U)).notes
    assert line.startswith("t: 50 rows per s over")
    assert "1 gap, the longest 1.52 s" in line
    assert "1 doubled stamps" in line
    assert "1 step back" in line


def test_a_column_whose_time_falls_is_no_time_and_a_lacking_role_is_a_blank(tmp_path):
    found = survey(write(tmp_path / "a.csv", "t,ball_x,noise", T[::-1], X, U))
    assert [guess.role for guess in found.guesses] == ["measured_x"]
    assert "time=NAME:s," in found.command
    assert "command_phi=NAME:deg" in found.command


def test_identify_without_columns_shows_the_log_and_exits_with_1(tmp_path):
    file = write(tmp_path / "a.csv", "millis,X,servo", 1e3 * T, 1e3 * X, np.degrees(U))
    how = {"catch_exceptions": False, "standalone_mode": False}
    done = CliRunner().invoke(identify, [str(file)], **how)
    assert done.return_value == 1
    asked = "--columns time=millis:ms,measured_x=X:mm,command_phi=servo:deg"
    assert asked in " ".join(done.output.split())
    done = CliRunner().invoke(identify, [str(file), "--json"], **how)
    assert done.return_value == 1
    assert json.loads(done.stdout)["roles"]["measured_x"]["column"] == "X"
