"""Scenes: what is simulated, its parts and its motion."""
