"""Stripes on the board: extraction, errors, assignment to lasers."""
