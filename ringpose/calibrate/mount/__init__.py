"""Where a camera is mounted on a robot, from views of a board and the poses of the robot (hand-eye calibration)."""
