"""The node: it runs ringpose and publishes its lines on ring/pose and ring/twist.

Beside these the mount of the camera is a static transform, and /diagnostics has the state of the newest line.
"""

import json
import shlex
import subprocess
import sys
import threading
import time
from contextlib import suppress

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistWithCovarianceStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.time import Time
from tf2_ros import Buffer, StaticTransformBroadcaster, TransformException, TransformListener

from ringpose_ros import lines

MESSAGES = {"pose": PoseWithCovarianceStamped, "twist": TwistWithCovarianceStamped}
LEVELS = {
    lines.OK: DiagnosticStatus.OK,
    lines.WARN: DiagnosticStatus.WARN,
    lines.ERROR: DiagnosticStatus.ERROR,
    lines.STALE: DiagnosticStatus.STALE,
}
DEFAULTS = {
    "rig": "",
    "command": "ringpose pose --track --camera aravis: --lasers line:Line1,Line2,Line3",
    "camera_frame": "camera_optical_frame",
    "tool_frame": "tool0",
    "base_frame": "base_link",
    "robot_rate_hz": 0.0,
    "patience_s": 1.0,
}
"""Parameters, as described in launch/ring.launch.py."""


class RingposeNode(Node):
    """Runs the command until it ends or the node is closed."""

    def __init__(self):
        super().__init__("ringpose")
        given = {name: self.declare_parameter(name, value).value for name, value in DEFAULTS.items()}
        if not given["rig"]:
            raise SystemExit("ringpose_ros: the parameter rig is missing; give the rig file, as rig:=/home/me/rig.yaml")
        self._frames = {frame: given[f"{frame}_frame"] for frame in ("camera", "tool", "base")}
        self._patience_s = given["patience_s"]
        self._line, self._arrived_s, self._count = None, time.monotonic(), 0
        self._ring = {name: self.create_publisher(kind, f"ring/{name}", 1) for name, kind in MESSAGES.items()}
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 1)
        self._broadcaster = StaticTransformBroadcaster(self)
        self._send_mount(given["rig"])
        command = [*shlex.split(given["command"]), "--rig", given["rig"], "--format", "ros", "--newest"]
        is_robot = given["robot_rate_hz"] > 0
        if is_robot:
            command += ["--robot-poses", "-"]
            self._tree, self._robot_stamp = Buffer(), None
            self._listener = TransformListener(self._tree, self)
            self.create_timer(1.0 / given["robot_rate_hz"], self._send_robot_pose)
        self.create_timer(1.0, self.diagnose)
        source = subprocess.PIPE if is_robot else subprocess.DEVNULL
        self._process = subprocess.Popen(command, stdin=source, stdout=subprocess.PIPE, text=True)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def has_ended(self):
        """Whether the command has ended, and all its lines are published."""
        return not self._reader.is_alive()

    def close(self):
        """End the command, which switches the lasers off; its exit status."""
        if self._process.poll() is None:
            self._process.terminate()
        self._reader.join()
        return self._process.wait()

    def diagnose(self):
        """Publish the state of the newest line, or of the command."""
        level, message = lines.summary(self._line, time.monotonic() - self._arrived_s, self._patience_s)
        if self._process.poll() is not None:
            level, message = lines.ERROR, f"ringpose has ended with status {self._process.returncode}"
        status = DiagnosticStatus(level=LEVELS[level], name="ringpose: ring", message=message)
        texts = {**lines.values(self._line), "lines": str(self._count)}
        status.values = [KeyValue(key=key, value=value) for key, value in texts.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _read(self):
        with suppress(BrokenPipeError), self._process:
            for line in map(json.loads, self._process.stdout):
                self._line, self._arrived_s, self._count = line, time.monotonic(), self._count + 1
                for name in lines.published(line):
                    message = lines.filled(MESSAGES[name](), line[name])
                    message.header.frame_id = self._frames[message.header.frame_id]
                    self._ring[name].publish(message)

    def _send_mount(self, rig):
        found = lines.mount_of(rig)
        if found is None:
            return
        carrier, matrix = found
        message = lines.filled(TransformStamped(), {"transform": lines.transform_fields(matrix)})
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = self._frames[carrier], self._frames["camera"]
        self._broadcaster.sendTransform(message)

    def _send_robot_pose(self):
        """Give the newest pose of the tool in the TF tree to the command, once."""
        try:
            base_from_tool = self._tree.lookup_transform(self._frames["base"], self._frames["tool"], Time())
            stamp = (base_from_tool.header.stamp.sec, base_from_tool.header.stamp.nanosec)
            if stamp != self._robot_stamp:
                self._robot_stamp = stamp
                self._process.stdin.write(lines.robot_pose_line(base_from_tool))
                self._process.stdin.flush()
        except TransformException as problem:
            self.get_logger().warning(str(problem), throttle_duration_sec=5.0)
        except (BrokenPipeError, ValueError):
            pass  # the command has ended, which the diagnostics report


def main():
    """Run the node; its exit status is that of the command."""
    rclpy.init()
    node = RingposeNode()
    try:
        while not node.has_ended:
            rclpy.spin_once(node, timeout_sec=0.1)
        node.diagnose()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        status = node.close()
        node.destroy_node()
        rclpy.try_shutdown()
    sys.exit(status)
