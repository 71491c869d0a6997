"""`twin.run.bags`: Messages of ROS 2 are columns at the times that their senders gave them."""

import sqlite3
import struct

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.run.exporters import ROS2_TABLES
from twin.run.files import log_file
from twin.run.foreign_logs import foreign_table

T = np.arange(0.0, 4.0, 0.02)
X = 0.05 * np.sin(1.3 * T)
U = 0.02 * np.cos(np.arange(0.0, 4.0, 0.01))
BEGIN = 1_700_000_000_123_456_789
PARTS = "".join(f"{80 * '='}\nMSG: {name}\n{text}" for name, text in ROS2_TABLES["parts"].items())
POSE = ROS2_TABLES["messages"]["geometry_msgs/msg/PoseStamped"] + PARTS
SERVO = "float64[] data\nstring label\n"
ASKED = wanted_columns("measured_x=/ball/pose.position.x,command_phi=/servo/data.1")


def pose(x, stamp):
    sec, nanosec = divmod(stamp, 10**9)
    upright = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {
        "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "plate"},
        "pose": {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": upright},
    }


def messages(late=30_000_000):
    """Topic, content and log time of a camera at 50 Hz and a servo at 100 Hz."""
    found = [("/servo", {"data": [7.0, float(u)], "label": "a"}, BEGIN + round(1e7 * k))
             for k, u in enumerate(U)]  # fmt: skip
    for k, x in enumerate(X):
        logged = BEGIN + round(2e7 * k) + 3_000_000
        found.append(("/ball", pose(float(x), logged - late), logged))
    return sorted(found, key=lambda each: each[2])


def write_mcap(path, **how):
    with path.open("wb") as file, Writer(file) as writer:
        schemas = {
            "/ball": writer.register_msgdef("geometry_msgs/msg/PoseStamped", POSE),
            "/servo": writer.register_msgdef("own_msgs/msg/Servo", SERVO),
        }
        for topic, content, logged in messages(**how):
            writer.write_message(topic, schemas[topic], content, logged)


def write_db3(path, **how):
    """What a recorder of ROS 2 since Iron writes, with the bytes of the MCAP file's messages."""
    from mcap.reader import make_reader

    write_mcap(path.with_suffix(".mcap"), **how)
    with sqlite3.connect(path) as base, path.with_suffix(".mcap").open("rb") as file:
        base.execute("create table topics(id, name, type, serialization_format)")
        base.execute("create table messages(id, topic_id, timestamp, data)")
        base.execute(
            "create table message_definitions"
            "(id, topic_type, encoding, encoded_message_definition, type_description_hash)"
        )
        for number, (name, kind, text) in enumerate(
            [
                ("/ball", "geometry_msgs/msg/PoseStamped", POSE),
                ("/servo", "own_msgs/msg/Servo", SERVO),
            ]
        ):
            base.execute("insert into topics values (?, ?, ?, 'cdr')", (number, name, kind))
            row = (number, kind, "ros2msg", text, "")
            base.execute("insert into message_definitions values (?, ?, ?, ?, ?)", row)
        for k, (_, channel, each) in enumerate(make_reader(file).iter_messages()):
            row = (k, int(channel.topic == "/servo"), each.log_time, each.data)
            base.execute("insert into messages values (?, ?, ?, ?)", row)
    base.close()


WRITERS = {".mcap": write_mcap, ".db3": write_db3}


@pytest.mark.parametrize("ending", WRITERS)
def test_every_numeric_field_is_a_column_to_the_last_digit(tmp_path, ending):
    WRITERS[ending](tmp_path / f"a{ending}")
    table = foreign_table(tmp_path / f"a{ending}")
    assert {"/ball/pose.position.x", "/ball/pose.orientation.w", "/servo/data.1"} < {*table.columns}
    assert not any("label" in name or "header" in name for name in table.columns)
    np.testing.assert_array_equal(table.columns["/ball/pose.position.x"], X)
    np.testing.assert_array_equal(table.columns["/servo/data.1"], U)


@pytest.mark.parametrize("ending", WRITERS)
def test_a_log_has_the_stamps_of_the_camera_and_the_times_of_the_servo(tmp_path, ending):
    WRITERS[ending](tmp_path / f"a{ending}")
    log = read_any(tmp_path / f"a{ending}", ASKED)
    axis = log.axes["x"]
    assert axis.ball == pytest.approx(X)
    assert axis.tilt == pytest.approx(U)
    assert np.diff(axis.sampled) == pytest.approx(0.02, abs=1e-6)
    assert np.diff(axis.time) == pytest.approx(0.01, abs=1e-6)
    notes = " ".join(log.notes)
    assert "times are the stamps in the headers of /ball" in notes
    assert "columns have times of their own, at 50 Hz, 100 Hz" in notes


COMMON = {
    "geometry_msgs/msg/PointStamped": ("/point.x", "<iII12s3d", 0, 0, 6, b"plate\0", 1.5, 2, 3),
    "geometry_msgs/msg/Vector3": ("/x", "<3d", 1.5, 2.0, 3.0),
    "geometry_msgs/msg/Twist": ("/angular.y", "<6d", 0, 0, 0, 0, 1.5, 0),
    "std_msgs/msg/Float32": ("/data", "<f", 1.5),
    "std_msgs/msg/Float64MultiArray": ("/data.1", "<4I2d", 0, 0, 2, 0, 7.0, 1.5),
}
"""Type of messages to a field that is 1.5 in its bytes, which are packed by hand."""


@pytest.mark.parametrize("kind", COMMON)
def test_bags_without_definitions_are_read_where_their_messages_are_common(tmp_path, kind):
    field, form, *values = COMMON[kind]
    data = b"\0\1\0\0" + struct.pack(form, *values)
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.execute("create table topics(id, name, type, serialization_format)")
        base.execute("create table messages(id, topic_id, timestamp, data)")
        base.execute("insert into topics values (1, '/a', ?, 'cdr')", (kind,))
        base.execute("insert into topics values (2, '/b', 'own_msgs/msg/Own', 'cdr')")
        for k in range(20):
            base.execute("insert into messages values (?, ?, ?, ?)", (k, 1 + k % 2, k, data))
    base.close()
    table = foreign_table(tmp_path / "a.db3")
    np.testing.assert_array_equal(table.columns[f"/a{field}"], np.full(10, 1.5))
    assert "/b: left out" in table.notes[0]


def test_a_message_of_another_encoding_is_left_out_with_its_reason(tmp_path):
    from mcap.writer import Writer as Plain

    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Plain(file)
        writer.start()
        schema = writer.register_schema("Ball", "protobuf", b"{}")
        channel = writer.register_channel("/ball", "protobuf", schema)
        writer.add_message(channel, 1, b"\x08\x01", 1)
        writer.finish()
    with pytest.raises(LogError, match="without a column of numbers; /ball: left out: protobuf"):
        foreign_table(tmp_path / "a.mcap")


def test_a_database_that_is_no_bag_is_one_line(tmp_path):
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.execute("create table log(t, x, u)")
    base.close()
    with pytest.raises(LogError, match="no bag of ROS 2; sqlite3 -header"):
        foreign_table(tmp_path / "a.db3")


def test_the_folder_of_a_bag_stands_for_its_one_file(tmp_path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:")
    write_mcap(tmp_path / "a_0.mcap")
    assert log_file(tmp_path) == tmp_path / "a_0.mcap"
    write_mcap(tmp_path / "a_1.mcap")
    with pytest.raises(LogError, match=r"a bag of 2 files; give one of them, such as .*a_0\.mcap"):
        log_file(tmp_path)
    (tmp_path / "run.parquet").touch()  # exported next to its run
    assert log_file(tmp_path) == tmp_path / "run.parquet"


def test_messages_in_json_are_columns_at_the_times_of_logging(tmp_path):
    from mcap.writer import Writer as PlainWriter

    path = tmp_path / "rig.mcap"
    with path.open("wb") as file:
        writer = PlainWriter(file)
        writer.start()
        channel = writer.register_channel("/rig", "json", 0)
        for k, x in enumerate(X):
            data = f'{{"ball": {{"x": {float(x)!r}}}, "u": [1, {k}], "mode": "on"}}'.encode()
            logged = BEGIN + round(2e7 * k)
            writer.add_message(channel, logged, b"broken" if k == 5 else data, logged)
        writer.finish()
    table = foreign_table(path)
    assert set(table.columns) == {"/rig/ball.x", "/rig/u.0", "/rig/u.1"}
    own = np.delete(np.arange(len(X)), 5)
    np.testing.assert_array_equal(np.asarray(table.columns["/rig/ball.x"])[own], X[own])
    np.testing.assert_allclose(table.clocks["/rig/u.1"], T, atol=1e-9)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"2", "/rig"),
        (b"[2]", "/rig/0"),
        (b"[" * 990 + b"2" + b"]" * 990, ""),
        (b"[" * 20_000 + b"2" + b"]" * 20_000, ""),
        (b'{"x": 1' + b"0" * 400 + b"}", "/rig/x"),
        (b'{"x": 1' + b"0" * 5000 + b"}", "/rig/x"),
    ],
    ids=["number", "list", "nested", "nested deeper", "beyond a double", "of 5001 digits"],
)
def test_a_strange_message_in_json_costs_no_other(tmp_path, data, name):
    from mcap.writer import Writer as PlainWriter

    path = tmp_path / "rig.mcap"
    with path.open("wb") as file:
        writer = PlainWriter(file)
        writer.start()
        channel = writer.register_channel("/rig", "json", 0)
        for k, each in enumerate((b'{"y": 1}', data, b'{"y": 3}')):
            writer.add_message(channel, k, each, k)
        writer.finish()
    columns = foreign_table(path).columns
    np.testing.assert_array_equal(columns["/rig/y"], [1, np.nan, 3])
    assert set(columns) == {"/rig/y", *filter(None, [name])}
