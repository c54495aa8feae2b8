"""(poses, truth) -> tables."""
