"""Pose of a satellite's launch-adapter ring from one camera and line lasers."""
