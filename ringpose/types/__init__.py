"""Data types: the immutable records that the processing stages exchange."""
