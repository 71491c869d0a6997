"""A rig of one's own on ROS 2: a node that hears where the ball is, and commands the plate.

It needs `rclpy`, which comes with ROS 2 and not from an index of Python packages: start ballplate
with the Python of a shell in which ROS 2 is sourced. Topics and messages are those of a run that is
exported as `.mcap`, so `ros2 bag play` of such a file is the other side for a first try:

    /ball/measured           geometry_msgs/PoseStamped  heard: ball, m, from the plate's middle
    /joint_states/measured   sensor_msgs/JointState     heard: plate angles phi, theta, rad, if any
    /plate/command           sensor_msgs/JointState     said: the same angles, and their rates
"""

import math
import threading

from ballplate.hardware import Hardware, Reading

BALL, PLATE, COMMAND = "/ball/measured", "/joint_states/measured", "/plate/command"


class Ros2(Hardware):
    """The rig behind three topics; `measure` never waits, as callbacks run in a thread."""

    watchdog = False  # True if your driver levels the plate when no command comes

    def __init__(self, namespace: str = "", patience: float = 5.0) -> None:
        self.namespace, self.patience = namespace, patience

    def start(self) -> None:
        """Join the topics, level the plate, and wait for a ball."""
        import rclpy
        from geometry_msgs.msg import PoseStamped
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self.message, self.angles = JointState, (None, None)
        self.heard, self.reading = threading.Event(), Reading(math.nan, math.nan, self.time())
        if not rclpy.ok():
            rclpy.init()
        self.node = rclpy.create_node("ballplate", namespace=self.namespace)
        # newest or nothing: a lost message is not sent again
        self.node.create_subscription(PoseStamped, BALL, self.see_ball, qos_profile_sensor_data)
        self.node.create_subscription(JointState, PLATE, self.see_plate, qos_profile_sensor_data)
        self.said = self.node.create_publisher(JointState, COMMAND, 1)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()
        self.command((0.0, 0.0), (0.0, 0.0))
        if not self.heard.wait(self.patience):
            raise OSError(f"{self.namespace}{BALL}: no message within {self.patience:g} s")

    def see_ball(self, message) -> None:
        """Take in a place; a driver that sees no ball says NaN."""
        place = message.pose.position
        self.reading = Reading(place.x, place.y, self.time(), *self.angles)
        self.heard.set()

    def see_plate(self, message) -> None:
        """Take in plate angles; they reach the loop with the next place of the ball."""
        angles = dict(zip(message.name, message.position, strict=False))
        if "phi" in angles and "theta" in angles:
            self.angles = angles["phi"], angles["theta"]

    def measure(self) -> Reading:
        """The newest message."""
        return self.reading

    def command(self, rates: tuple[float, float], angles: tuple[float, float]) -> None:
        """Say where the plate is to go, and how fast."""
        message = self.message()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.name = ["phi", "theta"]
        message.position, message.velocity = list(angles), list(rates)
        self.said.publish(message)

    def stop(self) -> None:
        """Level the plate and leave the topics."""
        if hasattr(self, "thread"):
            self.command((0.0, 0.0), (0.0, 0.0))
            self.executor.shutdown()
            self.thread.join(timeout=1.0)
            self.node.destroy_node()
            del self.thread
