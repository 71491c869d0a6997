"""Tests of `controllers.classical`."""

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

import ballplate as bp
from ballplate.dangers import warn_of_dangers
from ballplate.reporter import BallplateWarning
from controllers.analysis import instability, slow_observer
from controllers.classical import AFL, LQR, AFLIntegral, Feedforward, PolePlacement
from controllers.interfaces import Law
from controllers.observers import FrictionKalman, Ideal, Luenberger, NonlinearLuenberger
from controllers.references import Circle, Lissajous, Path, Sine
from controllers.repetition import InternalModel
from controllers.setpoints import Setpoints
from controllers.smith import Smith
from controllers.stable_inversion import StableInversion
from twin.base.errors import ScenarioError
from twin.run.controller_building import build_controller
from twin.scenario import load


def test_a_luenberger_of_the_thesis_is_fast_enough_with_and_without_predictor():
    for observer in (Luenberger(), Smith(observer=Luenberger())):
        assert slow_observer(AFL(), observer) is None


def test_an_observer_slower_than_the_loop_is_told_in_one_line():
    told = slow_observer(AFL(), Luenberger(poles=(-0.1, -0.2, -0.3, -0.4)))
    assert "slowest pole is -0.1 1/s" in told
    assert "\n" not in told


REFUSED = [
    (AFL, {"gains": (2000, 162, 66, 13)}, r"gains .* are unstable: they give the poles .*j"),
    (AFL, {"gains": (180, 162, 66, 13j)}, "gains must be a list, each a finite number, 4 of them"),
    (AFL, {"gains": (1, 4, 6, 4), "poles": (-1, -1, -2, -2)}, "gains replace poles"),
    (AFL, {"poles": (-1, -2, -3, -4, -5)}, "poles must be 4 numbers, got 5"),
    (AFLIntegral, {"poles": (-1, -2, -3, -4)}, "poles must be 5 numbers, got 4"),
    (AFLIntegral, {"gains": (4, 12, 51, 132, 200)}, "gains .* are unstable"),
    (Feedforward, {"poles": (-1, -2, -3)}, "poles must be 4 numbers, got 3"),
    (Feedforward, {"poles": (-1, -2, -3, -4), "rho": 100}, "poles replace rho and kappa"),
    (PolePlacement, {"poles": (-1, -2, -3, -4, -5)}, "poles must be 4 or 8 numbers, got 5"),
    (PolePlacement, {"poles": (-1, -2, -3, 0)}, "poles must have a negative real part, got 0"),
    (PolePlacement, {"poles": (-1, -2, -3, math.nan)}, "poles must have a negative real part"),
    (PolePlacement, {"poles": (-1, -2, -3 + 1j, -3 + 1j)}, "poles must come in conjugate pairs"),
    (PolePlacement, {"poles": (-1, -2, -3, "fast")}, "poles must be numbers"),
    (PolePlacement, {"poles": (-2 + 1j, -2, -3, -4, -2 - 1j, -2, -3, -4)}, "poles .* conjugate"),
    (LQR, {"Q": (0, 1, 1, 1, 1, 1, 1, 1)}, "Q .* leaves a motion without control"),
    (LQR, {"Q": (0,) * 8}, "Q .* leaves a motion without control"),
    (LQR, {"Q": (1,) * 8, "rho": 100}, "Q replaces rho and kappa"),
    (LQR, {"reference": "angle"}, 'reference must be "position" or "velocity"'),
    (InternalModel, {"frequencies": (1.0, 1.0)}, "frequencies must differ"),
    (StableInversion, {"Q": (0, 1, 1, 1)}, "Q must have a positive weight of eta"),
    (Luenberger, {"poles": (-8, -10, -14)}, "poles must be 4 or 8 numbers, got 3"),
    (Luenberger, {"poles": (-8, -8, -8, -16)}, "poles may coincide in pairs, no more"),
    (NonlinearLuenberger, {"poles": (-8, -10, -14)}, "poles must be 4 or 8 numbers, got 3"),
    (NonlinearLuenberger, {"plate_poles": (-8, -10, -14)}, "poles must be 2 numbers, got 3"),
    (NonlinearLuenberger, {"plate_poles": (-8, 10)}, "poles must have a negative real part"),
    (Smith, {"observer": FrictionKalman()}, ".* makes up for the dead time itself"),
    (Sine, {"omega": 0}, "omega must "),
    (Sine, {"wave": ("sin", "tan")}, "wave must "),
    (Circle, {"omega": 0}, "omega must "),
    (Lissajous, {"omega": (0.5, 0)}, "omega must "),
    (Path, {"points": ((0, 0),)}, "points must "),
    (Path, {"points": ((0, 0), (0.1, 0)), "closed": True}, "points must "),
    (Path, {"points": ((0, 0), (0, 0), (0.1, 0))}, "points must "),
    (Path, {"duration": 8, "ramp": 5}, "ramp must "),
    (Setpoints, {"points": ()}, "points must have at least one goal"),
    (Setpoints, {"points": ((0, 0, 0), (0, 1, 1))}, "points must rise in time, got 0 and 0 s"),
    (Setpoints, {"before": {"kind": "setpoints"}}, "before: no reference 'setpoints'"),
    (Setpoints, {"before": {"kind": "circle", "radius": 1}}, "before: .*radius"),
]


@pytest.mark.parametrize(("kind", "wrong", "said"), REFUSED)
def test_settings_that_cannot_be_are_refused_in_one_line(kind, wrong, said):
    with pytest.raises(ValueError, match=rf"\A{said}.*\Z"):
        kind(**wrong)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["controller.kind=afl", "controller.gains=[1,1,-1,9]"], "unstable"),
        (["controller.kind=pole_placement", 'controller.poles=["-1+1j",-2,-3,-4]'], "conjugate"),
        (["controller.kind=backstepping", "controller.c=[1,2,-3,4]"], "c.2: must be greater"),
        (["controller.kind=backstepping", "controller.c=[1,2,3]"], "more values than 3"),
        (["controller.kind=lqr", "controller.Q=[1,2]"], "Q: must have at least 8 values, has 2"),
        (["observer.poles=[-8,-9,-10]"], "4 or 8"),
    ],
)
def test_in_a_scenario_they_are_one_clear_line_too(scenario, overrides, words):
    with pytest.raises(ScenarioError) as caught:
        build_controller(scenario(*overrides))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_gains_too_fast_for_the_period_are_warned_about_with_their_poles(ballplate):
    law = ("--set", "controller.kind=afl", "--set", "controller.poles=[-30,-31,-32,-33]")
    _, _, err = ballplate("run", "hold", "--plant", "lagrange", "--set", "duration=0.1", *law)
    assert "warning: the sampled loop is unstable" in err
    assert "poles" in err
    assert "the ball may be lost: `ballplate run cure` has a law that knows" in err
    assert "and `ballplate tune afl` searches other gains" in err


def test_the_advice_for_an_unstable_loop_states_a_lag_that_the_cure_would_not_find():
    told = []
    reporter = SimpleNamespace(warn=told.append)
    for lag, says in ((0.0, " --set rig.plate_lag=0.07`"), (0.07, "run cure --on hobby`")):
        slow = ("plant.servo.bandwidth_hz=2.27", "controller.kind=pid", f"rig.plate_lag={lag}")
        warn_of_dangers(load("hold", ["parameters=hobby", *slow]), reporter)
        assert says in told[0]
        told.clear()


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
