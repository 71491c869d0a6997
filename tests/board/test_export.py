"""`twin.board.export`.

The C controller against the Python one, period by period."""

import pytest
from board_source import compiled, replayed, scenario
from click.testing import CliRunner

import ballplate as bp
from twin.board.export import export
from twin.cli.runs import export as command

LAWS = {
    "pole_placement": "luenberger",
    "lqr": "luenberger",
    "feedforward": "kalman",
    "pid": "nonlinear_luenberger",
    "afl": "ekf",
    "afl_integral": "kalman",
    "backstepping": "nonlinear_luenberger",
    "sliding_mode": "luenberger",
}
"""Each law, with one of the observers."""
LOST = {"sensors__touch__lost": 0.02, "sensors__touch__frame_rate": 133.0}
"""Frames slower than the control period, one of 50 lost."""


@pytest.mark.parametrize("law", LAWS)
def test_a_law_in_c_commands_what_it_commands_in_python(law, tmp_path):
    chosen = scenario(controller__kind=law, observer__kind=LAWS[law], duration=0.6)
    passed, difference = replayed(compiled(export(tmp_path / "plate.c", chosen)))
    assert passed
    assert difference < 1e-14


def test_the_predictor_in_c_is_that_of_python_with_frames_lost(tmp_path):
    delay = {"predictor__kind": "smith", "predictor__delay": 0.0413}
    chosen = scenario(observer__kind="kalman", duration=1.0, **delay, **LOST)
    passed, difference = replayed(compiled(export(tmp_path / "plate.c", chosen)))
    assert passed
    assert difference < 1e-14


REFERENCES = {
    "hold": {"x": 0.05},
    "circle": {"start": 0.3},
    "setpoints": {"points": [[0.1, 0.0, 0.0], [0.2, 0.1, 0.05], [0.4, -0.1, 0.0]]},
    "path": {},
}
"""Constant, harmonic after a polynomial, filtered goals, and a table."""


@pytest.mark.parametrize("kind", REFERENCES)
def test_a_reference_in_c_is_that_of_python(kind, tmp_path):
    settings = {f"reference__{key}": value for key, value in REFERENCES[kind].items()}
    chosen = scenario(reference=kind, duration=0.6, **settings)
    passed, difference = replayed(compiled(export(tmp_path / "plate.c", chosen)), "reference: ")
    assert passed
    assert difference < 1e-12


def test_float_has_no_operation_in_double_and_differs_by_rounding_only(tmp_path):
    chosen = scenario(observer__kind="kalman", duration=0.6)
    folder = export(tmp_path / "plate.c", chosen, real="float")
    passed, difference = replayed(compiled(folder))
    assert passed
    assert 0 < difference < 1e-5
    (folder / "test_plate.c").unlink()
    compiled(folder, "-c", "-Wdouble-promotion")


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"controller.kind": "mpc"}, "controller.kind: 'mpc' has no form in C; exported are"),
        ({"controller.kind": "tvlqr"}, "controller.kind: 'tvlqr' has no form in C; exported are"),
        ({"observer.kind": "ideal"}, "observer.kind: 'ideal' has no form in C; exported are"),
        ({"controller.period": 0.01}, "leave controller.period and controller.computing_time out"),
    ],
)
def test_what_has_no_form_in_c_is_refused_in_one_line(settings, text, tmp_path):
    with pytest.raises(bp.TwinError, match=text) as error:
        bp.controller_source("hold", tmp_path / "plate.c", settings)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["Plate.c", "2.c", "a-b.c", "plate.txt"])
def test_a_name_that_is_none_in_c_is_refused(name, tmp_path):
    with pytest.raises(bp.TwinError, match=r"names in C begin|must end in \.c"):
        bp.controller_source("hold", tmp_path / name, duration=0.1)


def test_the_command_writes_a_folder(tmp_path):
    file = tmp_path / "plate.c"
    short = ["--set", "duration=0.1", "--set", "plant.kind=lagrange"]
    done = CliRunner().invoke(command, ["hold", str(file), "--real", "float", *short])
    assert done.exit_code == 0, done.output
    names = {each.name for each in (tmp_path / "plate").iterdir()}
    assert names == {"README.md", "plate.c", "plate.h", "test_plate.c", "reference_run.csv"}
    assert "typedef float plate_real;" in (tmp_path / "plate" / "plate.h").read_text("utf-8")
