"""Geometry and least squares on arrays: rays, planes, circles, arcs, rotations; independent of lasers and files."""
