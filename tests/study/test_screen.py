"""`twin.study.screen` and `twin.study.screen_report`.

A screened study with functions in the place of the plants, and its refusals."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pyarrow as pa
import pytest

import ballplate as bp
from ballplate.studies import screen_of
from twin.base.errors import ScenarioError
from twin.run.indicators import MOTION_INDICATORS
from twin.study import compiled
from twin.study.answers import answers
from twin.study.experiments import ROW_SCHEMA
from twin.study.report import write
from twin.study.schema import Study
from twin.study.screen import CHECKED_POINTS, Screen, Screened
from twin.study.screen_report import blocks, numbers_of, write_rows
from twin.study.work import Design, Work

ROLLING, PRELOAD, SPEED = (
    "plant.friction.rolling_mm",
    "plant.spring.preload",
    "plant.start.x_rate",
)
UNIFORM = {
    ROLLING: {"uniform": (0.1, 0.3)},
    PRELOAD: {"uniform": (50.0, 150.0)},
    SPEED: {"uniform": (-1.0, 1.0)},
}
BIAS = -0.7


def study(method: str = "montecarlo", samples: int = 32, **more) -> Study:
    about = {"title": "t", "scenario": "hold", "method": method, "samples": samples}
    fixed = {"set": ("baseline=false", "duration=0.1"), "parameters": UNIFORM}
    return Study.model_validate(about | fixed | more)


def value(plant: dict, seed: int) -> float:
    """What a run gives: on the exact equations biased, and without the preload."""
    found = 10 * plant["friction"]["rolling_mm"] + plant["start"]["x_rate"] + seed
    if plant["kind"] == "lagrange":
        return float(found + BIAS)
    return float(found + 0.001 * plant["spring"]["preload"])


class Runs:
    """Carries runs out by ``value``; those beyond a limit fall."""

    def __init__(self, mechanism_limit: float = math.inf, exact_limit: float = math.inf) -> None:
        self.works = list[Work]()
        self.limits = {"mujoco": mechanism_limit, "lagrange": exact_limit}

    def __call__(self, work: Work) -> pa.Table:
        self.works.append(work)
        rows = []
        for job in work.jobs(work.tasks):
            about = json.loads(job.scenario)
            found = value(about["plant"], about["seed"])
            good = found <= self.limits[about["plant"]["kind"]]
            row = {**dict.fromkeys(MOTION_INDICATORS), "key": job.key, "reason": ""}
            row["outcome"] = "finished" if good else "fell"
            row["tracking_error_percent"] = found if good else None
            rows.append(row)
        return pa.Table.from_pylist(rows, ROW_SCHEMA)


def screened(about: Study, times: int = 3, runs: Runs | None = None) -> tuple[Screened, Runs]:
    runs = runs or Runs()
    work = Work(about)
    return Screen(work, times).carry_out(runs(work), runs), runs


@pytest.mark.parametrize("method", ["montecarlo", pytest.param("sobol", marks=pytest.mark.long)])
def test_a_bias_is_found_and_the_mechanism_estimated_without_it(method):
    found, (_, paired, wide, checked) = (each := screened(study(method)))[0], each[1].works
    (bias,) = found.biases
    assert bias.indicator == "tracking_error_percent"
    # the preload, 50 to 150, adds 0.1 on average that the exact equations do not have
    low, high = bias.difference.low, bias.difference.high
    assert low < BIAS - 0.1 < high
    assert high - low < 0.2
    assert bias.correlation > 0.99
    mean = next(each for each in found.joined if each.statistic == "mean")
    assert mean.joined.low < 2.1 < mean.joined.high
    assert mean.joined.width < 0.7 * mean.alone.width
    assert found.left_out == (PRELOAD,)
    assert len(wide.design) == 3 * len(paired.design)
    assert found.counts["checked"] == len(checked.tasks) == 2 * CHECKED_POINTS


@pytest.mark.long
def test_further_points_are_others_than_the_studys():
    _, runs = screened(study())
    own, wide = runs.works[0].design.columns[ROLLING], runs.works[2].design.columns[ROLLING]
    assert not set(own.tolist()) & set(wide.tolist())
    assert np.unique(wide).size == len(wide)


@pytest.mark.long
def test_the_points_at_the_ends_are_checked_on_the_mechanism():
    found, runs = screened(study("sobol", 16))
    exact = sorted({value(json.loads(job.scenario)["plant"], 0) for job in jobs(runs.works[2])})
    assert [each.exact for each in found.checked if each.which == "worst"] == exact[:-6:-1]
    assert [each.exact for each in found.checked if each.which == "best"] == exact[:5]
    for each in found.checked:
        assert each.mechanism == pytest.approx(each.exact - BIAS + 0.001 * each.point[PRELOAD])


def jobs(work: Work):
    return work.jobs(work.tasks)


@pytest.mark.long
def test_sobol_indices_come_from_both_plants():
    found, _ = screened(study("sobol", 64))
    indices = {each.statistic: each for each in found.joined if each.statistic in UNIFORM}
    variances = {ROLLING: 2**2 / 12, PRELOAD: 0.1**2 / 12, SPEED: 2**2 / 12}
    for key, each in indices.items():
        truth = variances[key] / sum(variances.values())
        assert each.joined.low - 1e-3 < truth < each.joined.high + 1e-3
    assert indices[ROLLING].joined.width < 0.7 * indices[ROLLING].alone.width


@pytest.mark.long
def test_points_that_fail_on_one_plant_only_leave_no_estimate_from_both():
    found, _ = screened(study(), runs=Runs(mechanism_limit=3.0))
    assert not found.joined
    assert "a run fails on one of them only" in found.notes[0]
    assert found.biases


@pytest.mark.long
def test_rows_of_all_runs_beyond_the_studys_are_written(tmp_path):
    found, runs = screened(study(), 3)
    write_rows(found, tmp_path)
    with (tmp_path / "screened.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    parts = dict(zip(("paired", "wide", "checked"), runs.works[1:], strict=True))
    for part, work in parts.items():
        own = [row for row in rows if row["part"] == part]
        plant = "mujoco" if part == "checked" else "lagrange"
        assert {row["plant"] for row in own} == {plant}
        shown = [(float(row[ROLLING]), float(row["tracking_error_percent"])) for row in own]
        told = [json.loads(job.scenario) for job in jobs(work)]
        rolling = [each["plant"]["friction"]["rolling_mm"] for each in told]
        values = [value(each["plant"], each["seed"]) for each in told]
        assert np.array(shown) == pytest.approx(np.column_stack((rolling, values)))
    assert len(rows) == sum(len(work.tasks) for work in parts.values())


@pytest.mark.long
def test_failed_points_are_the_worst():
    found, _ = screened(study(), runs=Runs(exact_limit=2.0))
    assert all(math.isnan(each.exact) for each in found.checked if each.which == "worst")


@pytest.mark.long
def test_variants_are_compared_on_both_plants():
    both = ({"name": "a"}, {"name": "b", "set": ("plant.start.y=0.01",)})
    found, _ = screened(study(samples=8, variants=both, seeds=2), 2)
    (mean,) = (each for each in found.joined if each.variant == "a minus b")
    assert mean.joined.value == pytest.approx(0.0, abs=1e-12)
    assert {each.variant for each in found.biases} == {"a", "b"}


def test_a_page_and_json_show_all_of_it(tmp_path):
    about, runs = study("sobol", 16), Runs()
    work = Work(about)
    rows = runs(work)
    found = Screen(work, 2).carry_out(rows, runs)
    write(work, rows, answers(work, rows), tmp_path, blocks(about, found))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in ("exact minus mechanism", "both plants", "at the ends", PRELOAD):
        assert words in page
    assert json.loads(json.dumps(numbers_of(found), allow_nan=False))["left_out"] == [PRELOAD]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"method": "grid"}, "screen: method must be montecarlo or sobol, .* got grid"),
        ({"method": "lhs"}, "screen: method must be montecarlo or sobol, .* got lhs"),
        ({"set": ("plant.kind=lagrange",), "parameters": {ROLLING: UNIFORM[ROLLING]}}, "already"),
        ({"set": ("plant.spring.preload=50",)}, "the exact equations have no spring"),
        ({"parameters": {PRELOAD: UNIFORM[PRELOAD]}}, "have none of the study's parameters"),
    ],
)
def test_what_cannot_be_screened_is_refused_in_one_line(more, words):
    tables = study(samples=4).model_dump(exclude_unset=True) | more
    with pytest.raises(ScenarioError, match=words) as refused:
        bp.study(tables, screen=2, processes=1)
    assert "\n" not in str(refused.value)
    for wrong in (1, 2.5, "x"):
        with pytest.raises(ScenarioError, match="screen: must be a whole number from 2 to 1000"):
            Screen(Work(study(samples=4)), wrong)
    with pytest.raises(ScenarioError, match="engine c: not with screen"):
        bp.study(study(samples=4).model_dump(exclude_unset=True), screen=2, engine="c")


def test_python_simulates_what_c_does_not_know(monkeypatch):
    engines = []
    for more in ((), ("controller.kind=mpc",)):
        work = Work(study(samples=4, set=("baseline=false", "duration=0.1", *more)))
        engines.append(screen_of("t", work, 2).engine)
    monkeypatch.setattr(compiled, "find_c_compiler", lambda: None)
    engines.append(screen_of("t", Work(study(samples=4)), 2).engine)
    assert engines == ["c", "python", "python"]


@pytest.mark.short("controller.kind-values1-python", "controller.computing_time-*")
@pytest.mark.parametrize(
    ("key", "values", "engine"),
    [
        ("controller.kind", ("afl", "lqr"), "c"),
        ("controller.kind", ("afl", "mpc"), "python"),
        ("controller.computing_time", (0.0, 0.001), "python"),
        ("rig.limits.rate_deg", range(20, 21 + compiled.MOST_CONTROLLERS), "python"),
    ],
)
def test_c_is_chosen_only_if_it_knows_every_point(monkeypatch, key, values, engine):
    monkeypatch.setattr(compiled, "find_c_compiler", lambda: "cc")
    fixed = ("baseline=false", "duration=0.1")
    about = study(samples=len(values), set=fixed, parameters={key: {"values": tuple(values)}})
    every = Design({key: np.array(values)})
    for own, further in ((every, every[:1]), (every[:1], every)):  # the first suits C
        monkeypatch.setattr("twin.study.screen.points", lambda *_, further=further: further)
        assert screen_of("t", Work(about, design=own), 2).engine == engine


@pytest.mark.long
def test_as_many_runs_are_checked_at_most_as_a_plan_says():
    both = ({"name": "a"}, {"name": "b", "set": ("plant.start.y=0.01",)})
    for samples, seeds, expected in ((2, 1, 8), (8, 2, 40)):
        about = study(samples=samples, variants=both, seeds=seeds)
        _, runs = screened(about, 2)
        assert len(runs.works[3].tasks) == Screen(Work(about), 2).most_checked == expected


@pytest.mark.long
def test_a_study_of_both_plants_is_screened_from_its_runs_on(tmp_path):
    about = study("montecarlo", 8).model_dump(exclude_unset=True)
    about["set"] = ("baseline=false", "duration=1.0")
    about["metrics"] = ("rms_error",)
    about["parameters"] = {**UNIFORM, SPEED: {"uniform": (-0.05, 0.05)}}  # none falls
    found = bp.study(about, screen=2, processes=1, out=tmp_path)
    again = bp.study(about, screen=2, processes=1, out=tmp_path, reporter=None)
    assert found.screened == again.screened
    bias = {each.indicator: each for each in found.screened.biases}["rms_error"]
    assert abs(bias.difference.value) < 0.05 * bias.mean
    assert "exact minus mechanism" in (tmp_path / "report.html").read_text(encoding="utf-8")
