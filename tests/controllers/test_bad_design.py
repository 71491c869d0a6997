import pytest

from controllers.analysis import instability, slow_observer
from controllers.feedback_linearization import AFL
from controllers.observers import Luenberger
from controllers.smith import Smith
from twin.cli import main
from twin.errors import ScenarioError
from twin.run.execute import run


def test_a_luenberger_of_the_thesis_is_fast_enough_with_and_without_predictor():
    for observer in (Luenberger(), Smith(observer=Luenberger())):
        assert slow_observer(AFL(), observer) is None


def test_an_observer_slower_than_the_loop_is_told_in_one_line():
    told = slow_observer(AFL(), Luenberger(poles=(-0.1, -0.2, -0.3, -0.4)))
    assert "slowest pole is -0.1 1/s" in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["controller.kind=afl", "controller.gains=[1,1,-1,9]"], "unstable"),
        (["controller.kind=afl", "controller.poles=[-1,-2,-3]"], "4"),
        (["controller.kind=pole_placement", 'controller.poles=["-1+1j",-2,-3,-4]'], "conjugate"),
        (["controller.kind=pole_placement", "controller.poles=[1,-2,-3,-4]"], "negative"),
        (["controller.kind=backstepping", "controller.c=[1,2,-3,4]"], "positive"),
        (["controller.kind=sliding_mode", "controller.epsilon=0"], "epsilon"),
        (["observer.kind=kalman", "observer.R=[1,1,1,-1]"], "R"),
        (["observer.poles=[-8,-9,-10]"], "4 or 8"),
    ],
)
def test_a_design_that_cannot_be_is_one_clear_line(scenario, overrides, words):
    with pytest.raises(ScenarioError) as caught:
        run(scenario(*overrides))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_gains_too_fast_for_the_period_are_warned_about_with_their_poles(
    capsys, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    law = ("--set", "controller.kind=afl", "--set", "controller.poles=[-30,-31,-32,-33]")
    with pytest.raises(SystemExit):
        main(["run", "hold", "--plant", "lagrange", "--set", "duration=0.1", *law])
    err = capsys.readouterr().err
    assert "warning: the sampled loop is unstable" in err
    assert "poles" in err


def test_the_thesis_loop_is_not_warned_about():
    afl = AFL(gains=(180.0, 162.0, 66.0, 13.0))
    assert instability(afl, Smith(observer=Luenberger()), dead_time=0.042) is None
