"""`ballplate.hardware`.

The example with a ROS 2 node. ROS 2 itself is in no Python package: `rclpy` is emulated here, and
every message goes through the bytes of its published definition, so that a field of another name
or type, or a message type that MCAP files of runs do not have, fails.
"""

import math
import sys
import time
from types import ModuleType, SimpleNamespace

import pytest
from own_board import example

from twin.run.exporters import ROS2_TABLES

mcap = pytest.importorskip("mcap_ros2._dynamic", reason="the extra mcap is not installed")
PARTS = "".join(f"{80 * '='}\nMSG: {name}\n{text}" for name, text in ROS2_TABLES["parts"].items())


class Message:
    """A message as rclpy makes one: fields of its definition, and no others."""

    __slots__ = ("__dict__", "_fields")

    def __init__(self, definition):
        fields = [line.split() for line in definition.strip().splitlines()]
        object.__setattr__(self, "_fields", {name for _, name in fields})
        for kind, name in fields:
            part = ROS2_TABLES["parts"].get(kind)
            start = Message(part) if part else [] if "[]" in kind else "" if "st" in kind else 0.0
            setattr(self, name, start)

    def __setattr__(self, name, value):
        if name not in self._fields:
            raise AttributeError(name)
        super().__setattr__(name, value)


def make_message(kind):
    """A message of a type of the MCAP files of runs."""
    return Message(ROS2_TABLES["messages"][kind])


def carried(kind, message):
    """A message as its other side gets it: through the bytes of the wire."""
    text = ROS2_TABLES["messages"][kind] + PARTS
    data = mcap.serialize_dynamic(kind, text)[kind](message)
    return mcap.generate_dynamic(kind, text)[kind](data)


class Bus:
    """Topics, and the node of the program; as much of `rclpy` as a node needs."""

    def __init__(self):
        self.heard, self.said, self.alive = {}, {}, False
        self.spinning = True

    def create_node(self, name, *, namespace):
        def subscribe(kind, topic, callback, qos):
            self.heard[topic] = kind, callback

        def advertise(kind, topic, depth):
            def publish(message):
                self.said.setdefault(topic, []).append(carried(kind.of, message))

            return SimpleNamespace(publish=publish)

        stamp = SimpleNamespace(sec=3, nanosec=5)
        now = SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: stamp))
        return SimpleNamespace(
            create_subscription=subscribe,
            create_publisher=advertise,
            get_clock=lambda: now,
            destroy_node=lambda: setattr(self, "alive", False),
        )

    def say(self, topic, change):
        """What a node of the rig says on a topic."""
        kind, callback = self.heard[topic]
        message = make_message(kind.of)
        change(message)
        callback(carried(kind.of, message))

    def spin(self):
        """Until the executor is shut down: a driver that sees the ball 100 times a second."""
        while self.spinning:
            self.say("/ball/measured", place(0.03, -0.02))
            time.sleep(0.01)


def place(x, y):
    """A change: where the ball is."""

    def change(message):
        message.header.frame_id = "plate"
        message.pose.position.x, message.pose.position.y = x, y

    return change


def message_class(kind):
    return type(kind.rpartition("/")[2], (), {"of": kind, "__new__": lambda _: make_message(kind)})


@pytest.fixture
def bus(monkeypatch):
    bus = Bus()
    executor = SimpleNamespace(
        add_node=lambda node: None,
        spin=bus.spin,
        shutdown=lambda: setattr(bus, "spinning", False),
    )
    modules = {
        "rclpy": {
            "ok": lambda: bus.alive,
            "init": lambda: setattr(bus, "alive", True),
            "create_node": bus.create_node,
        },
        "rclpy.executors": {"SingleThreadedExecutor": lambda: executor},
        "rclpy.qos": {"qos_profile_sensor_data": "sensor data"},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": message_class("geometry_msgs/msg/PoseStamped")},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"JointState": message_class("sensor_msgs/msg/JointState")},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return bus


@pytest.fixture
def rig(bus):
    rig = example("ros2").Ros2(patience=0.5)
    rig.start()
    yield rig
    rig.stop()


def test_a_ball_and_plate_angles_become_a_reading(bus, rig):
    assert rig.measure()[:2] == (0.03, -0.02)
    assert rig.measure().phi is None
    bus.spinning = False
    rig.thread.join()

    def angles(message):
        message.name, message.position = ["theta", "phi"], [0.02, 0.01]

    bus.say("/joint_states/measured", angles)
    bus.say("/ball/measured", place(math.nan, math.nan))
    x, _, at, *found = rig.measure()
    assert math.isnan(x)
    assert found == [0.01, 0.02]
    assert 0 <= rig.time() - at < 1


def test_the_plate_is_commanded_by_name_and_levelled_at_the_end(bus, rig):
    rig.command((0.1, -0.2), (0.01, 0.02))
    first, last = bus.said["/plate/command"][0], bus.said["/plate/command"][-1]
    assert list(first.position) == [0.0, 0.0]
    assert list(last.name) == ["phi", "theta"]
    assert (list(last.position), list(last.velocity)) == ([0.01, 0.02], [0.1, -0.2])
    assert last.header.stamp.sec == 3
    rig.stop()
    assert list(bus.said["/plate/command"][-1].position) == [0.0, 0.0]
    assert not bus.spinning
    assert not bus.alive


def test_topics_and_messages_are_those_of_exported_runs(bus, rig):
    for topic, (kind, _) in bus.heard.items():
        assert ROS2_TABLES["topics"][topic]["message"] == kind.of


def test_a_rig_that_says_nothing_is_named(bus):
    bus.spinning = False
    rig = example("ros2").Ros2(patience=0.05)
    with pytest.raises(OSError, match=r"/ball/measured: no message within 0\.05 s"):
        rig.start()
    rig.stop()
