"""The ROS 2 side of ringpose."""
