from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import ballplate as bp
from ballplate.reporter import BallplateWarning
from controllers.analysis import instability, slow_observer
from controllers.catalog import register
from controllers.interfaces import Law
from controllers.linear import PolePlacement
from controllers.nonlinear import AFL
from controllers.observers import Ideal, Luenberger
from controllers.smith import Smith
from twin.cli import main
from twin.errors import ScenarioError
from twin.run.finished import run
from twin.run.loop import Ending


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
        (
            ["controller.kind=backstepping", "controller.c=[1,2,-3,4]"],
            "c.2: must be greater",
        ),
        (
            ["controller.kind=backstepping", "controller.c=[1,2,3]"],
            "more values than 3",
        ),
        (["controller.kind=lqr", "controller.Q=[1,2]"], "Q: must have at least 8 values, has 2"),
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


@dataclass(frozen=True, kw_only=True)
class WithMemory(PolePlacement):
    """Pole placement with the error's integral in its memory, and a gain on it."""

    name: ClassVar[str] = "with_memory"
    memory: ClassVar[int] = 2
    ki: float = 0.0

    def control(self, t, x, reference, q):
        return super().control(t, x, reference, q) + self.ki * q * np.array([1.0, -1.0])

    def memory_rate(self, t, x, reference, q):
        return reference(t)[0] - x[..., 0::4]


class Nothing(PolePlacement):
    def control(self, t, x, reference, q):
        return 0.0 * x[..., :2]


class ByCommand(Law):
    name: ClassVar[str] = "by_command"

    def command(self, now):
        return -now.x[..., 2::4] - now.x[..., 3::4]


def test_a_memory_with_gain_0_is_no_instability_and_one_with_a_wrong_sign_is():
    assert instability(WithMemory(), Ideal()) is None
    assert instability(WithMemory(ki=2.0), Ideal()) is None
    assert "unstable" in instability(WithMemory(ki=-2.0), Ideal())


def test_a_law_that_does_nothing_only_integrates():
    told = instability(Nothing(), Ideal())
    assert "unstable" not in told
    assert "8 poles at 0 1/s" in told


def test_of_a_law_that_acts_by_command_alone_nothing_is_said():
    assert instability(ByCommand(), Luenberger()) is None


def test_a_law_may_act_by_command_alone(scenario):
    register(ByCommand)
    record = run(scenario("controller.kind=by_command"))
    assert record.outcome == Ending.FINISHED


def test_of_several_runs_the_warning_names_the_one(tmp_path):
    gains = [[-30, -31, -32, -33], [-3, -3.1, -3.2, -3.3]]
    with pytest.warns(BallplateWarning) as told:
        bp.compare(
            "hold",
            vary={"controller.poles": gains},
            controller={"kind": "afl"},
            plant={"kind": "lagrange"},
            duration=0.1,
        )
    (one,) = told
    assert str(one.message).startswith("controller.poles=[-30, -31, -32, -33]: the sampled loop")
