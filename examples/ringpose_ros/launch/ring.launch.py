"""Starts the node: ros2 launch ringpose_ros ring.launch.py rig:=/path/rig.yaml command:='ringpose pose --track ...'."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "rig": ("", "the rig file; its mount, if it has one, becomes a static transform"),
    "command": (
        "ringpose pose --track --camera aravis: --lasers line:Line1,Line2,Line3",
        "what measures; the node adds --rig, --format ros and --newest",
    ),
    "camera_frame": ("camera_optical_frame", "name of the camera's frame: x right, y down, z forward"),
    "tool_frame": ("tool0", "name of the frame of the robot's tool"),
    "base_frame": ("base_link", "name of the frame of the robot's base"),
    "robot_rate_hz": ("0.0", "how often the tool's pose of the TF tree goes to the command; 0: not at all"),
    "patience_s": ("1.0", "time without a line after which the diagnostics are stale"),
}
"""Default and description; those that are numbers have a point."""


def generate_launch_description():
    values = {
        name: ParameterValue(LaunchConfiguration(name), value_type=float if name[-2:] in ("hz", "_s") else str)
        for name in ARGUMENTS
    }
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(package="ringpose_ros", executable="ring", name="ringpose", output="screen", parameters=[values]),
        ]
    )
