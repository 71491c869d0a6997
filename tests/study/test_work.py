"""`twin.study.work`.

Scenarios of a study's points, and their physics step: 2 ms where that is known to hold."""

from __future__ import annotations

import json

import pytest

from twin.base.errors import ScenarioError
from twin.base.shipped import find, shipped_in
from twin.scenario import load
from twin.study.schema import Study, read
from twin.study.work import Builder, Work


def work(*given: str, parameters: dict[str, object] | None = None, **about: object) -> Work:
    return Work(
        Study.model_validate(
            {
                "title": "step",
                "scenario": "circle",
                "set": list(given),
                "method": "grid",
                "parameters": parameters or {"plant.friction.rolling_mm": {"values": [0.1, 0.2]}},
            }
            | about
        )
    )


def steps(made: Work) -> list[float]:
    return [json.loads(job.scenario)["plant"]["step"] for job in made.jobs(made.tasks)]


def test_a_study_runs_at_2_ms_and_a_single_run_at_1_ms() -> None:
    assert steps(work()) == [0.002, 0.002]
    assert work().steps == {0.002}
    assert load("circle").plant.step == 0.001


@pytest.mark.parametrize("name", sorted(shipped_in("studies")))
def test_every_shipped_study_runs_at_2_ms(name: str) -> None:
    about = read(name)
    few = about.samples if about.method == "grid" else 2
    assert Work(about.model_copy(update={"samples": few})).steps == {0.002}


@pytest.mark.parametrize("where", ["set", "variant", "parameter", "file", "parameters"])
def test_a_study_that_says_its_step_keeps_it(where: str, tmp_path) -> None:
    # 1 ms is the default of a scenario, too: what counts is that it is said
    if where == "set":
        made = work("plant.step=0.001")
    elif where == "variant":
        made = work(variants=[{"name": "fine", "set": ["plant.step=0.001"]}])
    elif where == "parameter":
        made = work(parameters={"plant.step": {"values": [0.001]}})
    else:
        rig = tmp_path / "rig.toml"
        rig.write_text("[plant]\nstep = 0.001\n")
        if where == "parameters":
            made = work(f"parameters={rig}")
        else:
            text = find("circle").read_text(encoding="utf-8")
            rig.write_text(text + "\n[plant]\nstep = 0.001\n")
            made = work(scenario=str(rig))
    assert set(steps(made)) == {0.001}


def test_a_variant_with_a_scenario_of_its_own_is_that_one_at_the_study_s_points() -> None:
    own = {"name": "cure", "scenario": "cure", "set": ["controller.spread=1.1"]}
    made = work("duration=3.0", variants=[{"name": "afl"}, own])
    runs = [made.scenario(task) for task in made.tasks]
    for run, rolling in zip(runs[1::2], (0.1, 0.2), strict=True):
        cure = load("cure", ["duration=3.0", "controller.spread=1.1", "plant.step=0.002", "seed=0"])
        assert run.controller == cure.controller
        assert run.observer == cure.observer
        assert run.plant.friction.rolling_mm == rolling
        assert run.duration == 3.0
    assert [run.controller.kind for run in runs[::2]] == ["afl", "afl"]


@pytest.mark.parametrize(
    ("setting", "step"),
    [
        ("plant.kind=lagrange", 0.001),
        ("plant.wheels.stiffness=6e5", 0.001),
        ("plant.wheels.stiffness=5e5", 0.002),
        ("plant.wheels.damping_ratio=0.5", 0.001),
        ("rig.period=0.005", 0.001),
        ("rig.period=0.004", 0.002),
        ("rig.period=0.001", 0.001),
    ],
)
def test_where_2_ms_is_not_known_to_hold_the_scenario_s_own_step_stays(setting, step) -> None:
    assert steps(work(setting)) == [step, step]


def test_the_step_is_in_the_key_of_a_run() -> None:
    coarse, fine = (work(*given).tasks[0] for given in ((), ("plant.step=0.001",)))
    assert coarse.key != fine.key
    assert coarse.alike != fine.alike
    assert work("plant.step=0.002").tasks[0].key == coarse.key


def test_a_law_that_says_nothing_of_a_key_has_its_default() -> None:
    build = Builder("circle")
    fixed = ("controller.kind=tvlqr",)
    assert build.value(fixed, "controller.Q.1") == 2000.0
    assert build.value((*fixed, "controller.Q=[1.0, 2.0, 3.0, 4.0]"), "controller.Q.1") == 2.0
    changed = build(fixed, {"controller.Q.1": 0.5}, {"controller.Q.1"})
    assert changed.controller.settings["Q"] == [20000.0, 1000.0, 100.0, 10.0]


def test_what_a_law_must_be_told_has_no_default() -> None:
    with pytest.raises(ScenarioError, match=r"controller\.frequency: not given"):
        Builder("circle").value(("controller.kind=tvlqr",), "controller.frequency")
