#!/usr/bin/env bash
# rosbags 0.11.9 and mcap-ros2-support 0.6.0, a bag of ROS 2 with std_msgs/Byte and std_msgs/Char.
# Guess: both fields are unsigned bytes, as rosidl has them (octet and unsigned char), and both readers return
#   200 for a byte of 200.
# Seen: rosbags returns -56 for the byte, and int8 for a ByteMultiArray, in which drivers keep raw frames;
#   mcap-ros2-support returns -56 for the char. Each is right where the other is wrong. No warning.
# Do: take these fields modulo 256 (an array: .view("uint8")), and define own messages with uint8.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv env
env/bin/pip install --quiet rosbags==0.11.9 mcap-ros2-support==0.6.0
env/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

HEAD = bytes([0, 1, 0, 0])  # CDR, little-endian
EMPTY_LAYOUT = bytes(8)
messages = {
    "std_msgs/msg/Byte": HEAD + bytes([200]),
    "std_msgs/msg/Char": HEAD + bytes([200]),
    "std_msgs/msg/UInt8": HEAD + bytes([200]),
    "std_msgs/msg/ByteMultiArray": HEAD + EMPTY_LAYOUT + (2).to_bytes(4, "little") + bytes([1, 200]),
}
types = get_typestore(Stores.ROS2_JAZZY)
with Writer(Path("bag"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    for k, (name, data) in enumerate(messages.items()):
        connection = writer.add_connection("/" + name.split("/")[-1], name, typestore=types)
        writer.write(connection, k, data)


def plain(data):
    return [int(each) for each in data] if hasattr(data, "__len__") else int(data)


by_rosbags, by_mcap = {}, {}
with Reader(Path("bag")) as reader:
    for connection, _, data in reader.messages():
        by_rosbags[connection.topic] = plain(types.deserialize_cdr(data, connection.msgtype).data)
for message in read_ros2_messages(next(Path("bag").glob("*.mcap"))):
    by_mcap[message.channel.topic] = plain(message.ros_msg.data)
print("rosbags", version("rosbags"), "mcap-ros2-support", version("mcap-ros2-support"))
for topic, value in by_rosbags.items():
    print(f"{topic}: rosbags {value}, mcap-ros2-support {by_mcap[topic]}")
assert by_rosbags == {"/Byte": -56, "/Char": 200, "/UInt8": 200, "/ByteMultiArray": [1, -56]}
assert by_mcap == {"/Byte": 200, "/Char": -56, "/UInt8": 200, "/ByteMultiArray": [1, 200]}
PY
