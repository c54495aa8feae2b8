"""The hot loops in C, each with a readable NumPy twin that is its oracle."""
