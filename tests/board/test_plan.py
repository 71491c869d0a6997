"""`twin.board.plan`: the motion of ``stable_inversion`` in C."""

import pytest
from board_source import FRAMES, compiled, replayed

from ballplate.changes import changes_of, scenario_of
from twin.base.errors import ScenarioError
from twin.board.plan import plan_of
from twin.run.controller_building import control_of
from twin.run.controller_source import export

KEYS = {"plant.kind": "lagrange", "observer.kind": "friction_kalman", "observer.smooth": 0.005}


def chosen(duration=3.0, **changes):
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return scenario_of("cure", changes_of(KEYS | {"duration": duration} | keys, {}))


def test_the_numbers_of_the_plan_are_those_of_a_preview_of_1_4_s():
    control = control_of(chosen())
    plan = plan_of(control.law, control)
    assert (plan.length, plan.slice_length) == (697, 25)
    assert plan.zero == pytest.approx(7.947, abs=1e-3)  # sqrt(k1 / c2) = sqrt(5.886 / 0.0932)
    # a constant w is its own slope: p = decay p + (near + far) p
    assert plan.decay + plan.near + plan.far == pytest.approx(1.0, abs=1e-15)
    assert 0 < plan.far < plan.near


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"controller__preview": 0.02}, r"controller.preview: must be 0.058 s or more in C"),
        (
            {"reference__omega": 3.0},
            r"controller.slope or slope_rate, for which 'stable_inversion' has no",
        ),
        (
            {"plant__start__x": 0.05},
            r"controller.slope or slope_rate, for which 'stable_inversion' has no",
        ),
        ({"reference": {"kind": "step", "time": 1.0}}, r"'step' jumps at 1 s, which"),
    ],
)
def test_what_has_no_plan_in_c_is_refused_in_one_line(changes, text):
    control = control_of(chosen(**changes))
    with pytest.raises(ScenarioError, match=text) as error:
        plan_of(control.law, control)
    assert "\n" not in str(error.value)


REFERENCES = {
    "circle": {},
    "a ball off the path": {"plant__start__x": 0.12, "plant__start__y": 0.05},
    "line": {"reference": {"kind": "lissajous", "amplitude": [0.1, 0.0]}},
    "hold": {"reference": {"kind": "hold", "x": 0.05, "y": 0.0}, "plant__start__x": 0.05},
    "table": {"reference": {"kind": "path"}},
}


@pytest.mark.long
@pytest.mark.parametrize("which", REFERENCES)
def test_the_motion_in_c_is_that_of_python(which, tmp_path):
    folder = export(tmp_path / "plate.c", chosen(**REFERENCES[which], **FRAMES))
    passed, difference = replayed(compiled(folder))
    assert passed  # the reference, too
    assert difference < 1e-11
