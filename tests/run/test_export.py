"""Tests of `twin.run.exporters`."""

import json
import re
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from exported_files import READERS
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from twin.cli.see import export as command
from twin.identify.logs import read
from twin.run.exporters import export
from twin.run.finished import record_run, run
from twin.run.record import read_run
from twin.scenario import load


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short run with noise, dead time and friction."""
    where = tmp_path_factory.mktemp("run")
    keys = ("plant.kind=lagrange", "duration=0.3", "metrics.start=0")
    record_run(run(load("circle", keys)), where)
    return where


def exported(folder, file):
    result = CliRunner().invoke(command, [str(folder), str(file)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return file


@pytest.fixture(scope="module")
def recorded(folder):
    return read_run(folder / "run.parquet")


def test_identify_reads_the_csv_as_it_reads_the_record(folder, tmp_path):
    ours = read(folder)
    foreign = read(exported(folder, tmp_path / "log.csv"))
    for name in ("time", "ball", "plate", "age", "touched", "command"):
        np.testing.assert_array_equal(getattr(foreign, name), getattr(ours, name))


@pytest.mark.parametrize("ending", READERS)
def test_every_column_and_unit_is_in_the_file_to_the_last_digit(folder, recorded, tmp_path, ending):
    columns, units, _ = recorded
    file = exported(folder, tmp_path / f"log{ending}")
    found, told = READERS[ending](file)
    assert told == units
    for name, values in columns.items():
        np.testing.assert_array_equal(found[name], values)
    if ending == ".parquet":
        assert set(pq.read_schema(file).metadata) == {b"ballplate"}


def read_mcap(file):
    """Messages by topic, each with its time in ns, and attachments."""
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        topics = {}
        for _, channel, message, content in reader.iter_decoded_messages():
            topics.setdefault(channel.topic, []).append((message.log_time, content))
        attached = {each.name: json.loads(each.data) for each in reader.iter_attachments()}
    return topics, attached


def test_the_mcap_file_has_ball_and_joints_as_messages_of_ros(folder, recorded, tmp_path):
    columns, units, metadata = recorded
    topics, attached = read_mcap(exported(folder, tmp_path / "log.mcap"))
    ticks = np.arange(len(columns["time"])) * 2_000_000
    for kind in ("measured", "estimated", "true"):
        told = topics[f"/ball/{kind}"]
        np.testing.assert_array_equal([time for time, _ in told], ticks)
        stamps = [(each.header.stamp.sec, each.header.stamp.nanosec) for _, each in told]
        np.testing.assert_array_equal(np.dot(stamps, [10**9, 1]), ticks)
        poses = [each.pose for _, each in told]
        found = [(each.position.x, each.position.y, each.position.z) for each in poses]
        turned = [each.orientation for each in poses]
        assert {(each.x, each.y, each.z, each.w) for each in turned} == {(0, 0, 0, 1)}
        np.testing.assert_array_equal(np.array(found)[:, 0], columns[f"{kind}_x"])
        np.testing.assert_array_equal(np.array(found)[:, 1], columns[f"{kind}_y"])
        assert {each.header.frame_id for _, each in told} == {"plate"}
    for kind in ("measured", "true"):
        joints = [joint for _, joint in topics[f"/joint_states/{kind}"]]
        assert joints[0].name == ["phi", "theta"]
        found = np.array([joint.position for joint in joints])
        np.testing.assert_array_equal(found[:, 1], columns[f"{kind}_theta"])
    rates = np.array([joint.velocity for joint in joints])
    np.testing.assert_array_equal(rates[:, 0], columns["true_phi_rate"])
    assert attached["scenario.json"] == metadata["scenario"]
    assert attached["parameters.json"]["controller"]["gains"]
    assert attached["metrics.json"]["outcome"] == "finished"
    some = {name: columns[name] for name in ("time", "true_x", "true_y")}
    export(tmp_path / "some.mcap", some, units)
    assert {name: len(each) for name, each in read_mcap(tmp_path / "some.mcap")[0].items()} == {
        "/signals": len(ticks),
        "/ball/true": len(ticks),
    }


@pytest.mark.long
def test_reruns_own_importer_finds_nothing_wrong_in_the_mcap_file(folder, tmp_path):
    file = exported(folder, tmp_path / "log.mcap")
    rerun = [sys.executable, "-m", "rerun", "mcap"]
    said = subprocess.run([*rerun, "check", file], capture_output=True, text=True, check=True)
    assert "/ball/true" in said.stdout
    assert not re.search(r"^(error|warning)", said.stdout, re.MULTILINE)
    subprocess.run([*rerun, "convert", file, "-o", tmp_path / "log.rrd"], check=True)
    shown = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", tmp_path / "log.rrd"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "/joint_states/true/velocity - data columns: [Scalars:scalars" in shown.stdout
    drawn = re.search(r"^.*/ball/true.* - data columns: .*$", shown.stdout, re.MULTILINE)
    assert drawn, shown.stdout
    assert "translation" in shown.stdout


def test_without_the_extra_there_is_no_mcap_file_and_a_line(
    folder, tmp_path, monkeypatch, ballplate
):
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    code, _, line = ballplate("export", folder, tmp_path / "log.mcap")
    assert code == 2
    assert "log.mcap: needs the extra mcap: pip install 'ballplate[mcap]'" in line
    assert line.count("\n") == 1
    assert not list(tmp_path.iterdir())
