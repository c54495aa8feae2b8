"""Calibration of the light planes from shots of a board with stripes."""
