"""`twin.lab.bench`.

The public benchmark: how it scores, what it refuses, and that what differs is seen."""

import contextlib
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy import stats

from twin.base.errors import LawError, RecordError, ScenarioError, TwinError
from twin.cli import ballplate as command
from twin.lab import bench, bench_entries, bench_scores
from twin.lab.bench import FAMILY_NAME, Benchmark, TimingRuns, scores_side_by_side
from twin.lab.bench_entries import Entry
from twin.lab.bench_scores import interquartile, interval
from twin.study.experiments import Store, executors
from twin.study.schema import draw_rigs, read_family

V1 = Benchmark().folder
EXAMPLES = Path(__file__).parents[2] / "examples"
RIGS = 4
CONFIRMED = (
    "confirmed on 2 of {} rigs replayed: the same errors and efforts; "
    "the scores are those of its runs"
)
KEY, OTHER = "the-key-of-a-season", "the-key-of-another-one"
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
    known = run_entry(found, found.about.laws["lqr"], folder, Store(folder / "runs"))
    known = known.assign(reference=known["rms_distance"])[["task", "rig", "noise", "reference"]]
    known.to_csv(folder / "reference.csv", index=False)
    return found


def run_entry(benchmark, entry, place, store=None):
    return benchmark.run_entry(entry, Path(place), store or Store(None), processes=1)


def write_entry(folder, line="pass"):
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
    rows = run_entry(small, small.about.laws["lqr"], small.folder, Store(small.folder / "runs"))
    for score in small.scores(rows):
        assert (score.error, score.low, score.high, score.worst) == (1.0, 1.0, 1.0, 1.0)
        assert score.kept == RIGS
    one = (rows["task"] == "Circle") & (rows["rig"] == 0) & (rows["noise"] == 1)
    left_out = small.scores(rows[~one])
    rows.loc[one, "outcome"] = "fell"
    circle, faults = small.scores(rows)
    assert [each[:-1] for each in left_out] == [circle[:-1], faults[:-1]]
    assert (circle.worst, circle.kept, faults.worst, faults.kept) == (10.0, RIGS - 1, 1.0, RIGS)
    z, n, p = stats.norm.ppf(0.975), RIGS, 1 - 1 / RIGS
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    wilson = ((middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n))
    assert (circle.kept_low, circle.kept_high) == pytest.approx(wilson)


@pytest.mark.long
def test_a_better_law_scores_better_and_one_that_drops_every_ball_worst(small, tmp_path):
    lines = ("pass", "e = 0 * e", "return np.full(e.shape, 300.0)")
    steady, lazy, wild = (
        small.scores(run_entry(small, write_entry(tmp_path, line), tmp_path))[0] for line in lines
    )
    assert steady.error < lazy.error < wild.error
    assert (wild.error, wild.kept, steady.kept) == (10.0, 0, RIGS)


@pytest.mark.long
def test_an_entry_is_replayed_and_what_differs_is_seen(small, tmp_path):
    entry, folder = write_entry(tmp_path), tmp_path / "entry"
    rows = run_entry(small, entry, tmp_path, Store(folder))
    small.write(folder, entry, tmp_path, rows)
    (folder / "own.py").write_text("raise SystemExit")  # a verifier runs nothing of it
    assert list(small.replay(folder)) == []
    told = (folder / "scores.json").read_text()
    (folder / "scores.json").write_text(told.replace('"kept": 4', '"kept": 3', 1))
    assert list(small.replay(folder)) == ["scores.json: not the scores of runs.parquet"]
    (folder / "scores.json").write_text(told)
    with np.load(folder / "commands.npz") as kept:
        commands = [kept[f"arr_{i}"] for i in range(len(kept.files))]
    commands[3][100:] += 0.1
    np.savez_compressed(folder / "commands.npz", *commands)
    error, effort = small.replay(folder)
    assert error.startswith("replay: Circle, rig 1, noise 1: ")
    assert effort.startswith("replay, effort: Circle, rig 1, noise 1: ")
    np.savez_compressed(folder / "commands.npz", *commands[1:])
    assert list(small.replay(folder)) == ["commands.npz: not those of every run on the first rigs"]
    (folder / "commands.npz").write_bytes(b"PK no zip")
    with pytest.raises(RecordError, match="contains no finished entry"):
        list(small.replay(folder))
    small.write(folder, entry, tmp_path, rows[1:])  # a run left out, and what it was commanded
    with np.load(folder / "commands.npz") as kept:
        np.savez_compressed(folder / "commands.npz", *[kept[f"arr_{i}"] for i in range(1, 8)])
    assert list(small.replay(folder)) == ["commands.npz: not those of every run on the first rigs"]
    small.write(folder, entry, tmp_path, rows)
    better = rows.assign(rms_distance=rows["rms_distance"] * 0.97)
    better.to_parquet(folder / "runs.parquet", index=False)
    assert len(list(small.replay(folder))) == 1 + 2 * 2 * 2


@pytest.mark.long
def test_efforts_and_commands_of_an_entry_are_looked_at(small, tmp_path):
    entry, folder = write_entry(tmp_path), tmp_path / "entry"
    rows = run_entry(small, entry, tmp_path, Store(folder))
    small.write(folder, entry, tmp_path, rows)
    assert list(small.replay(folder)) == []
    assert small.confirmed.startswith("confirmed on 2 of 4 rigs replayed: ")
    lazy = rows.assign(u_rms=rows["u_rms"] * 0.9)
    lazy.to_parquet(folder / "runs.parquet", index=False)
    scores = [each._asdict() for each in small.scores(lazy)]
    (folder / "scores.json").write_text(json.dumps({"season": "", "scores": scores}))
    found = list(small.replay(folder))
    assert len(found) == 2 * 2 * 2
    assert all(line.startswith("replay, effort: ") for line in found)
    assert found[0].endswith(f"expected {0.9 * rows['u_rms'][0]:.9g} rad/s^2")
    small.write(folder, entry, tmp_path, rows)
    with np.load(folder / "commands.npz") as kept:
        commands = [kept[f"arr_{i}"] for i in range(len(kept.files))]
    whole = [each.copy() for each in commands]
    for strange, said in (
        (np.nan, "has a command that is no number"),
        (np.inf, "has a command that is no number"),
        (None, "has no commands"),
    ):
        wrong = [each.copy() for each in whole]
        wrong[3] = wrong[3][:0] if strange is None else wrong[3]
        wrong[3][7:8] = strange or 0.0
        np.savez_compressed(folder / "commands.npz", *wrong)
        assert list(small.replay(folder)) == [f"commands.npz: Circle, rig 1, noise 1: {said}"]
    for strange in (["a", "b"], [object()]):
        np.savez_compressed(folder / "commands.npz", *whole[1:], np.array(strange))
        with pytest.raises(RecordError, match="contains no finished entry"):
            list(small.replay(folder))
    pd.concat([rows, rows]).to_parquet(folder / "runs.parquet", index=False)
    with pytest.raises(RecordError, match=r"runs\.parquet has 32 rows, of 16 runs"):
        list(small.replay(folder))
    (folder / "runs.parquet").unlink()
    (folder / "runs.parquet").symlink_to("/etc/hostname")
    with pytest.raises(RecordError, match="is a link; hand in"):
        list(small.replay(folder))


@pytest.mark.long
@pytest.mark.parametrize(("example", "needs"), [("entry_c", "gcc"), ("entry_js", "node")])
def test_an_entry_in_another_language_is_scored_and_verified(small, tmp_path, example, needs):
    if not shutil.which(needs):
        pytest.skip(f"no {needs} here")
    place, folder = tmp_path / example, tmp_path / "entry"
    shutil.copytree(EXAMPLES / example, place)
    if needs == "gcc":
        flags = ["-O2", "-ffp-contract=off", "-o", "law", "law.c"]
        subprocess.run([needs, *flags], cwd=place, check=True)
    name, entry, where = small.entry(place)
    assert (name, where) == (example, place)
    assert entry.authors
    rows = run_entry(small, entry, where, Store(folder))
    assert set(rows["outcome"]) == {"finished"}
    small.write(folder, entry, where, rows)
    assert (folder / "README.md").read_text() == (place / "README.md").read_text()
    (folder / entry.file).write_text("nothing that runs")  # a verifier runs nothing of it
    assert list(small.replay(folder)) == []


def test_what_is_said_of_a_law_s_file_in_the_entry_toml_beside_it_stands(small, tmp_path):
    write_entry(tmp_path)
    table = tmp_path / "entry.toml"
    assert small.entry(tmp_path / "own.py")[1] == Entry(title="own", file="own.py")
    for file, title in (("own.py", "Mine"), ("other.py", "own")):
        table.write_text(f"title = 'Mine'\nfile = '{file}'\ntuning = 600.0\n")
        assert small.entry(tmp_path / "own.py")[1].title == title
    table.write_text("title = 'Mine'\nfile = 'own.py'\ntunning = 600.0\n")
    with pytest.raises(ScenarioError, match=r"tunning: unknown.*did you mean 'tuning'"):
        small.entry(tmp_path / "own.py")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("processes", "threads"), [(2, 1), (1, 2)])
def test_rows_of_a_dask_cluster_are_those_of_one_process_to_the_byte(
    small, tmp_path, processes, threads
):
    from distributed import LocalCluster

    entry, written = write_entry(tmp_path), []
    with LocalCluster(
        n_workers=processes, threads_per_worker=threads, processes=True, dashboard_address=None
    ) as running:
        for scheduler in (None, running.scheduler_address):
            folder = tmp_path / str(len(written))
            with executors(2 if scheduler else 1, scheduler) as (executor, count):
                assert (executor is None) == (scheduler is None)
                how = {"executor": executor, "processes": count}
                rows = small.run_entry(entry, tmp_path, Store(folder), **how)
            small.write(folder, entry, tmp_path, rows)
            written.append(folder)
    files = ("runs.parquet", "scores.json", "commands.npz", "entry.toml")
    here, there = ([(folder / name).read_bytes() for name in files] for folder in written)
    assert here == there


@pytest.mark.long
def test_finished_runs_are_not_run_again_until_the_law_changes(small, tmp_path, monkeypatch):
    entry, store = write_entry(tmp_path), Store(tmp_path / "kept")
    first = run_entry(small, entry, tmp_path, store)
    monkeypatch.setattr(bench, "carry_out_entry", lambda *_: pytest.fail("run again"))
    pd.testing.assert_frame_equal(
        run_entry(small, entry, tmp_path, Store(tmp_path / "kept")), first
    )
    changed = write_entry(tmp_path, "e = 1.01 * e")
    with pytest.raises(pytest.fail.Exception, match="run again"):
        run_entry(small, changed, tmp_path, Store(tmp_path / "kept"))


@pytest.mark.short("1 / 0-*", "import twin.sim-*")
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 / 0", "own.py, line 14: ZeroDivisionError"),
        ("return np.nan * e", "control must give numbers"),
        ("return e[..., :1]", "plate accelerations"),
        ("import twin.sim", "an answer may not import it"),
        pytest.param("import time; time.sleep(9)", "took longer than 2 s", marks=pytest.mark.long),
    ],
)
def test_an_entry_that_fails_is_refused_in_a_line(small, tmp_path, monkeypatch, line, words):
    monkeypatch.setattr(bench_entries, "MAX_CHUNK_CPU_S", 2.0)
    with pytest.raises(LawError, match=words) as caught:
        run_entry(small, write_entry(tmp_path, line), tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("each", [0.01, 3.0])
def test_the_time_of_all_runs_is_told_by_that_of_their_beginnings(small, monkeypatch, each):
    clock, brief = [100.0], []

    def simulate(scenarios):
        lasts = scenarios[0].duration
        assert len(scenarios) == 2 * RIGS
        assert scenarios[0].metrics.start == 0
        brief.append(lasts)
        clock[0] += 7.0 + each * lasts * len(scenarios)

    monkeypatch.setattr(bench, "simulate", simulate)
    monkeypatch.setattr(bench.time, "perf_counter", lambda: clock[0])
    timing = TimingRuns(enough_s=12.0)
    told = small.processor_time(small.about.laws["lqr"], small.folder, timing)
    assert told == pytest.approx(each * (2.0 + 0.8) * 2 * RIGS)  # no share of the set-up
    assert brief == [0.05, 0.25, 1.0][: 3 if each < 1 else 2]


@pytest.mark.parametrize(("runs", "seconds"), [(8, 300.0), (64, 300.0), (192, 900.0)])
def test_code_has_more_time_for_more_runs(tmp_path, monkeypatch, runs, seconds):
    def answering(path, about):
        assert (path, about.seconds) == (tmp_path / "own.py", seconds)
        return contextlib.nullcontext()

    monkeypatch.setattr(bench_entries, "answering", answering)
    monkeypatch.setattr(bench_entries, "carry_out", len)
    assert bench_entries.carry_out_entry(write_entry(tmp_path), tmp_path, [None] * runs) == runs


def test_what_is_no_entry_s_is_refused(small, tmp_path):
    with pytest.raises(ScenarioError, match="an entry may set controller, observer, predictor"):
        run_entry(small, Entry(title="Cheat", set=("plant.friction.rolling_mm=0",)), tmp_path)
    for file in ("none.py", "../own.py"):
        with pytest.raises(ScenarioError, match=r"must be a file next to the entry\.toml"):
            run_entry(small, Entry(title="Cheat", file=file), tmp_path)
        with pytest.raises(ScenarioError, match=r"must be a file next to the entry\.toml"):
            small.processor_time(Entry(title="Cheat", file=file), tmp_path)
    write_entry(tmp_path)
    for text in ("controller.kind=pid", 'controller={kind="pid"}'):
        with pytest.raises(ScenarioError, match="set: controller: is the entry's own file"):
            run_entry(small, Entry(title="Both", file="own.py", set=(text,)), tmp_path)
    with pytest.raises(ScenarioError, match="neither a shipped law"):
        small.entry("none")
    with pytest.raises(
        RecordError, match=r"contains no finished entry: cannot be read: No such file or directory$"
    ):
        list(small.replay(tmp_path))
    assert "did you mean 'lqr'?" in str(called("run", "lqrr"))


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


def test_an_error_may_be_another_by_what_rounding_makes_and_no_more():
    expected = np.array([0.04, 0.0003, 0.0003])
    rows = pd.DataFrame({"task": "Hold-v1", "rig": [0, 1, 2], "noise": 0})
    for error, apart, wrong in (
        ([0.0407, 0.00037, 0.00037], [0.0, 1e-4, 1e-5], [2]),
        ([0.0409, 0.00041, 0.0003], [0.0, 1e-4, 0.0], [0, 1]),
        ([0.0409, np.nan, 0.0003], [1e-4, 1e-4, 0.0], [1]),
    ):
        changed = rows.assign(rms_distance=error)
        seen = bench_scores.compare_runs(changed, expected, "rms_distance", "own", apart)
        assert [int(re.search(r"rig (\d)", line)[1]) for line in seen] == wrong


@pytest.mark.long
def test_laws_of_version_1_give_the_errors_that_were_frozen():
    assert list(Benchmark().differences(rigs=2)) == []


def test_a_season_has_rigs_of_its_key_alone():
    ours, other, frozen = Benchmark(key=KEY), Benchmark(key=OTHER), Benchmark()
    code = hashlib.sha256(KEY.encode()).hexdigest()
    rigs = draw_rigs(read_family(FAMILY_NAME), int(code, 16), 64)
    assert ours.season == code[:12]
    assert ours.points == [rig.point for rig in rigs]
    assert (Benchmark(key=KEY).points, Benchmark(key=KEY).seeds) == (ours.points, ours.seeds)
    every = [*ours.points, *other.points, *frozen.points]
    assert len({json.dumps(point) for point in every}) == 64 + 64 + 128
    assert len({*ours.seeds, *other.seeds, *frozen.seeds}) == 64 + 64 + 128
    assert list(ours.points[0]) == list(frozen.points[0])


@pytest.mark.long
def test_a_season_has_the_same_bits_in_another_process():
    ours = Benchmark(key=KEY)
    asked = f"import json; from twin.lab.bench import Benchmark; b = Benchmark(key={KEY!r}); "
    asked += "print(json.dumps([b.season, b.points, b.seeds]))"
    said = subprocess.check_output(
        [sys.executable, "-c", asked], env=os.environ | {"PYTHONHASHSEED": "7"}
    )
    assert json.loads(said) == [ours.season, ours.points, ours.seeds]


def test_family_and_sampler_draw_what_they_drew_when_version_1_was_frozen():
    """Else a key that is published would not draw the rigs of its season any more."""
    frozen, again = Benchmark(), draw_rigs(read_family(FAMILY_NAME), 2026, 128)
    assert [rig.point for rig in again] == frozen.points
    assert [rig.seed for rig in again] == frozen.seeds


@pytest.mark.parametrize(
    "key", ["", "fifteen-letters", "sixteen with a gap", "sechzehn-öde-schlüssel"]
)
def test_a_key_that_could_be_guessed_or_mistaken_is_refused_in_a_line(key):
    with pytest.raises(ScenarioError, match="--season: a key is 16 or more") as caught:
        Benchmark(key=key)
    assert "\n" not in str(caught.value)
    assert not key or key not in str(caught.value)


@pytest.fixture
def shipped(small, tmp_path, monkeypatch):
    """The small benchmark in place of version 1, seasons of three rigs, and a folder for runs."""
    shutil.copytree(small.folder, tmp_path / "bench" / "v1")
    monkeypatch.setattr(bench, "scenarios_folder", lambda: tmp_path)
    monkeypatch.setattr(bench, "SEASON_RIGS", 3)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def called(*words):
    result = CliRunner().invoke(command, ["bench", *map(str, words)])
    if isinstance(result.exception, TwinError):
        return result.exception
    return result.stdout or result.stderr


def test_a_rig_is_refused_with_the_command_that_compares_laws_on_it():
    (line,) = str(called("run", "afl", "--on", "tube")).splitlines()
    assert line.startswith("--on tube: the benchmark has rigs of its own")
    assert "ballplate compare line --on tube" in line


def test_entries_on_different_rigs_are_not_mixed(shipped):
    season = Benchmark(key=KEY).season
    for name, own in (("frozen", {}), ("ours", {"season": season}), ("new", {"season": ""})):
        (shipped / name).mkdir()
        scores = [{"task": "Circle", "error": 1.0, "kept": 4}]
        (shipped / name / "scores.json").write_text(json.dumps({**own, "scores": scores}))
    kept = "the rigs of season "
    for words, line in (
        (["verify", "ours"], f"ours: on {kept}{season}, not on the frozen rigs"),
        (["verify", "frozen", "--season", KEY], f"frozen: on the frozen rigs, not on {kept}"),
        (["verify", "ours", "--season", OTHER], f"ours: on {kept}{season}, not on {kept}"),
        (["table", "frozen", "ours"], f"ours: on {kept}{season}, but frozen on the frozen rigs"),
    ):
        said = called(*words)
        assert isinstance(said, RecordError), words
        assert str(said).startswith(line)
        assert "\n" not in str(said)
    assert not (shipped / "runs").exists()  # refused before anything is run
    assert called("table", "frozen", "new").startswith("On the frozen rigs")
    assert called("table", "ours").startswith(f"On {kept}{season}")
    assert "needs the ENTRY" in str(called("verify", "--season", KEY))


@pytest.mark.long
def test_an_entry_of_a_season_is_scored_and_verified_on_its_rigs_alone(shipped):
    season = Benchmark(key=KEY)
    law = shipped / "entry"
    law.mkdir()
    (law / "entry.toml").write_text("title = 'PID'\nset = ['controller={kind=\"pid\"}']\n")
    runs = shipped / "runs"
    frozen, ours = runs / "bench-entry", runs / f"bench-entry-{season.season}"
    known = runs / f"bench-lqr-{season.season}"
    assert "on the frozen rigs" in called("run", law, "-j", 1)
    assert not list(runs.glob("season-*"))
    told = json.loads(called("run", law, "--season", KEY, "-j", 1, "--json"))
    # both laws beside each other on these rigs, run by run
    error, reference = (
        run_entry(season, Entry(title="", set=(f"controller={{{text}}}",)), ".")["rms_distance"]
        for text in ('kind="pid"', 'kind="lqr",rho=100.0,kappa=0.1')
    )
    part = np.sort((error / reference).to_numpy().reshape(2, 3 * 2))
    assert [each["error"] for each in told] == pytest.approx(part[:, 1:-1].mean(axis=1))
    assert [each["kept"] for each in told] == [3, 3]
    written = json.loads((ours / "scores.json").read_text())
    assert written == {"season": season.season, "scores": told}
    assert {path.name for path in runs.glob(f"*-{season.season}")} == {
        ours.name,
        f"season-{season.season}",
    }
    for file in shipped.rglob("*"):
        assert file.is_dir() or KEY.encode() not in file.read_bytes()
    assert called("verify", ours, "--season", KEY) == f"{ours}: {CONFIRMED.format(3)}\n"
    assert called("verify", frozen) == f"{frozen}: {CONFIRMED.format(RIGS)}\n"
    assert called("run", "lqr", "--season", KEY, "-j", 1).startswith(
        f"LQR, on the rigs of season {season.season}"
    )
    scores, its = scores_side_by_side([ours, known])
    assert its == season.season
    assert [each["error"] for each in scores[str(known)]] == [1.0, 1.0]


def test_where_the_reference_law_loses_the_ball_its_worst_in_the_task_stands():
    rows = pd.DataFrame(
        {"task": [*"aaabb"], "rig": [0, 1, 2, 0, 1], "noise": 0, "outcome": "finished",
         "rms_distance": [0.1, np.nan, 0.3, 0.7, np.nan]}
    )  # fmt: skip
    known = Benchmark().as_reference(rows)
    assert known["reference"].tolist() == [0.1, 0.3, 0.3, 0.7, 0.7]
    assert list(known) == ["task", "rig", "noise", "reference"]


def test_a_season_is_listed_with_its_fingerprint_and_rigs(shipped):
    season = Benchmark(key=KEY)
    listed = json.loads(called("list", "--season", KEY, "--json"))
    assert listed == {"season": season.season, "rigs": season.points, "seeds": season.seeds}
    assert called("list", "--season", KEY) == f"the rigs of season {season.season}\n"
