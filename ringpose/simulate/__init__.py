"""Simulation: frames of a scene and their ground truth."""
