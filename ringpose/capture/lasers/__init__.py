"""Laser drivers behind one protocol."""
