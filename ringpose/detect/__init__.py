"""Frame -> break points."""
