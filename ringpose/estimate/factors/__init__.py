"""Kinds of measurement of a ring, one in each module, and what is known before the measurement."""
