"""Detection of the corners of each kind of pattern."""
