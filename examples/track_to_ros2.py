#!/usr/bin/env python3
"""Publishes the track on /ring/pose and /ring/twist: ringpose track - --format ros | python3 track_to_ros2.py"""

import json
import sys

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from rosidl_runtime_py import set_message_fields

rclpy.init()
node = rclpy.create_node("ringpose")
kinds = {"pose": PoseWithCovarianceStamped, "twist": TwistWithCovarianceStamped}
publishers = {name: node.create_publisher(kind, f"ring/{name}", 1) for name, kind in kinds.items()}
for record in map(json.loads, sys.stdin):
    for name in kinds if record["validity"] == "valid" and record["pose"] else ():
        set_message_fields(message := kinds[name](), record[name])
        publishers[name].publish(message)
