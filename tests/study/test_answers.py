"""`twin.study.answers`: Answers of functions whose sensitivity is known in closed form."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from twin.run.indicators import MOTION_INDICATORS
from twin.study.answers import Answer, answers, sobol_indices, spread, wilson
from twin.study.experiments import Store, carry
from twin.study.report import in_order, sentences, write
from twin.study.schema import Study
from twin.study.work import SOBOL_DESIGNS, Job, Row, Work, quantiles

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
    return {
        **dict.fromkeys(MOTION_INDICATORS),
        "tracking_error_percent": value if good else None,
        **outcome,
    }


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


ISHIGAMI_VARIANCES = (
    0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2, 49 / 8, 0.01 * np.pi**8 * 8 / 225
)  # fmt: skip
"""Of the first and the second parameter, and of the first with the third: Ishigami, Homma 1990."""


def seeded(monkeypatch, about: Study, seed: int) -> np.ndarray:
    """The quantiles of a study whose designs have a seed of their own."""
    monkeypatch.setattr("twin.study.work.DESIGN_SEED", seed)
    return quantiles(about)


@pytest.mark.long
def test_the_95_percent_intervals_of_sobol_indices_hold_the_truth_in_95_percent(monkeypatch):
    v1, v2, v13 = ISHIGAMI_VARIANCES
    truth = np.array([v1 + v13, v2, v13]) / (v1 + v2 + v13)
    about, held, halves, off = study("sobol", 256), [], [], []
    for seed in range(200):
        a, b, c = 2 * np.pi * seeded(monkeypatch, about, seed).T - np.pi
        values = np.sin(a) + 7 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)
        designs = values.reshape(SOBOL_DESIGNS, -1, 5)
        _, total, half = sobol_indices(designs)
        halves.append(half)
        off.append(total - truth)
        held.append(np.abs(off[-1]) <= half)
    # 95 % of 3 times 200, and three standard deviations of that share
    assert np.mean(held) == pytest.approx(0.95, abs=3 * np.sqrt(0.95 * 0.05 / 600))
    assert all(0.92 <= share <= 0.98 for share in np.mean(held, axis=0))
    # as wide as the estimates scatter, where a bootstrap gives 0.3; and they are not too large
    assert np.median(halves) < 0.1
    assert np.abs(np.mean(off, axis=0)).max() < 4 * np.std(off, axis=0).max() / np.sqrt(200)


def test_the_points_of_a_sobol_design_are_pairs_and_their_mixtures():
    about = study("sobol", 64)
    blocks = quantiles(about).reshape(64, 5, 3)
    at_a, at_b = blocks[:, 0], blocks[:, -1]
    for k in range(3):
        mixed = at_a.copy()
        mixed[:, k] = at_b[:, k]
        assert np.array_equal(blocks[:, k + 1], mixed)
    # every design by itself fills each coordinate evenly, and no two are the same
    for ends in (at_a, at_b):
        cells = np.sort(np.floor(8 * ends.reshape(SOBOL_DESIGNS, 8, 3)), axis=1)
        assert np.array_equal(cells, np.broadcast_to(np.arange(8)[:, None], cells.shape))
    assert len(np.unique(at_a, axis=0)) == 64


@pytest.mark.long
def test_sobol_indices_of_ishigamis_function_are_those_in_closed_form(tmp_path) -> None:
    found = answered(study("sobol", 1024), ishigami, tmp_path)
    v1, v2, v13 = ISHIGAMI_VARIANCES
    whole = v1 + v2 + v13
    total = [index.value for index in found.indices]
    first = [index.first for index in found.indices]
    assert total == pytest.approx([(v1 + v13) / whole, v2 / whole, v13 / whole], abs=0.05)
    assert first == pytest.approx([v1 / whole, v2 / whole, 0], abs=0.05)
    assert all(index.decided for index in found.indices)


@pytest.mark.long
def test_the_interval_of_an_index_holds_the_truth_and_an_undecided_one_is_called_so(
    tmp_path,
) -> None:
    about = study("sobol", 64)
    found = answered(about, lambda a, b, c: a + 2 * b + 3 * (c > 3.0), tmp_path, page=True)
    rare = (np.pi - 3.0) / (2 * np.pi)
    variances = np.array([np.pi**2 / 3, 4 * np.pi**2 / 3, 9 * rare * (1 - rare)])
    for index, truth in zip(found.indices, variances / variances.sum(), strict=True):
        assert abs(index.value - truth) <= 2 * index.half  # once each: 0.2 % of such tests fail
    assert [index.matters for index in found.indices] == [True, True, False]
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


@pytest.mark.long
def test_a_parameter_without_effect_is_negligible_and_not_undecided(tmp_path) -> None:
    about = study("sobol", 64)
    found = answered(about, lambda a, b, c: a + 2 * b + 0.01 * c, tmp_path)
    assert [index.negligible for index in found.indices] == [False, False, True]
    assert sentences(about, [found])[-1] == f"Negligible, an index below 0.01: {KEYS[2]}."


def test_a_study_whose_runs_are_all_alike_has_no_indices_and_says_why(tmp_path) -> None:
    found = answered(study("sobol", 16), lambda *_: 1.0, tmp_path, page=True)
    assert found.indices == ()
    assert found.notes == ("no indices, because the runs of a design do not differ",)


@pytest.mark.long
def test_the_chance_to_fail_counts_points_that_were_drawn_and_not_their_mixtures(tmp_path):
    # who fails by one parameter alone fails at almost every mixture of a point, too
    about = study("sobol", 64)
    found = answered(about, lambda a, b, c: np.nan if c > 2 else a + b, tmp_path)
    low, high = found.whole.chance
    assert low < (np.pi - 2) / (2 * np.pi) < high
    assert high - low > 2 * 1.9 * np.sqrt(0.18 * 0.82 / 128)
    twice = study("lhs", 40, seeds=2)
    same = answered(twice, lambda a, b, c: np.nan if c > 2 else a + b, tmp_path)
    points = same.whole.failed // 2
    assert same.whole.chance == wilson(np.repeat((1.0, 0.0), (points, 40 - points)))


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
    assert "10 of 10 runs did not finish" in page
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
