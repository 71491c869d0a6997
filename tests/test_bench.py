"""The public benchmark: how it scores, what it refuses, and that what differs is seen."""

import json
import math
import shutil
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy import stats

from twin import bench
from twin.bench import Benchmark, Entry, interquartile, interval
from twin.cli import ballplate as command
from twin.errors import LawError, RecordError, ScenarioError
from twin.study.experiments import Store

V1 = Benchmark().folder
RIGS = 4
SMALL = """
schema = "ballplate/bench/v1"
title = "Small"
rigs = "rigs.csv"
seeds = 2
reference = "lqr"
metric = "rms_distance"
most = 10.0
replayed = 2
set = ["baseline=false", "plant.kind=lagrange", "plant.step=0.002"]

[[tasks]]
name = "Circle"
scenario = "circle"
set = ["duration=2.0", "metrics.start=0.4"]

[[tasks]]
name = "Faults"
scenario = "faults.toml"
set = ["duration=0.8", "metrics.start=0.0"]

[laws.lqr]
title = "LQR"
set = ['controller={kind="lqr",rho=100.0,kappa=0.1}']
"""
FAULTS = """
title = "Faults"
duration = 1.0
[controller]
kind = "afl"
[predictor]
delay = 0.042
[reference]
kind = "circle"
amplitude = 0.15
omega = 0.75
[metrics]
start = 0.0
[[change]]
at = 0.3
set = { "plant.level_deg" = [0.3, -0.3] }
"""
LAW = """
import numpy as np
from controllers.interfaces import Law


class Own(Law):
    name = "own"

    def control(self, t, x, reference, q):
        r = reference(t)
        e = np.stack([x[..., 0] - r[0, ..., 0], x[..., 4] - r[0, ..., 1]], axis=-1)
        v = np.stack([x[..., 1] - r[1, ..., 0], x[..., 5] - r[1, ..., 1]], axis=-1)
        tilt, rate = x[..., 2::4], x[..., 3::4]
        {0}
        return np.array([-1.0, 1.0]) * (17.3 * e + 21.7 * v) - 64.5 * tilt - 16.7 * rate
"""


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A benchmark of two short tasks on four rigs, with the reference law run."""
    folder = tmp_path_factory.mktemp("bench")
    (folder / "bench.toml").write_text(SMALL)
    (folder / "faults.toml").write_text(FAULTS)
    rows = (V1 / "rigs.csv").read_text().splitlines(keepends=True)
    (folder / "rigs.csv").write_text("".join(rows[: RIGS + 1]))
    found = Benchmark(folder)
    known = ran(found, found.about.laws["lqr"], folder)
    known = known.assign(reference=known["rms_distance"])[["task", "rig", "noise", "reference"]]
    known.to_csv(folder / "reference.csv", index=False)
    return found


def ran(benchmark, entry, place, store=None):
    return benchmark.carried_out(entry, Path(place), store or Store(None), processes=1)


def own(folder, line="pass"):
    (folder / "own.py").write_text(textwrap.dedent(LAW).replace("{0}", line))
    return Entry(title="Own", file="own.py")


def test_the_mean_between_the_quartiles_and_its_interval():
    assert interquartile(np.arange(8.0)) == pytest.approx(np.mean([2, 3, 4, 5]))
    errors = np.random.default_rng(1).lognormal(size=(200, 2))
    low, high = interval(errors, ["a"] * 200)
    beside = stats.bootstrap(
        (np.arange(200),),
        lambda rigs, axis: stats.trim_mean(errors[rigs].reshape(*rigs.shape[:-1], -1), 0.25, -1),
        n_resamples=2000, method="percentile", rng=2,
    ).confidence_interval  # fmt: skip
    assert (low, high) == pytest.approx(beside, rel=0.02)
    # two kinds of rigs that are each alike: which are drawn makes no difference within a kind
    kinds = np.repeat([1.0, 3.0], 20)[:, np.newaxis]
    assert interval(kinds, [1] * 20 + [2] * 20) == (2.0, 2.0)
    low, high = interval(kinds, [1] * 40)
    assert low < 1.7
    assert high > 2.3


def test_the_reference_law_is_one_everywhere_and_lost_balls_are_the_worst(small):
    rows = ran(small, small.about.laws["lqr"], small.folder)
    for score in small.scores(rows):
        assert (score.error, score.low, score.high, score.worst) == (1.0, 1.0, 1.0, 1.0)
        assert score.kept == RIGS
    rows.loc[(rows["task"] == "Circle") & (rows["rig"] == 0) & (rows["noise"] == 1), "outcome"] = (
        "fell"
    )
    circle, faults = small.scores(rows)
    assert (circle.worst, circle.kept, faults.worst, faults.kept) == (10.0, RIGS - 1, 1.0, RIGS)
    z, n, p = stats.norm.ppf(0.975), RIGS, 1 - 1 / RIGS
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    wilson = ((middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n))
    assert (circle.kept_low, circle.kept_high) == pytest.approx(wilson)


@pytest.mark.long
def test_a_better_law_scores_better_and_one_that_drops_every_ball_worst(small, tmp_path):
    lines = ("pass", "e = 0 * e", "return np.full(e.shape, 300.0)")
    steady, lazy, wild = (
        small.scores(ran(small, own(tmp_path, line), tmp_path))[0] for line in lines
    )
    assert steady.error < lazy.error < wild.error
    assert (wild.error, wild.kept, steady.kept) == (10.0, 0, RIGS)


@pytest.mark.long
def test_an_entry_is_replayed_and_what_differs_is_seen(small, tmp_path):
    entry, folder = own(tmp_path), tmp_path / "entry"
    rows = ran(small, entry, tmp_path, Store(folder))
    small.write(folder, entry, tmp_path, rows)
    (folder / "own.py").write_text("raise SystemExit")  # a verifier runs nothing of it
    assert list(small.replayed(folder)) == []
    told = (folder / "scores.json").read_text()
    (folder / "scores.json").write_text(told.replace('"kept": 4', '"kept": 3', 1))
    assert list(small.replayed(folder)) == ["scores.json: not the scores of runs.parquet"]
    (folder / "scores.json").write_text(told)
    with np.load(folder / "commands.npz") as kept:
        commands = [kept[f"arr_{i}"] for i in range(len(kept.files))]
    commands[3][100:] += 0.1
    np.savez_compressed(folder / "commands.npz", *commands)
    (line,) = small.replayed(folder)
    assert line.startswith("replay: Circle, rig 1, noise 1: ")
    np.savez_compressed(folder / "commands.npz", *commands[1:])
    assert list(small.replayed(folder)) == [
        "commands.npz: not those of every run on the first rigs"
    ]
    (folder / "commands.npz").write_bytes(b"PK no zip")
    with pytest.raises(RecordError, match="holds no finished entry"):
        list(small.replayed(folder))
    np.savez_compressed(folder / "commands.npz", *commands)
    better = rows.assign(rms_distance=rows["rms_distance"] * 0.97)
    better.to_parquet(folder / "runs.parquet", index=False)
    assert len(list(small.replayed(folder))) == 1 + 2 * 2 * 2


@pytest.mark.long
def test_finished_runs_are_not_run_again_until_the_law_changes(small, tmp_path, monkeypatch):
    entry, store = own(tmp_path), Store(tmp_path / "kept")
    first = ran(small, entry, tmp_path, store)
    monkeypatch.setattr(bench, "_carried_out", lambda *_: pytest.fail("run again"))
    pd.testing.assert_frame_equal(ran(small, entry, tmp_path, Store(tmp_path / "kept")), first)
    changed = own(tmp_path, "e = 1.01 * e")
    with pytest.raises(pytest.fail.Exception, match="run again"):
        ran(small, changed, tmp_path, Store(tmp_path / "kept"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 / 0", "own.py, line 14: ZeroDivisionError"),
        ("return np.nan * e", "control must give numbers"),
        ("return e[..., :1]", "plate accelerations"),
        ("import twin.sim", "an answer may not import it"),
        ("import time; time.sleep(9)", "took longer than 2 s"),
    ],
)
def test_an_entry_that_fails_is_refused_in_a_line(small, tmp_path, monkeypatch, line, words):
    monkeypatch.setattr(bench, "MAY", 2.0)
    with pytest.raises(LawError, match=words) as caught:
        ran(small, own(tmp_path, line), tmp_path)
    assert "\n" not in str(caught.value)


def test_what_is_no_entry_s_is_refused(small, tmp_path):
    with pytest.raises(ScenarioError, match="an entry sets controller, observer, predictor"):
        ran(small, Entry(title="Cheat", set=("plant.friction.rolling_mm=0",)), tmp_path)
    for file in ("none.py", "../own.py"):
        with pytest.raises(ScenarioError, match=r"must be a file beside the entry\.toml"):
            ran(small, Entry(title="Cheat", file=file), tmp_path)
    with pytest.raises(ScenarioError, match="neither a shipped law"):
        small.entry("none")
    with pytest.raises(RecordError, match="holds no finished entry"):
        list(small.replayed(tmp_path))
    result = CliRunner().invoke(command, ["bench", "run", "lqrr"])
    assert "did you mean 'lqr'?" in str(result.exception)


def test_version_1_is_what_was_frozen_and_a_changed_byte_is_seen(tmp_path, monkeypatch):
    folder = tmp_path / "v1"
    shutil.copytree(V1, folder)
    assert list(Benchmark(folder).differences(rigs=0)) == []
    text = (folder / "rigs.csv").read_text()
    (folder / "rigs.csv").write_text(text.replace("0.1", "0.2", 1))
    assert list(Benchmark(folder).differences(rigs=0)) == ["rigs.csv: not the file that was frozen"]
    (folder / "rigs.csv").write_text(text)
    monkeypatch.setattr(bench, "model_path", lambda _: folder / "lock.toml")
    assert len(list(Benchmark(folder).differences(rigs=0))) == 2


def test_version_1_has_the_size_that_it_says():
    about = Benchmark()
    assert len(about.points) == 128
    assert len({json.dumps(point) for point in about.points}) == 128
    names = [f"{name}-v1" for name in ("Circle", "Lissajous", "Line", "Step", "Hold", "Faults")]
    assert [task.name for task in about.about.tasks] == names
    assert len(pd.read_csv(V1 / "reference.csv")) == 6 * 128 * 2


@pytest.mark.long
def test_laws_of_version_1_give_the_errors_that_were_frozen():
    assert list(Benchmark().differences(rigs=2)) == []
