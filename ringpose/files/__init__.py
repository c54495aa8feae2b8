"""Bytes <-> nouns: everything is checked once, here, at the border."""
