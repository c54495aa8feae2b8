"""Rays, planes, circles, rotations and least squares on arrays; knows no laser and no ring."""
