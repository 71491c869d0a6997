"""`twin.study.work`.

Runs kept in a table: interrupted, cut differently, changed, carried out elsewhere."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from twin.base.errors import TwinError
from twin.base.jobs import handed_out
from twin.run.indicators import MOTION_INDICATORS
from twin.run.loop import simulate
from twin.scenario import load
from twin.study import experiments as carrying
from twin.study import work
from twin.study.experiments import Store, carry, evaluate, missing, remaining
from twin.study.schema import Study, Variant
from twin.study.work import Job, Row, ScenarioRuns, Work, carry_out


def study(
    values: Sequence[float] = (0.1, 0.15, 0.2, 0.25), seeds: int = 2, law: str = "lqr"
) -> Study:
    return Study.model_validate(
        {
            "title": "short",
            "scenario": "hold",
            "set": ["plant.kind=lagrange", "duration=0.06", f"controller.kind={law}"],
            "method": "grid",
            "seeds": seeds,
            "parameters": {"plant.friction.rolling_mm": {"values": list(values)}},
        }
    )


def carried(about: Study, folder: Path, **how) -> pa.Table:
    return carry(Work(about), Store(folder), **({"processes": 1} | how))


def test_results_do_not_depend_on_how_the_work_is_cut_or_ordered(tmp_path, monkeypatch) -> None:
    whole = carried(study(), tmp_path / "a").sort_by("key")
    monkeypatch.setattr(carrying, "CHUNK_RUNS", 3)
    monkeypatch.setattr(carrying, "MIN_BATCH_RUNS", 1)
    shuffled = Work(study())
    random.Random(1).shuffle(shuffled.tasks)
    rows = carry(shuffled, Store(tmp_path / "b"), processes=1)
    assert rows["key"].to_pylist() == [task.key for task in shuffled.tasks]
    assert rows.sort_by("key") == whole


@pytest.mark.parametrize(
    ("runs", "processes", "largest"),
    [(10, 1, 10), (10, 8, 10), (100, 2, 50), (1000, 2, 64), (2000, 2, 125), (10000, 2, 256)],
)
def test_every_process_has_work_and_many_runs_make_large_batches(runs, processes, largest) -> None:
    task = Work(study()).tasks[0]
    wanted = [task._replace(key=str(index)) for index in range(runs)]
    chunks = missing(wanted, (), processes)
    assert len(chunks[0]) == largest
    assert sorted(int(task.key) for chunk in chunks for task in chunk) == list(range(runs))


def never(_: Sequence[Job]) -> list[Row]:
    """In the place of the twin, where nothing is to be run."""
    raise AssertionError


def test_a_changed_study_runs_only_what_changed(tmp_path) -> None:
    carried(study(), tmp_path)
    ran: list[Job] = []

    def noted(some: Sequence[Job]) -> list[Row]:
        ran.extend(some)
        return carry_out(some)

    carried(study((0.1, 0.15, 0.2, 0.3)), tmp_path, do=noted)
    assert len(ran) == 2
    carried(study(law="afl"), tmp_path, do=noted)
    assert len(ran) == 2 + 8


def test_a_study_that_dies_between_chunks_goes_on_where_it_stopped(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(carrying, "CHUNK_RUNS", 2)
    monkeypatch.setattr(carrying, "MIN_BATCH_RUNS", 1)
    calls = 0

    def dies(some: Sequence[Job]) -> list[Row]:
        nonlocal calls
        calls += 1
        if calls == 3:
            raise KeyboardInterrupt
        return carry_out(some)

    with pytest.raises(KeyboardInterrupt, match="runs kept: 4"):
        carried(study(), tmp_path, do=dies)
    assert len(remaining(Work(study()).tasks, Store(tmp_path), 1)[1]) == 2
    assert carried(study(), tmp_path) == carried(study(), tmp_path / "other")


def test_a_study_that_is_interrupted_before_its_first_chunk_says_so(tmp_path) -> None:
    def interrupted(some: Sequence[Job]) -> list[Row]:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="runs kept: none"):
        carried(study(), tmp_path, do=interrupted)


def test_what_a_killed_writer_left_behind_is_not_read(tmp_path) -> None:
    whole = carried(study(), tmp_path)
    (tmp_path / "chunks" / ".half-x1.parquet").write_bytes(b"PAR1 and no more")
    assert carried(study(), tmp_path, do=never) == whole


def test_a_run_kept_twice_counts_once(tmp_path) -> None:
    whole = carried(study(), tmp_path)
    (chunk,) = (tmp_path / "chunks").glob("*.parquet")
    pq.write_table(pq.read_table(chunk).slice(0, 3), chunk.with_name("again.parquet"))
    assert carried(study(), tmp_path, do=never) == whole


def test_runs_that_are_the_same_are_carried_out_and_counted_once(tmp_path) -> None:
    twice = study().model_copy(update={"variants": (Variant(name="a"), Variant(name="b"))})
    told: list[tuple[int, int]] = []
    work = Work(twice)
    rows = carry(
        work, Store(tmp_path), processes=1, progress=lambda done, bad: told.append((done, bad))
    )
    assert told == [(0, 0), (work.different, 0)] == [(0, 0), (8, 0)]
    assert rows.num_rows == len(work.tasks) == 16
    assert rows["key"].to_pylist() == [task.key for task in work.tasks]


@pytest.mark.parametrize("most", [1, 3])
def test_no_more_is_handed_out_than_can_be_taken(most) -> None:
    made, under_way = 0, []

    def jobs() -> Iterator[tuple[int, int]]:
        nonlocal made
        for number in range(10):
            made += 1
            yield number, number

    found = {}
    with ThreadPoolExecutor(1) as executor:
        for name, future in handed_out(executor, abs, jobs(), most):
            under_way.append(made - len(found))
            found[name] = future.result()
    assert found == {number: number for number in range(10)}
    assert max(under_way) == most


class Flaky(Executor):
    """Loses each chunk so often before it carries it out."""

    def __init__(self, losses: int) -> None:
        self.losses, self.lost = losses, 0

    def submit(self, work, chunk):
        future: Future[list[Row]] = Future()
        if self.lost < self.losses:
            self.lost += 1
            future.set_exception(BrokenProcessPool("a worker died"))
        else:
            future.set_result(work(chunk))
        return future


def test_a_lost_chunk_is_tried_again_and_loses_nothing(tmp_path) -> None:
    assert carried(study(), tmp_path / "a", executor=Flaky(2)) == carried(study(), tmp_path / "b")


def test_a_chunk_that_is_lost_again_and_again_ends_the_study_with_one_line(tmp_path) -> None:
    with pytest.raises(TwinError, match="1 chunk of runs lost 3 times"):
        carried(study(), tmp_path, executor=Flaky(99))


def scenarios():
    hold = ["plant.kind=lagrange", "duration=0.06"]
    kept = [load("hold", [*hold, f"plant.friction.rolling_mm={mm}"]) for mm in (0.1, 0.3)]
    return [*kept, load("hold", [*hold, "plant.start.x=0.34", "plant.start.x_rate=9"])]


LABELS = {"rig": [0, 1, 2], "task": ["one", "one", "flung"]}


@pytest.mark.parametrize("seen", [False, True])
def test_every_run_has_its_labels_and_what_it_gave_in_the_order_asked(tmp_path, seen):
    runs = ScenarioRuns(scenarios(), seen=seen)
    found = evaluate(runs, LABELS, Store(tmp_path), processes=1)
    assert list(found.columns) == ["rig", "task", "outcome", "reason", *MOTION_INDICATORS]
    assert {name: found[name].tolist() for name in LABELS} == LABELS
    assert found["outcome"].tolist() == ["finished", "finished", "fell"]
    alone = [simulate([each], seen=seen)[0]["rms_error"] for each in scenarios()[:2]]
    assert found["rms_error"].tolist()[:2] == alone
    assert found["rms_error"].isna().tolist() == [False, False, True]


@pytest.mark.parametrize("in_memory", [False, True])
def test_a_run_that_is_kept_is_not_made_again_under_other_labels(tmp_path, monkeypatch, in_memory):
    store = Store(None if in_memory else tmp_path)
    first = evaluate(ScenarioRuns(scenarios()), LABELS, store, processes=1)
    monkeypatch.setattr(work, "simulate", None)
    again, kept = ScenarioRuns(scenarios()[::-1]), store if in_memory else Store(tmp_path)
    found = evaluate(again, {"candidate": [7, 8, 9]}, kept, processes=1)
    assert in_memory == (list(tmp_path.iterdir()) == [])
    assert found["candidate"].tolist() == [7, 8, 9]
    assert found["u_rms"].tolist()[1:] == first["u_rms"].tolist()[1::-1]
    assert found["outcome"].tolist() == first["outcome"].tolist()[::-1]


def test_what_the_rigs_computer_sees_is_another_run_than_the_truth():
    keys = [
        {task.key for task in ScenarioRuns(scenarios(), seen=seen).tasks} for seen in (False, True)
    ]
    assert not keys[0] & keys[1]
