"""What a study says of functions whose sensitivity is known in closed form."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from twin.run.files import METRICS
from twin.study.experiments import Store, carry
from twin.study.report import Answer, answers, in_order, sentences, spread, write
from twin.study.schema import Study
from twin.study.work import Job, Row, Work

KEYS = ("plant.start.x_rate", "plant.start.y_rate", "plant.start.spin")
Function = Callable[[float, float, float], float]


def study(method: str, samples: int, low: float = -np.pi, high: float = np.pi, **more) -> Study:
    parameters = {key: {"uniform": (low, high)} for key in KEYS}
    about = {"title": "known", "scenario": "hold", "method": method, "samples": samples}
    return Study.model_validate({**about, "parameters": parameters} | more)


def answered(about: Study, function: Function, folder: Path, *, page: bool = False) -> Answer:
    """The answer of the whole pipeline, with a function in the place of the twin.

    Each method's page is written once; the other answers are looked at as they are.
    """

    def do(jobs: Sequence[Job]) -> list[Row]:
        return [row(job, function) for job in jobs]

    work = Work(about)
    rows = carry(work, Store(folder), processes=1, do=do)
    (found,) = answers(work, rows)
    if page:
        write(work, rows, [found], folder)
    return found


def row(job: Job, function: Function) -> Row:
    start = json.loads(job.scenario)["plant"]["start"]
    value = function(start["x_rate"], start["y_rate"], start["spin"])
    good = np.isfinite(value)
    outcome = {"key": job.key, "outcome": "finished" if good else "fell", "reason": ""}
    return {**dict.fromkeys(METRICS), "tracking_error_percent": value if good else None, **outcome}


def test_a_whole_number_that_decides_is_ranked_and_a_seed_without_effect_is_not(tmp_path):
    whole = {"plant.start.spin": {"integers": [-3, 3]}, "seed": {"integers": [1, 50]}}
    about = study("montecarlo", 60, parameters=whole)
    answer = answered(about, lambda a, b, c: c, tmp_path)
    found = {each.key: each for each in answer.indices}
    assert found["plant.start.spin"].value > 0.99
    assert found["plant.start.spin"].decided
    assert not found["seed"].decided


def ishigami(a: float, b: float, c: float) -> float:
    return float(np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a))


@pytest.mark.long
def test_sobol_indices_of_ishigamis_function_are_those_in_closed_form(tmp_path) -> None:
    # Ishigami and Homma 1990 with a = 7, b = 0.1
    found = answered(study("sobol", 1024), ishigami, tmp_path)
    v1, v2, v13 = 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.01 * np.pi**8 * 8 / 225
    whole = v1 + v2 + v13
    total = [index.value for index in found.indices]
    first = [index.first for index in found.indices]
    assert total == pytest.approx([(v1 + v13) / whole, v2 / whole, v13 / whole], abs=0.05)
    assert first == pytest.approx([v1 / whole, v2 / whole, 0], abs=0.05)
    assert all(index.decided for index in found.indices)


def test_the_interval_of_an_index_holds_the_truth_and_an_undecided_one_is_called_so(
    tmp_path,
) -> None:
    about = study("sobol", 64)
    found = answered(about, lambda a, b, c: a + 2 * b + (c > 3.05), tmp_path, page=True)
    rare = (np.pi - 3.05) / (2 * np.pi)
    variances = np.array([np.pi**2 / 3, 4 * np.pi**2 / 3, rare * (1 - rare)])
    for index, truth in zip(found.indices, variances / variances.sum(), strict=True):
        assert abs(index.value - truth) <= index.half
    assert [index.decided for index in found.indices] == [True, True, False]
    assert any("Undecided" in line and KEYS[2] in line for line in sentences(about, [found]))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "undecided" in page
    table = page[page.index("Indices") :]
    for index in found.indices[:2]:  # with its interval, as text
        row = table[table.index(index.key) :]
        row = row[: row.index("</tr>")]
        assert f"{index.value:.3g}" in row
        assert f"{index.half:.3g}" in row


@pytest.mark.long
@pytest.mark.parametrize("method", ["lhs", "montecarlo"])
def test_rank_correlation_of_a_rising_function_of_one_parameter_is_one(tmp_path, method) -> None:
    function = lambda a, b, c: np.exp(a) + 0 * b * c  # noqa: E731
    found = answered(study(method, 60), function, tmp_path, page=True)
    assert found.indices[0].value == pytest.approx(1)
    assert [index.decided for index in found.indices] == [True, False, False]


def test_curves_of_a_grid_have_the_slope_of_the_function(tmp_path) -> None:
    about = study("grid", 3, 0.0, 1.0)
    found = answered(about, lambda a, b, c: (4 + b) * a + c, tmp_path)
    assert len(found.curves) == 9
    for curve in found.curves:
        assert curve.slope == pytest.approx(4 + curve.where[KEYS[1]])


def test_failed_runs_are_counted_and_kept_out_of_the_averages() -> None:
    whole = spread(np.array([1.0, 2.0, 3.0, np.nan, np.nan]))
    assert (whole.median, whole.runs, whole.failed) == (2.0, 5, 2)
    # Wilson's interval of 2 in 5
    assert whole.chance == pytest.approx((0.118, 0.769), abs=1e-3)


def test_the_best_variant_is_not_the_one_whose_bad_runs_all_failed() -> None:
    steady = np.array([2.0, 3.0, 4.0, 5.0])
    lucky = np.array([1.0, np.nan, np.nan, np.nan])
    found = [Answer(name, spread(of), values=of) for name, of in (("a", lucky), ("b", steady))]
    assert [each.variant for each in in_order(found)] == ["b", "a"]
    assert "failed run is worse than any other: b 3.5, a 1" in sentences(study("lhs", 4), found)[0]


def test_a_study_none_of_whose_runs_finish_says_so_instead_of_numbers(tmp_path) -> None:
    found = answered(study("lhs", 10), lambda *_: np.nan, tmp_path, page=True)
    assert np.isnan(found.whole.median)
    assert found.whole.failed == 10
    assert found.indices == ()
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "10 of 10 runs did not end well" in page
    assert "nan" not in page.split("<h2>In all")[1].split("<svg")[0].lower()


@pytest.mark.long
def test_blocks_of_a_sobol_design_with_a_failed_run_are_left_out_whole(tmp_path) -> None:
    function = lambda a, b, c: np.nan if c > 3.0 else a + 2 * b  # noqa: E731
    found = answered(study("sobol", 256), function, tmp_path)
    assert any("left out" in note for note in found.notes)
    assert found.indices[1].value == pytest.approx(0.8, abs=0.1)


def test_every_variant_meets_the_same_points_and_seeds() -> None:
    variants = [{"name": "one"}, {"name": "two", "set": ["plant.friction.rolling_mm=0.3"]}]
    work = Work(study("lhs", 4, seeds=2, variants=variants))
    met = {}
    for name in ("one", "two"):
        own = [task for task in work.tasks if task.variant == name]
        starts = [json.loads(job.scenario)["plant"]["start"] for job in work.jobs(own)]
        met[name] = [(t.point, t.seed, s) for t, s in zip(own, starts, strict=True)]
    assert met["one"] == met["two"]
    assert work.different == len(work.tasks) == 16


def test_the_same_study_has_the_same_runs_every_time() -> None:
    one, again = Work(study("sobol", 8)), Work(study("sobol", 8))
    assert one.tasks == again.tasks
    assert one.jobs(one.tasks) == again.jobs(again.tasks)
