"""`ballplate`: One circle through every door: the same commands move the ball along the same path.

A door is a function from a ``Circle`` to the path of its ball, and a row of ``DOORS``. That the
command line writes the files of the package is in ``test_run.py``.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import control
import fmpy
import gymnasium
import numpy as np
import pytest
from exported_files import READERS
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import ballplate as bp
from controllers.interfaces import Measurement
from twin.run.controller_building import build_controllers

RATE = 0.5
"""A power of two, so that dividing a rate by it and multiplying again gives the rate."""


@dataclass(frozen=True)
class Circle:
    """A circle, and what the Python package makes of it."""

    settings: list[str]
    """Texts, as on the command line."""
    done: bp.Result
    """``ballplate.run`` of it: the commands are its ``applied_phi_acc`` and ``applied_theta_acc``
    in rad/s^2, one a control period, held."""


class Door(NamedTuple):
    """A way to run the circle.

    Attributes:
        path: Gives the ball (x, y) in m at the beginning of each control period, shape (K, 2).
        within: Largest distance in m from the package's path; 0 where the same code runs.
        plants: The plants of ``PLANTS`` that it has.
    """

    path: Callable[[Circle], np.ndarray]
    within: float
    plants: tuple[str, ...]


PLANTS = {
    "mechanism": ["plant.kind=mujoco"],
    "exact": ["plant.kind=lagrange"],
    "frictionless": ["plant.kind=lagrange", "plant.friction.rolling_mm=0"],
}


def by_periods(circle):
    """python-control, from one control period to the next."""
    found = control.input_output_response(
        bp.systems.exact("circle", circle.settings), circle.done.time, commands(circle)
    )
    return np.array(found.outputs[[0, 4]].T)


def by_differential_equations(circle):
    """python-control's integration with the spin as a state, u being held for each period."""
    plant, t, u = bp.systems.equations(spin=True), circle.done.time, commands(circle)
    x = np.zeros((len(t), 9))
    for k in range(len(t) - 1):
        found = control.input_output_response(
            plant, t[k : k + 2], np.repeat(u[:, [k]], 2, axis=1), x[k],
            solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-12},
        )  # fmt: skip
        x[k + 1] = found.states[:, -1]
    return x[:, [0, 4]]


def by_gymnasium(circle):
    """An environment under the scenario's controller, and once more under its actions alone."""
    env = gymnasium.make(
        "ballplate.gym:ballplate/Track-v0", hold=1, rate=RATE, settings=circle.settings
    ).unwrapped
    seed = circle.done.scenario.seed
    observation, info = env.reset(seed=seed)
    controller = build_controllers(env.rigs.episodes.scenarios)
    controller.start(seen_by_controller(observation, info["time"]))
    states, actions, over = [info["state"]], [], False
    now = seen_by_controller(observation, info["time"])
    while not over:
        actions.append(controller.command(now).rate[0] / RATE)
        observation, _, terminated, over, info = env.step(actions[-1])
        assert not terminated
        controller.applied(observation[None, 4:6])
        now = seen_by_controller(observation, info["time"])
        states.append(info["state"])
    env.reset(seed=seed)
    again = [env.step(action)[4]["state"] for action in actions]
    np.testing.assert_array_equal(again, states[1:])
    return np.array(states)[:-1, [0, 4]]


def seen_by_controller(observation, time):
    rows = np.atleast_2d(observation)
    return Measurement(time, rows[:, :4], rows[:, 6], rows[:, 7] > 0)


def commands(circle):
    return np.stack([circle.done["applied_phi_acc"], circle.done["applied_theta_acc"]])


DOORS = {
    "Gymnasium": Door(by_gymnasium, 0.0, ("mechanism", "exact")),
    "python-control, sampled": Door(by_periods, 1e-6, ("exact", "frictionless")),
    "python-control, continuous": Door(by_differential_equations, 1e-6, ("frictionless",)),
}


CASES = [(name, plant) for name, door in DOORS.items() for plant in door.plants]


@pytest.fixture(scope="module", params=[2.0, pytest.param(25.0, marks=pytest.mark.long)])
def circles(request):
    """The circle on a plant, run when it is first asked for, and how long it takes in s."""

    @cache
    def on(plant):
        settings = [*PLANTS[plant], f"duration={request.param:g}", "baseline=false"]
        return Circle(settings, bp.run("circle", settings))

    return on, request.param


@pytest.mark.short(
    "2.0-Gymnasium, exact",
    "2.0-python-control, sampled, exact",
    "2.0-python-control, sampled, frictionless",
)
@pytest.mark.parametrize(("name", "plant"), CASES, ids=[", ".join(case) for case in CASES])
def test_the_same_circle_goes_through_every_door(name, plant, circles):
    on, seconds = circles
    circle, door = on(plant), DOORS[name]
    expected, path = circle.done.ball, door.path(circle)
    assert path.shape == expected.shape == (round(seconds / 0.002), 2)
    if door.within == 0:
        assert path.tobytes() == expected.tobytes()
    else:
        assert np.hypot(*(path - expected).T).max() <= door.within
    assert np.abs(path).max() > 1e-4
    if seconds > 20:
        swept = np.ptp(np.unwrap(np.arctan2(*path[circle.done.time > 10].T)))
        assert swept == pytest.approx(0.75 * (seconds - 10), abs=0.3)


STILL = {
    "plant.kind": "lagrange",
    "duration": 0.12,
    "metrics.start": 0,
    "sensors.touch.dead_time": 0,
    **{f"{key}.variance": [0, 0] for key in ("sensors.touch", "sensors.encoders", "disturbance")},
}


@pytest.fixture(scope="module")
def as_fmu(tmp_path_factory):
    """The rig as an FMU, and the unit of each of its variables."""
    file = bp.fmu("circle", tmp_path_factory.mktemp("fmu") / "rig.fmu", STILL)
    about = fmpy.read_model_description(str(file))
    return file, {each.name: each.unit or "1" for each in about.modelVariables}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@settings(max_examples=8, deadline=None, phases=[Phase.generate])
@given(
    place=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.1, 0.1)),
    speed=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    wishes=st.lists(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)), min_size=6, max_size=6),
)
def test_every_way_out_gives_the_same_si_numbers_and_units(as_fmu, place, speed, wishes):
    """Files, FMU, python-control and Gymnasium, all of one run under commands at random."""
    ball = dict(zip(("x", "y", "x_rate", "y_rate"), (*place, *speed), strict=True))
    keys = STILL | {f"plant.start.{name}": value for name, value in ball.items()}
    rates = np.repeat(wishes, 10, axis=0)
    with bp.rig("circle", keys) as rig:
        for rate in rates:
            rig.step(rate)
    done = rig.result()
    true = [name for name in done if name.startswith("true_")]
    with tempfile.TemporaryDirectory() as folder:
        for ending, read in READERS.items():
            columns, units = read(done.export(Path(folder) / f"run{ending}"))
            assert units == done.units, ending
            for name in done:
                np.testing.assert_array_equal(columns[name], done[name], err_msg=ending + name)
    file, units = as_fmu
    rows = [(*each, *rate) for each, rate in zip(done.time[:, None], rates, strict=True)]
    said = np.array(rows, [(name, float) for name in ("time", "rate_phi", "rate_theta")])
    start = {"noise": False, **{f"plant.start.{name}": value for name, value in ball.items()}}
    found = fmpy.simulate_fmu(
        str(file), input=said, start_values=start, output=true, stop_time=0.118,
        output_interval=0.002,
    )  # fmt: skip
    for name in true:
        assert units[name] == done.units[name]
        np.testing.assert_allclose(found[name], done[name], rtol=0, atol=1e-9, err_msg=name)
    plant = bp.systems.exact("circle", keys)
    first = [done[name][0] for name in true]
    u = np.stack([done["applied_phi_acc"], done["applied_theta_acc"]])
    answer = control.input_output_response(plant, done.time, u, first)
    env = gymnasium.make(
        "ballplate.gym:ballplate/Track-v0", hold=1, rate=RATE, settings=keys
    ).unwrapped
    states = [env.reset(seed=0)[1]["state"]]
    states += [env.step(rate / RATE)[4]["state"] for rate in rates[:-1]]
    for number, name in enumerate(true):
        own = name.removeprefix("true_")
        assert plant.output_labels[number] == own
        assert bp.systems.UNITS[own] == done.units[name]
        np.testing.assert_allclose(answer.outputs[number], done[name], atol=1e-12, err_msg=name)
        np.testing.assert_array_equal(np.array(states)[:, number], done[name], err_msg=name)
