"""Byte protocols shared by a driver and its virtual device."""
