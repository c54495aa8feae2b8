"""Scene -> frames with truth."""
