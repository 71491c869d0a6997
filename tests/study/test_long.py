"""`twin.study.experiments`: Studies on several processes and on a cluster, killed at any moment."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
import sys
import time
import tomllib
from contextlib import contextmanager
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from twin.base.errors import ScenarioError
from twin.study import experiments
from twin.study.experiments import Store, carry
from twin.study.schema import Study
from twin.study.work import Row, Work
from twin.view.viewer import bound

pytestmark = pytest.mark.long


def free_port():
    with bound("127.0.0.1", 0) as found:
        return found.getsockname()[1]


STUDY = """
title = "short"
scenario = "hold"
set = ["plant.kind=lagrange", "duration=0.3"]
method = "grid"
seeds = 4
metrics = ["rms_error"]

[parameters."plant.friction.rolling_mm"]
values = [0.1, 0.12, 0.14, 0.16, 0.18, 0.2, 0.22, 0.24]

[[variants]]
name = "AFL"
set = ["controller.kind=afl"]

[[variants]]
name = "backstepping"
set = ["controller.kind=backstepping"]
"""
MAIN = (
    "import sys; from twin.study import experiments; "
    "experiments.CHUNK_RUNS, experiments.MIN_BATCH_RUNS = 8, 1; "
    "experiments.CLUSTER_TIMEOUT_S = float(sys.argv[1]); "
    "from twin.cli import main; main(sys.argv[2:])"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "short.toml").write_text(STUDY)
    return tmp_path


def start(
    folder: Path, *arguments: str, patience: float = experiments.CLUSTER_TIMEOUT_S
) -> subprocess.Popen[bytes]:
    study = ["study", "short.toml", "--out", "out", *arguments]
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, str(patience), *study],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def read_rows(folder: Path) -> list[Row]:
    paths = (folder / "out" / "chunks").glob("[!.]*.parquet")
    return [row for path in paths for row in pq.read_table(path).to_pylist()]


def undisturbed(folder: Path) -> dict[str, Row]:
    about = Study.model_validate(tomllib.loads(STUDY))
    rows = carry(Work(about), Store(folder / "quiet"), processes=1)
    return {row["key"]: row for row in rows.to_pylist()}


@pytest.mark.parametrize("processes", ["1", "2"])
def test_a_study_killed_at_random_moments_has_no_wrong_or_doubled_row(folder, processes) -> None:
    truth = undisturbed(folder)
    rng = random.Random(int(processes))
    kills = 0
    for attempt in range(100):
        before = len(read_rows(folder))
        child = start(folder, "--processes", processes)
        while attempt % 5 and child.poll() is None and len(read_rows(folder)) == before:
            time.sleep(0.01)
        try:
            # now and then while it starts, else while it works; soon, until some have been killed
            most = 0.5 if attempt % 5 else 3
            child.wait(rng.uniform(0, most if kills >= 3 else 0.1 * most))
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            kills += 1
        child.communicate()
        rows = read_rows(folder)
        assert len({row["key"] for row in rows}) == len(rows)
        assert all(truth[row["key"]] == row for row in rows)
        if child.returncode == 0:
            break
    assert {row["key"]: row for row in read_rows(folder)} == truth
    table = pq.read_table(folder / "out" / "rows.parquet")
    assert table.num_rows == len(truth)
    assert kills >= 3


@pytest.fixture
def cluster():
    """A scheduler with two worker processes."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as running:
        yield running


@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_costs_a_retry_and_not_the_study(folder, cluster) -> None:
    from distributed import Client

    child = start(folder, "--scheduler", cluster.scheduler_address)
    while not read_rows(folder) and child.poll() is None:
        time.sleep(0.05)
    with Client(cluster.scheduler_address) as client:
        victim, *_ = client.run(os.getpid).values()
    os.kill(victim, signal.SIGKILL)
    assert child.poll() is None, "the study was over before a worker was killed"
    assert child.wait(240) == 0
    child.communicate()
    assert {row["key"]: row for row in read_rows(folder)} == undisturbed(folder)


@contextmanager
def dask(*arguments: str):
    """A program of a cluster, as started by hand."""
    command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*command, "--no-dashboard"], **quiet) as program:
        try:
            yield program
        finally:
            program.kill()


@contextmanager
def scheduler(port: int):
    """One that listens."""
    with dask("scheduler", "--host", "127.0.0.1", "--port", str(port)) as program:
        for _ in range(600):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        else:
            raise AssertionError("no scheduler within a minute")
        yield program


def refused(child: subprocess.Popen[bytes]) -> str:
    """What a study says that ends with one line."""
    error = child.communicate(timeout=120)[1].decode()
    assert child.returncode == 2, error
    assert "Traceback" not in error
    return error


def test_a_lost_scheduler_costs_a_retry_and_not_the_study(folder) -> None:
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    worker = ("worker", address, "--nthreads", "1", "--no-nanny")
    with scheduler(port) as first, dask(*worker):
        child = start(folder, "--scheduler", address)
        while not read_rows(folder) and child.poll() is None:
            time.sleep(0.05)
        first.kill()
        first.wait()
        assert child.poll() is None, "the study was over before the scheduler was killed"
    with scheduler(port), dask(*worker):
        assert child.wait(240) == 0
        child.communicate()
    assert {row["key"]: row for row in read_rows(folder)} == undisturbed(folder)


def test_a_scheduler_lost_for_good_ends_the_study_with_one_line(folder) -> None:
    port = free_port()
    with scheduler(port) as program:
        child = start(folder, "--scheduler", f"tcp://127.0.0.1:{port}", patience=4)
        assert b"64 runs" in child.stderr.readline()  # and there they stay, without a worker
        program.kill()
    assert "lost, and not back within 4 s" in refused(child)


@pytest.mark.filterwarnings("ignore")
def test_a_scheduler_lost_as_soon_as_it_has_answered_is_told_in_the_same_line(
    folder, monkeypatch
) -> None:
    monkeypatch.setattr(experiments, "CLUSTER_TIMEOUT_S", 3.0)
    work = Work(Study.model_validate(tomllib.loads(STUDY)))
    port = free_port()
    with scheduler(port) as program, experiments.Cluster(f"tcp://127.0.0.1:{port}") as cluster:
        program.kill()
        program.wait()
        assert cluster.workers == 1  # known, not asked
        for _ in ("before it is given up", "after"):
            with pytest.raises(ScenarioError, match="lost, and not back within 3 s"):
                carry(work, Store(folder / "out"), executor=cluster)


def test_a_program_that_takes_the_connection_and_says_nothing_is_no_scheduler(folder) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        child = start(folder, "--scheduler", address, patience=4)
        assert "no scheduler answers there" in refused(child)
