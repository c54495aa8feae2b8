"""A gripper that is guided to the ring: one run of the closed loop, its guidance and its score."""
