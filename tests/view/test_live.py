"""Tests of `twin.view.live_process`."""

import os
import signal
import socket
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from docs.screenshots import headless
from twin.base.errors import ViewError
from twin.base.jobs import wait_until
from twin.run.finished import record_run, run
from twin.run.opened import open_run
from twin.shadow import report
from twin.view import recording, viewer
from twin.view.live_process import LiveProcess, SharedRingBuffer
from twin.view.streams import TIMELINE_NAME

SHORT = ("--plant", "lagrange", "--set", "duration=0.4", "--set", "metrics.start=0")


def same(first, second):
    return all(
        np.array_equal(first.record[name], second.record[name]) for name in first.record.data
    )


@given(st.lists(st.integers(0, 9), max_size=20), st.integers(2, 12), st.none() | st.integers(1, 9))
@settings(max_examples=50)
def test_every_row_is_either_read_once_in_order_or_counted_as_dropped(bursts, size, most):
    with closing(SharedRingBuffer(size, 2)) as ring:
        ring.name(("n", "twice"))
        read, written, behind = [], 0, 0
        for burst in bursts:
            for _ in range(burst):
                ring.slot()[:] = written, 2 * written
                ring.put()
                written += 1
            behind = max(behind, written - ring.taken)
            rows = ring.take(most)
            assert most is None or len(rows) <= most
            assert np.array_equal(rows[:, 1], 2 * rows[:, 0])
            read += rows[:, 0].tolist()
        behind = max(behind, written - ring.taken)
        read += ring.take()[:, 0].tolist()
        assert ring.taken == written
        assert read == sorted(set(read))
        assert len(read) + ring.dropped == written
        assert (ring.dropped > 0) == (behind >= size)  # one row may be half written


@pytest.mark.parametrize("most", [None, 2, 3])
def test_a_reader_gets_every_row_that_is_left_when_the_writer_has_ended(most):
    with closing(SharedRingBuffer(16, 2)) as ring:
        blocks = ring.blocks(0.001, most)
        assert next(blocks) == {}  # no column has a name yet
        ring.name(("n", "twice"))
        for number in range(6):
            ring.slot()[:] = number, 2 * number
            ring.put()
        ring.finish()
        left = list(blocks)
        assert [n for block in left for n in block["n"].tolist()] == list(range(6))
        assert all(np.array_equal(block["twice"], 2 * block["n"]) for block in left)
        assert most is None or max(len(block["n"]) for block in left) == most


@pytest.fixture
def tap():
    """What hands rows to a process that reads none."""
    with closing(LiveProcess(print, ())) as made:
        yield made


def test_what_a_tap_hands_over_is_what_is_recorded(scenario, tap):
    done = run(scenario(), watch=tap.watch)
    ring = tap._ring
    table = dict(zip(ring.columns, ring.take().T, strict=True))
    assert np.array_equal(table["time"], done.record.time)
    assert np.array_equal(table["true_theta"], done.record["state"][:, 0, 6])
    assert np.array_equal(table["estimated_x"], done.record["estimate"][:, 0, 0])
    assert np.array_equal(table["supervisor"], done.record["supervisor"][:, 0, 0])


@pytest.mark.long
@pytest.mark.parametrize("blow", [signal.SIGSTOP, signal.SIGKILL])
def test_an_observer_that_hangs_or_dies_changes_nothing_in_the_record(scenario, monkeypatch, blow):
    chosen = scenario("duration=1")
    with closing(LiveProcess(report.work, (chosen, None))) as tap:
        assert wait_until(tap.begun, 600.0)  # it starts with the lowest priority
        os.kill(tap._process.pid, blow)
        watched = run(chosen, watch=tap.watch)
        waits, join = [], tap._process.join
        with monkeypatch.context() as patch:
            patch.setattr(tap._process, "join", lambda wait: waits.append(wait) or join(wait))
            assert not tap.finish(wait=0.2)
        assert len(waits) <= 2  # it is given up where two looks show no progress
    assert same(watched, run(chosen))


class Slow:
    """In the place of an observing process: takes a few rows whenever it is waited for."""

    exitcode = None

    def __init__(self, ring):
        self.ring = ring

    def is_alive(self):
        return self.exitcode is None

    def join(self, _):
        rows = self.ring.take(7)
        if self.ring.done and not len(rows):
            self.exitcode = 0


def test_an_observer_that_is_behind_is_waited_for_as_long_as_it_goes_on(scenario, tap, monkeypatch):
    run(scenario("duration=0.2"), watch=tap.watch)
    with closing(SharedRingBuffer(*tap._ring.address)) as ring, monkeypatch.context() as patch:
        patch.setattr(tap, "_process", Slow(ring))
        assert tap.finish()
        assert ring.taken == 100


def test_a_taken_port_is_one_line():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(ViewError, match=f"port {port}: Address already in use"):
            viewer.page(port)


@pytest.mark.long
@pytest.mark.parametrize("how", ["--view", "--serve"])
def test_a_run_is_done_and_kept_though_nobody_can_watch(ballplate, monkeypatch, how):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = [str(server.getsockname()[1])] if how == "--serve" else []
        code, _, err = ballplate("run", "step", *SHORT, "--out", "out", how, *port)
    assert (code, err.count("the run continues without a view")) == (0, 1)
    assert Path("out/run.parquet").is_file()


@pytest.mark.long
@pytest.mark.real_time
def test_a_running_experiment_arrives_whole_in_a_viewer(scenario, tmp_path):
    chosen = scenario("duration=2")
    record_run(run(scenario("duration=1")), tmp_path / "other")
    recording.write(tmp_path / "other.rrd", open_run(tmp_path / "other"))
    try:
        with headless(tmp_path / "other.rrd") as (client, url):
            about = (chosen, "live", url, None, False)
            with closing(LiveProcess(recording.work, about)) as shown:
                run(chosen, watch=shown.watch)
                assert shown.finish(wait=60)
                assert shown.dropped == 0
            until = time.monotonic() + 60
            found = []
            while time.monotonic() < until and not found:
                time.sleep(0.5)
                found = [
                    line
                    for each in client.get_state().recordings
                    for line in each.timelines
                    if each.store_id.startswith("Recording:ballplate") and line.end
                ]
            assert any(line.name == TIMELINE_NAME and line.end == 1_998_000_000 for line in found)
    except ViewError as error:
        pytest.skip(str(error))
