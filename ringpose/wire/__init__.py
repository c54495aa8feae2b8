"""Byte protocols shared by a driver and its stand-in."""
